"""Measure how well the two pathways are separated.

Run ``python benchmarks/reflex.py`` from the repository root.

Simulated joints with a stretch reflex at 10 dB, identified by ``cascade`` or another method. For
each case: mean error, bias (less what the number of trials leaves in it), random and total error
of stiffness over time, and coverage of its nominal 95 % bands; the same of the reflex gain; VAF
of the torque, and of each pathway's, against the noiseless ones, each less its mean over
realizations; mean viscosity and inertia; how often a reflex was shown; processor time of one
identification in s. With ``--table``, the table of docs/reflex.md: stiffness of joints that do
not change, by methods of one pathway and of two.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.simulate import (
    PRBS,
    Constant,
    FilteredNoise,
    Perturbation,
    Pulses,
    ReflexJoint,
    SineWave,
    SquareWave,
    StretchReflex,
    System,
)

Array = NDArray[np.float64]
SINE = SineWave()
GAIN = SineWave(8.0, 4.0, offset=-0.5)
CONSTANT = Constant(100.0)
SLOW = StretchReflex(delay=0.05, frequency=10.0, damping=1.0)
SNR = 10.0


@dataclass(frozen=True)
class PositionReflex(StretchReflex):
    """Answers the angle in the place of the velocity: 1 rad as 10 rad/s."""

    def stretch(self, velocity: Array, rate: float, early: float = 0.0) -> Array:
        """As :meth:`StretchReflex.stretch`, of the angle's movement since the start."""
        return super().stretch(10 * np.cumsum(velocity) / rate, rate, early)


class GainAfterMuscle(StretchReflex):
    """The gain acts after the muscle, not before it."""

    def torque(self, velocity: Array, gain: float | Array, rate: float) -> Array:
        """As :meth:`StretchReflex.torque`."""
        return gain * super().torque(velocity, 1.0, rate)


class Case(NamedTuple):
    """A joint, and what moves it."""

    says: str
    system: System
    perturbation: Perturbation = FilteredNoise()


CASES = {
    "A": Case("sine, sine", ReflexJoint(SINE, reflex_gain=GAIN)),
    "B": Case(
        "square, square", ReflexJoint(SquareWave(), reflex_gain=SquareWave(4.0, 12.0, offset=0.0))
    ),
    "C": Case("constant, none", ReflexJoint(CONSTANT, reflex_gain=0.0)),
    "D": Case("sine, none", ReflexJoint(SINE, reflex_gain=0.0)),
    "E": Case("A by PRBS", ReflexJoint(SINE, reflex_gain=GAIN), PRBS()),
    "F": Case("A by pulses", ReflexJoint(SINE, reflex_gain=GAIN), Pulses()),
    "H": Case("weak gain", ReflexJoint(SINE, reflex_gain=SineWave(2.0, 1.0, offset=-0.5))),
    "L": Case("slow noise", ReflexJoint(SINE, reflex_gain=GAIN, noise_bandwidth=1.0)),
    "M": Case(
        "constant, strong, pulses",
        ReflexJoint(Constant(70.0), viscosity=1.0, inertia=0.025, reflex_gain=20.0),
        Pulses(),
    ),
    "N": Case("negative", ReflexJoint(SINE, reflex_gain=GAIN, reflex=StretchReflex(direction=-1))),
    "O": Case(
        "gain after muscle",
        ReflexJoint(SINE, reflex_gain=GAIN, reflex=GainAfterMuscle()),
    ),
    "X": Case("of position", ReflexJoint(SINE, reflex_gain=GAIN, reflex=PositionReflex())),
    "T": Case(
        "threshold .1", ReflexJoint(SINE, reflex_gain=GAIN, reflex=StretchReflex(threshold=0.1))
    ),
    "W": Case("slow muscle, late", ReflexJoint(SINE, reflex_gain=GAIN, reflex=SLOW)),
}
TABLE = {  # of constant joints
    "noise, gain 8": Case("", ReflexJoint(CONSTANT, reflex_gain=8.0)),
    "PRBS, gain 8": Case("", ReflexJoint(CONSTANT, reflex_gain=8.0), PRBS()),
    "pulses, gain 20, stiffness 70": CASES["M"],
    "noise, no reflex": CASES["C"],
    "noise, gain 8, slow muscle": Case("", ReflexJoint(CONSTANT, reflex_gain=8.0, reflex=SLOW)),
}
TABLE_METHODS = {
    "sds, ±40 ms": "sds:max_lag=0.04,window=1.0",
    "sds, ±120 ms": "sds:max_lag=0.12,window=1.0",
    "sds, ±240 ms": "sds:max_lag=0.24,window=1.0",
    "pc": "pc",
    "sdss": "sdss",
    "cascade": "cascade",
}


def main() -> None:
    parser = argparse.ArgumentParser(description="How well the two pathways are separated.")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--durations", nargs="+", type=float, default=[150.0])
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument(
        "--seed", type=int, default=1000, help="that of the first trial; the next ones follow it"
    )
    parser.add_argument("--method", default="cascade")
    parser.add_argument(
        "--table", action="store_true", help="constant joints by several methods, 60 s each"
    )
    chosen = parser.parse_args()
    if chosen.table:
        print_table(chosen.trials)
        return
    console = Console(width=None if sys.stdout.isatty() else 200)
    for duration in chosen.durations:
        columns = (
            "case",
            "K mean",
            "bias",
            "random",
            "total",
            "cover",
            "G mean",
            "bias",
            "random",
            "cover",
        )
        columns += ("VAF all", "intrinsic", "reflex", "B", "I", "shown", "s")
        table = Table(*columns, title=f"{chosen.method}, {duration:g} s, {chosen.trials} trials")
        for key in chosen.cases:
            with threadpool_limits(1), warnings.catch_warnings():
                warnings.simplefilter("ignore", tv.DataQualityWarning)
                rows = [
                    trial(CASES[key], chosen.method, duration, chosen.seed + number)
                    for number in range(chosen.trials)
                ]
            table.add_row(f"{key} {CASES[key].says}", *summary(rows))
        console.print(table)


def print_table(trials: int) -> None:
    """Mean and standard deviation of the stiffness in N·m/rad, of 60 s."""
    print("| | " + " | ".join(TABLE_METHODS) + " |\n" + "|---" * (1 + len(TABLE_METHODS)) + "|")
    for name, case in TABLE.items():
        cells = []
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore", tv.DataQualityWarning)
            drawn = [
                case.system.simulate(
                    60.0, perturbation=case.perturbation, snr_db=SNR, seed=3000 + number
                )
                for number in range(trials)
            ]
            ensembles = [tv.preprocess.subtract_mean(cut(each.recording)) for each in drawn]
            for method in TABLE_METHODS.values():
                found = [
                    np.nanmean(tv.methods.parse(method).identify(each).stiffness)
                    for each in ensembles
                ]
                cells.append(f"{np.mean(found):.1f} ± {np.std(found, ddof=1):.1f}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


class Outcome(NamedTuple):
    """Errors over time and whether the bands held the truth, of stiffness and gain; VAFs.

    And further numbers.
    """

    errors: dict[str, Array]
    held: dict[str, Array]
    shares: dict[str, float]
    further: tuple[float, float, float, float]


def trial(case: Case, method: str, duration: float, seed: int) -> Outcome:
    """One simulation, identified."""
    simulation = case.system.simulate(
        duration, perturbation=case.perturbation, snr_db=SNR, seed=seed
    )
    ensemble = cut(simulation.recording)
    started = time.process_time()
    model = tv.methods.parse(method).identify(ensemble)
    seconds = time.process_time() - started
    errors, held = {}, {}
    for name in ("stiffness", "reflex_gain"):
        if name not in model.estimates:
            continue
        truth = simulation.truth_of(ensemble)[name].mean(axis=0)
        lower, upper = model.estimates[name].band()
        errors[name] = model.over_time(name) - truth
        held[name] = np.where(np.isfinite(lower), (lower <= truth) & (truth <= upper), np.nan)
    found = model.pathways(ensemble)
    true = {
        name: cut(
            tv.Recording(simulation.recording.angle, torque, 1000.0, simulation.recording.start)
        ).torque
        for name, torque in simulation.pathways.items()
        if np.ptp(torque) > 0
    }
    true = {name: torque[:, ensemble.core] for name, torque in true.items()}
    shares = {name: vaf(torque, found[name]) for name, torque in true.items() if name in found}
    shares["all"] = vaf(np.sum(list(true.values()), axis=0), np.sum(list(found.values()), axis=0))
    shown = model.diagnostics.details.get("reflex_detected", math.nan)
    return Outcome(
        errors,
        held,
        shares,
        (np.nanmean(model.viscosity), np.nanmean(model.inertia), shown, seconds),
    )


def cut(recording: tv.Recording) -> tv.Ensemble:
    return tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)


def vaf(torque: Array, predicted: Array) -> float:
    left, whole = torque - predicted, torque - torque.mean(axis=0)
    left = left - np.nanmean(left, axis=0)
    return 100 * (1 - float(np.nansum(left**2)) / float(np.sum(whole[np.isfinite(left)] ** 2)))


def summary(rows: list[Outcome]) -> list[str]:
    """Texts of a row of the table."""
    texts = []
    for name, whole in (("stiffness", True), ("reflex_gain", False)):
        if name not in rows[0].errors:
            texts += ["-"] * (5 if whole else 4)
            continue
        errors = np.stack([row.errors[name] for row in rows])
        mean = np.nanmean(errors, axis=0)
        random = np.nanmean(np.nanvar(errors, axis=0, ddof=1)) if len(rows) > 1 else math.nan
        bias = np.nanmean(mean**2) - random / len(rows)
        values = [np.nanmean(errors), math.copysign(math.sqrt(abs(bias)), bias), math.sqrt(random)]
        values += [math.sqrt(np.nanmean(errors**2))] * whole
        texts += [
            f"{value:.2f}" for value in (*values, np.nanmean([row.held[name] for row in rows]))
        ]
    for name in ("all", "intrinsic", "reflex"):
        shares = [row.shares[name] for row in rows if name in row.shares]
        texts.append(f"{np.mean(shares):.1f}" if shares else "-")
    viscosity, inertia, shown, seconds = np.mean([row.further for row in rows], axis=0)
    return [*texts, f"{viscosity:.2f}", f"{inertia:.4f}", f"{shown:.2f}", f"{seconds:.2f}"]


if __name__ == "__main__":
    main()
