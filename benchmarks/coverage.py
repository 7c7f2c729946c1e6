"""Measure how often the bands hold the truth.

Run ``python benchmarks/coverage.py`` from the repository root.

Simulated joints at 10 dB, their mean over realizations subtracted (``--keep-mean`` leaves it),
identified by the five methods at their defaults (the spectral method also by its fit). For each
condition: coverage of nominal 95 % bands of stiffness, viscosity and inertia in per cent, and of
the simultaneous band of stiffness (share of trials that lie within it as a whole); the bands'
standard deviation of stiffness over that of the estimates; bias of stiffness as root mean square
over time; mean viscosity and inertia over trials. For the square wave also the coverage within
0.05 s of a switch, and 0.3 s and more away from them.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))  # when run as a script

import tvsysid as tv
from tvsysid.study.scores import AT_SWITCH, AWAY, from_switch

Array = NDArray[np.float64]

VISCOSITY = 2.2
INERTIA = 0.02
METHODS = {
    "eirf": tv.EnsembleIRF(),
    "sds": tv.ShortDataSegments(),
    "birf": tv.BasisIRF(),
    "esm": tv.EnsembleSpectral(),
    "esm fit": tv.EnsembleSpectral(stiffness="fit"),
    "kbr": tv.KernelRegression(),
}
PROFILES = {"sine": tv.simulate.SineWave(), "square": tv.simulate.SquareWave()}
PERTURBATIONS = {"noise": tv.simulate.FilteredNoise(), "prbs": tv.simulate.PRBS()}


def main() -> None:
    parser = argparse.ArgumentParser(description="How often the bands hold the truth.")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--profile", choices=PROFILES, default="sine")
    parser.add_argument("--durations", type=float, nargs="+", default=[150.0, 40.0])
    parser.add_argument(
        "--perturbations", choices=PERTURBATIONS, nargs="+", default=list(PERTURBATIONS)
    )
    parser.add_argument("--methods", choices=METHODS, nargs="+", default=list(METHODS))
    parser.add_argument(
        "--keep-mean", action="store_true", help="do not subtract the mean over realizations"
    )
    parser.add_argument("--workers", type=int, default=1)
    chosen = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 150)
    with ProcessPoolExecutor(chosen.workers) as pool:
        for duration in chosen.durations:
            for perturbation in chosen.perturbations:
                job = partial(
                    trial,
                    chosen.profile,
                    perturbation,
                    duration,
                    tuple(chosen.methods),
                    chosen.keep_mean,
                )
                results = list(pool.map(job, range(1000, 1000 + chosen.trials)))
                title = f"{chosen.profile}, {perturbation}, {duration:g} s, {chosen.trials} trials"
                console.print(table(title, chosen.profile, chosen.methods, results))


def trial(
    profile: str,
    perturbation: str,
    duration: float,
    methods: tuple[str, ...],
    keep_mean: bool,
    seed: int,
) -> Array:
    """Return estimates and bands of the three quantities, and the simultaneous band of stiffness.

    The bands are lower and upper ones. Shape (method, 11, time).
    """
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    with threadpool_limits(1):
        simulation = tv.simulate.Joint(stiffness=PROFILES[profile]).simulate(
            duration, perturbation=PERTURBATIONS[perturbation], snr_db=10, seed=seed
        )
        ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
        if not keep_mean:
            ensemble = tv.preprocess.subtract_mean(ensemble)
        rows = []
        for method in methods:
            model = METHODS[method].identify(ensemble)
            rows.append(
                [
                    model.stiffness,
                    model.viscosity,
                    model.inertia,
                    *model.estimates["stiffness"].band(),
                    *model.estimates["viscosity"].band(),
                    *model.estimates["inertia"].band(),
                    *model.estimates["stiffness"].band(simultaneous=True),
                ]
            )
    return np.array(rows)


def table(title: str, profile: str, methods: list[str], results: list[Array]) -> Table:
    time = np.arange(results[0].shape[-1]) / 100
    truth = np.asarray(PROFILES[profile](time))
    constant = np.ones_like(time)
    shown = Table(title=title)
    shown.add_column("method")
    columns = (
        "stiffness",
        "simultaneous",
        "viscosity",
        "inertia",
        "SD ratio",
        "SD",
        "bias",
        "mean b",
        "mean I",
    )
    distance = from_switch(time, tv.simulate.SquareWave()(time))
    near, away = distance <= AT_SWITCH + 1e-9, distance >= AWAY
    if profile == "square":
        columns += "near", "away"
    for column in columns:
        shown.add_column(column, justify="right")
    for place, method in enumerate(methods):
        k, b, i, *bands = np.stack([result[place] for result in results]).swapaxes(0, 1)
        cover = [
            tv.metrics.coverage(bands[2 * j], bands[2 * j + 1], true)
            for j, true in enumerate((truth, VISCOSITY * constant, INERTIA * constant))
        ]
        inside = ((bands[6] <= truth) & (truth <= bands[7])) | np.isnan(bands[6])
        whole = 100 * np.mean(inside.all(axis=1)) if np.isfinite(bands[6]).any() else np.nan
        spread = (bands[1] - bands[0]) / 2 / 1.96
        ratio = np.sqrt(np.mean(spread**2) / np.mean(k.var(axis=0, ddof=1)))
        cells = [f"{value:.1f}" for value in (cover[0], whole, *cover[1:])]
        cells += [
            f"{ratio:.2f}",
            f"{spread.mean():.2f}",
            f"{tv.metrics.debiased_bias_error(k, truth):.2f}",
        ]
        cells += [
            f"{value:.4f}"
            for value in (
                np.mean(x[np.isfinite(x)]) if np.isfinite(x).any() else np.nan for x in (b, i)
            )
        ]
        if profile == "square":
            cells += [
                f"{tv.metrics.coverage(bands[0][:, at], bands[1][:, at], truth[at]):.1f}"
                for at in (near, away)
            ]
        shown.add_row(method, *cells)
    return shown


if __name__ == "__main__":
    main()
