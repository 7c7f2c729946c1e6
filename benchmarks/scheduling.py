"""Identify joints that follow a measured variable.

Run ``python benchmarks/scheduling.py`` from the repository root.

Without a file, simulated joints of 106 s at 15 dB whose stiffness is quadratic in the variable,
with and without a reflex whose gain is a sigmoid of it: mean error, bias, random error and coverage
of stiffness at ten values of the variable, the ratio of stated to true standard deviation, VAF of
folds held out and of the noiseless torque, error of the reflex gain.

With a file (and the names of its channels), what the methods find in it; their orders by folds;
and, as an independent check, stiffness by methods that know nothing of a variable, from the
parts of the record in which it is near a value: ``sds``, which takes a reflex for stiffness;
``pc``, which tells the two apart; and ``lpv`` itself of order 0.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tvsysid as tv

Array = NDArray[np.float64]
STIFFNESS, VISCOSITY = Polynomial([28.875, 155.0, 310.0]), Polynomial([0.83, 0.2])
GRID = np.linspace(-0.37, 0.17, 10)
METHODS = {
    "lpv": tv.ScheduledIRF(),
    "lpv, rest_order 2": tv.ScheduledIRF(rest_order=2),
    "lpv, order 3": tv.ScheduledIRF(order=3, reflex_order=3),
    "lpv, no reflex": tv.ScheduledIRF(reflex=False),
    "lpvkbi": tv.ScheduledImpedance(),
    "lpvkbi, no reflex": tv.ScheduledImpedance(reflex=False),
}
SHARP = True  # as `tvsysid identify --scheduling` decimates
NEAR, PIECE = 0.02, 0.5  # how near to a value a part of so many seconds is


def gain(variable: Array) -> Array:
    """Reflex gain of the simulated joint in N·m·s/rad."""
    return np.asarray(2.5 + 3.5 / (1 + np.exp(-(variable + 0.05) / 0.08)))


def ensembles(seed: int, reflex: bool) -> Iterator[tv.Ensemble]:
    """The simulated record, with and without its noise, as one realization."""
    phase = float(np.random.default_rng(seed).uniform(0, 10))
    settings = {
        "relation": STIFFNESS,
        "viscosity_relation": VISCOSITY,
        "gain_relation": gain if reflex else None,
    }
    settings |= {
        "schedule": tv.simulate.SineWave(-0.1, 0.3, 10.0, phase),
        "variation": 0.0,
        "variable": "scheduling",
    }
    settings |= {
        "reflex": tv.simulate.StretchReflex(delay=0.05, frequency=20.0, damping=1.0),
        "noise_bandwidth": 15.0,
    }
    joint = tv.simulate.ScheduledJoint(inertia=0.016, **settings)
    made = joint.simulate(106, perturbation=tv.simulate.FilteredNoise(), snr_db=15, seed=seed)
    for recording in (made.recording, made.noiseless):
        yield tv.preprocess.segment(tv.preprocess.decimate(recording, 100, sharp=SHARP), None)


def explained(torque: Array, predicted: Array) -> float:
    """Variance of a torque about its mean that is predicted, in per cent."""
    return float(100 * (1 - np.nanvar(torque - predicted) / np.var(torque[np.isfinite(predicted)])))


def simulated(trials: int, reflex: bool) -> Table:
    """Errors of each method over so many trials."""
    table = Table(
        title=f"{trials} simulated joints {'with' if reflex else 'without'} a reflex; K in N·m/rad"
    )
    for heading in (
        "method",
        "mean error",
        "bias",
        "random",
        "coverage %",
        "stated/true SD",
        "folds %",
        "noiseless %",
    ):
        table.add_column(heading, justify="right")
    table.add_column("gain error", justify="right")
    every = [tuple(ensembles(200 + trial, reflex)) for trial in range(trials)]
    for name, method in METHODS.items():
        models = [method.identify(noisy) for noisy, _ in every]
        found = [model.at(GRID) for model in models]
        error = np.array([each["stiffness"].values for each in found]) - STIFFNESS(GRID)
        bands = np.array([each["stiffness"].band() for each in found])
        stated = np.array([each["stiffness"].standard_error.values for each in found])
        held = (bands[:, 0] <= STIFFNESS(GRID)) & (STIFFNESS(GRID) <= bands[:, 1])
        spread = error.var(axis=0, ddof=1)
        bias = np.sqrt(max(0.0, float(np.mean(error.mean(axis=0) ** 2 - spread / trials))))
        pairs = zip(models, (clean for _, clean in every), strict=True)
        pure = [
            explained(clean.torque[:, clean.core], model.predict(clean)) for model, clean in pairs
        ]
        folds = np.mean([model.diagnostics.details["vaf_folds"] for model in models])
        numbers = [error.mean(), bias, np.sqrt(spread.mean()), 100 * held.mean()]
        numbers += [np.sqrt(np.mean(stated**2) / spread.mean()), folds, np.mean(pure)]
        gains = [each["reflex_gain"].values for each in found if "reflex_gain" in each]
        numbers += (
            [np.sqrt(np.mean((np.mean(gains, axis=0) - reflex * gain(GRID)) ** 2))] if gains else []
        )
        table.add_row(name, *(f"{number:.2f}" for number in numbers))
    return table


def recorded(recording: tv.Recording, values: Array) -> Iterator[Table]:
    """What is found in a record: by each method, by order, and by parts of it."""
    ensemble = tv.preprocess.segment(recording, None)
    table = Table(title=f"{ensemble!r}: stiffness ± standard error at values of the variable; VAF")
    for heading in ("method", *(f"{value:g}" for value in values), "in sample %", "folds %", "s"):
        table.add_column(heading, justify="right")
    for name, method in METHODS.items():
        started = time.process_time()
        model = method.identify(ensemble)
        seconds, found = time.process_time() - started, model.at(values)["stiffness"]
        both = zip(found.values, found.standard_error.values, strict=True)
        shares = [f"{model.diagnostics.details[each]:.1f}" for each in ("vaf", "vaf_folds")]
        table.add_row(
            name,
            *(f"{value:.1f} ± {error:.1f}" for value, error in both),
            *shares,
            f"{seconds:.2f}",
        )
    pieces = tv.preprocess.segment(recording, PIECE, 0.75)
    constant = tv.ScheduledIRF(order=0, reflex_order=0, memory=0.7)
    for method in (
        tv.ShortDataSegments(max_lag=0.04, window=0.4),
        tv.ParallelCascade(memory=0.7),
        constant,
    ):
        table.add_row(
            f"{method.key}, parts",
            *(by_parts(method, pieces, value) for value in values),
            "",
            "",
            "",
        )
    yield table
    table = Table(title="VAF of folds held out by order, the reflex's being the same, %")
    for heading in ("method", *map(str, range(5))):
        table.add_column(heading, justify="right")
    for method in (tv.ScheduledIRF, tv.ScheduledImpedance):
        models = [method(order=order, reflex_order=order).identify(ensemble) for order in range(5)]
        table.add_row(
            method.key, *(f"{model.diagnostics.details['vaf_folds']:.1f}" for model in models)
        )
    yield table


def by_parts(method: tv.methods.Method, pieces: tv.Ensemble, value: float) -> str:
    """Return the stiffness by a method from the pieces in which the variable is near a value.

    The text includes the error where the method states it.
    """
    chosen = np.abs(pieces.channels["scheduling"][:, pieces.core] - value).max(axis=1) < NEAR
    if chosen.sum() < 2:
        return "-"
    part = pieces.select(chosen)
    part = part if isinstance(method, tv.ScheduledIRF) else tv.preprocess.subtract_mean(part)
    if method.skip(part):
        return "-"
    estimates = method.identify(part).estimates
    found, error = estimates["stiffness"], estimates["stiffness"].standard_error.values
    stated = f" ± {np.nanmean(error):.1f}" if np.isfinite(error).any() else ""
    gain = (
        f"; gain {np.nanmean(estimates['reflex_gain'].values):.1f}"
        if "reflex_gain" in estimates
        else ""
    )
    return f"{np.nanmean(found.values):.1f}{stated} ({chosen.sum()}){gain}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Joints that follow a measured variable.")
    parser.add_argument(
        "file", nargs="?", help="record, with --angle, --torque, --variable, and --rate in Hz"
    )
    for name in ("--angle", "--torque", "--variable"):
        parser.add_argument(name)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--torque-sign", type=int, default=1)
    parser.add_argument("--decimate", type=float, default=100.0)
    parser.add_argument("--trials", type=int, default=20)
    given = parser.parse_args()
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    console = Console(width=170)
    with threadpool_limits(1):
        if given.file is None:
            for reflex in (True, False):
                console.print(simulated(given.trials, reflex))
            return
        names = {
            "angle": given.angle,
            "torque": given.torque,
            "channels": {"scheduling": given.variable},
        }
        recording = tv.read_recording(
            given.file, sampling_rate=given.rate, torque_sign=given.torque_sign, **names
        )
        recording = tv.preprocess.decimate(recording, given.decimate, sharp=SHARP)
        for table in recorded(recording, np.array([-0.4, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2])):
            console.print(table)


if __name__ == "__main__":
    main()
