"""Measure what a reference improves in closed loop.

Run ``python benchmarks/closed_loop.py`` from the repository root.

A joint on a load of some stiffness, moved by a torque (20-Hz noise) and by the noise of its own
torque; 40 s unless ``--duration`` says otherwise. For each scenario and method: the mean error
of stiffness over time, the bias as root mean square over time less what chance makes of it, the
random error, the share of times at which the 95 % band holds the truth, and the band's standard
deviation over the estimates'; in N·m/rad and per cent. ``--weak`` takes loads so soft and noise
so strong that the disturbance hardly moves the angle. ``--found`` diagnoses 48 loops without a
reference and 100 imposed angles of an independent simulator instead, with noise of many colours,
and counts what is missed or false; it ends with 1 if more than 3 loops are missed, or an imposed
angle is taken for one.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tvsysid as tv

sys.path.insert(0, str(Path(__file__).parents[1]))  # when run as a script
from tests import independent

Array = NDArray[np.float64]

REFERENCE = "disturbance"
METHODS = {
    "sds": tv.ShortDataSegments(),
    "esm fit": tv.EnsembleSpectral(stiffness="fit"),
    "birf": tv.BasisIRF(),
    "kbr": tv.KernelRegression(),
    "kbr residual": tv.KernelRegression(weighting="residual"),
    "sds reference": tv.ShortDataSegments(reference=REFERENCE),
    "esm reference": tv.EnsembleSpectral(stiffness="fit", reference=REFERENCE),
    "birf reference": tv.BasisIRF(reference=REFERENCE),
    "kbr reference": tv.KernelRegression(reference=REFERENCE),
    "kbr reference, residual": tv.KernelRegression(reference=REFERENCE, weighting="residual"),
}
# Settings of the 48 loops
LOADS, COLOURS = (60.0, 250.0), ("pink", "wide", "first-order")
LOUD_DB, SEEDS = (0.0, 5.0), range(4)
ALLOWED = 3  # loops that may be missed
# Load stiffness in N·m/rad from which on the actuator imposes the angle
IMPOSED = 1e4


class Scenario(NamedTuple):
    """Profile of stiffness, stiffness of the load in N·m/rad, and noise.

    The noise has a bandwidth ``noise_hz`` in Hz and a level ``snr_db`` in dB.
    """

    profile: str
    load: float
    noise_hz: float
    snr_db: float


SCENARIOS = [
    *(
        Scenario("sine", load, *noise)
        for load in (30, 100, 300, 1000)
        for noise in ((40, 10), (5, 5))
    ),
    *(Scenario("square", 100, *noise) for noise in ((40, 10), (5, 5))),
    *(Scenario("sine", 1e5, *noise) for noise in ((40, 10), (5, 5))),
    *(Scenario("sine", 100, *noise) for noise in ((5, 10), (5, 15), (2, 5))),
]
WEAK = [Scenario("sine", 30, 2, -5), Scenario("sine", 3, 2, -10), Scenario("sine", 3, 2, -15)]


def main() -> None:
    parser = argparse.ArgumentParser(description="What a reference mends in closed loop.")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--duration", type=float, default=40.0)
    parser.add_argument("--methods", choices=METHODS, nargs="+", default=list(METHODS))
    parser.add_argument(
        "--weak",
        action="store_true",
        help="loads so soft that the disturbance hardly moves the angle",
    )
    parser.add_argument(
        "--found", action="store_true", help="loops that a diagnosis misses, and false alarms"
    )
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    console = Console(width=None if sys.stdout.isatty() else 120)
    with threadpool_limits(1):
        if chosen.found:
            sys.exit(int(not detection(console)))
        for scenario in WEAK if chosen.weak else SCENARIOS:
            console.print(table(scenario, chosen.duration, chosen.trials, chosen.methods))


def detection(console: Console) -> bool:
    """Print which loops are missed and which imposed angles have a finding.

    Return whether both are few.
    """
    shown = Table(title="feedback in loops without a reference, 80 s")
    for column in (
        "load (N·m/rad)",
        "noise",
        "dB",
        "found",
        "share of the torque (%)",
        "taken for a delay",
    ):
        shown.add_column(column)
    missed = 0
    for load, colour, snr_db in itertools.product(LOADS, COLOURS, LOUD_DB):
        checks = [checked(independent.in_loop(load, colour, snr_db, seed)[:2]) for seed in SEEDS]
        loops = [each["feedback"] for each in checks]
        count, early = (
            sum(each.found for each in loops),
            sum(each["delay"].found for each in checks),
        )
        shares = (
            f"{min(each.value for each in loops):.1f} to {max(each.value for each in loops):.1f}"
        )
        shown.add_row(
            f"{load:g}", colour, f"{snr_db:g}", f"{count} of {len(loops)}", shares, str(early)
        )
        missed += len(loops) - count
    console.print(shown)
    alarms, other = 0, 0
    kinds = itertools.product(independent.COLOURS, independent.WAVES, ("noise", "prbs"))
    for seed, ((colour, wave, perturbation), snr_db) in enumerate(
        zip(kinds, itertools.cycle((0.0, 5.0, 10.0, 20.0, 5.0)))
    ):
        signals, _ = independent.imposed(wave, perturbation, colour, snr_db, seed)
        names = [name for name, check in checked(signals).items() if check.found]
        alarms, other = alarms + ("feedback" in names), other + bool(names)
        if names:
            console.print(
                f"imposed {wave}, {perturbation}, {colour} noise at {snr_db:g} dB: "
                f"{', '.join(names)}"
            )
    console.print(
        f"{missed} of {len(LOADS) * len(COLOURS) * len(LOUD_DB) * len(SEEDS)} loops missed"
    )
    console.print(
        f"{alarms} of {seed + 1} imposed angles taken for a loop, {other} with any finding"
    )
    return missed <= ALLOWED and not alarms


def checked(signals: Array) -> dict[str, tv.quality.Finding]:
    """Diagnose angle and torque (2, time)."""
    return {each.name: each for each in tv.diagnose(independent.ensemble_of(*signals)).checks}


def table(scenario: Scenario, duration: float, trials: int, methods: list[str]) -> Table:
    """Scores of each method."""
    load = (
        "an imposed angle" if scenario.load >= IMPOSED else f"a load of {scenario.load:g} N·m/rad"
    )
    shown = Table(
        title=f"{scenario.profile} on {load}, noise below {scenario.noise_hz:g} Hz at "
        f"{scenario.snr_db:g} dB, {duration:g} s, {trials} trials"
    )
    shown.add_column("method")
    for column in (
        "mean",
        "± chance",
        "bias",
        "random",
        "coverage",
        "SD ratio",
        "predicted",
        "refused",
    ):
        shown.add_column(column, justify="right")
    for name in methods:
        shown.add_row(name, *scores(name, scenario, duration, trials))
    return shown


def scores(name: str, scenario: Scenario, duration: float, trials: int) -> list[str]:
    """Cells of one row."""
    found, lower, upper, errors, predicted = [], [], [], [], []
    for seed in range(100, 100 + trials):
        data = ensemble(scenario, duration, seed)
        try:
            model = METHODS[name].identify(data)
        except tv.InputError:
            continue
        found.append(model.stiffness)
        for limits, values in zip((lower, upper), model.estimates["stiffness"].band(), strict=True):
            limits.append(values)
        errors.append(model.estimates["stiffness"].standard_error.values)
        predicted.append(model.diagnostics.details.get("predicted_by_reference", np.nan))
    if len(found) < 2:
        return ["", "", "", "", "", "", "", str(trials - len(found))]
    k, truth = np.array(found), np.asarray(tv.simulate.PROFILES[scenario.profile](data.time))
    each = (k - truth).mean(axis=1)
    held = np.isfinite(lower)
    inside = (np.array(lower) <= truth) & (truth <= np.array(upper))
    spread = (
        np.sqrt(np.nanmean(np.array(errors) ** 2) / np.mean(k.var(axis=0, ddof=1)))
        if held.any()
        else np.nan
    )
    values = [
        f"{each.mean():.1f}",
        f"{each.std(ddof=1) / np.sqrt(len(each)):.1f}",
        f"{tv.metrics.debiased_bias_error(k, truth):.1f}",
        f"{np.sqrt(np.mean(k.var(axis=0, ddof=1))):.1f}",
        f"{100 * inside[held].mean():.0f}" if held.any() else "",
        f"{spread:.2f}",
        "" if np.isnan(predicted).all() else f"{np.mean(predicted):.1f}",
    ]
    return [*values, str(trials - len(found))]


@cache
def ensemble(scenario: Scenario, duration: float, seed: int) -> tv.Ensemble:
    """Realizations with their reference, the mean subtracted."""
    joint = tv.simulate.CompliantActuator(
        stiffness=tv.simulate.PROFILES[scenario.profile],
        actuator_stiffness=scenario.load,
        noise_bandwidth=scenario.noise_hz,
        disturbance="angle" if scenario.load >= IMPOSED else "torque",
    )
    noise = tv.simulate.FilteredNoise(20.0)
    simulation = joint.simulate(duration, perturbation=noise, snr_db=scenario.snr_db, seed=seed)
    recording = tv.preprocess.decimate(simulation.recording, 100)
    return tv.preprocess.subtract_mean(tv.preprocess.segment(recording, 2.0), [REFERENCE])


if __name__ == "__main__":
    main()
