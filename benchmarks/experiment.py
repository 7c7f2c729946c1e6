"""Measure where the time of an experiment goes.

Run ``python benchmarks/experiment.py`` from the repository root.

Runs the paper's experiment on six virtual participants (fewer bootstraps with ``--bootstraps``),
and prints the time of each method, the share of the preparation, and the most memory that all
processes held at once (Linux only). Then it measures, on one draw, the share of an
identification that its second moments take: what could be saved by reweighting them from draw to
draw instead of computing them anew.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable
from statistics import median

import numpy as np
from memory import watched_memory
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.moments import lagged_moments, window_moments

REPEATS = 15


def main() -> None:
    parser = argparse.ArgumentParser(description="Where the time of an experiment goes.")
    parser.add_argument("--bootstraps", type=int, default=100)
    parser.add_argument("--workers", type=int, default=None)
    chosen = parser.parse_args()
    console = Console()
    experiment = tv.study.Experiment(bootstraps=chosen.bootstraps)
    with tempfile.TemporaryDirectory() as folder, watched_memory() as peak:
        started = time.perf_counter()
        prepared = tv.study.prepared_recordings(experiment)
        preparing = time.perf_counter() - started
        results = tv.study.run(
            experiment,
            prepared=prepared,
            folder=folder,
            workers=chosen.workers,
        )
        seconds = time.perf_counter() - started
        results = results.load()
    table = Table(
        title=f"{chosen.bootstraps} bootstraps",
        title_justify="left",
        caption="identification, all workers",
    )
    for heading in ("method", "realizations", "s", "ms a draw"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for place, analysis in enumerate(experiment.analyses):
        spent = float(results.seconds[:, place].sum())
        draws = len(experiment.recordings) * chosen.bootstraps
        table.add_row(
            analysis.name, str(analysis.realizations), f"{spent:.1f}", f"{1000 * spent / draws:.1f}"
        )
    console.print(table)
    console.print(
        f"{seconds:.1f} s from start to end, {preparing:.1f} s of them for the recordings; peak "
        f"memory {peak[0] / 2**20:,.0f} MiB\n",
        highlight=False,
    )
    console.print(moments_table(prepared[0].ensemble))


def moments_table(ensemble: tv.Ensemble | None) -> Table:
    """Share of the second moments in an identification of 75 realizations."""
    assert ensemble is not None
    drawn = ensemble.select(np.random.default_rng(0).integers(0, len(ensemble), 75))
    angle, torque = drawn.angle, drawn.torque
    methods = {each.name: each.method for each in tv.study.Experiment().analyses}
    moments: dict[str, Callable[[], object]] = {
        "eirf": lambda: lagged_moments(angle, torque, 15),
        "sds": lambda: lagged_moments(angle, torque, 15),
        "birf": lambda: lagged_moments(angle, torque, HALF_WIDTH),
        "esm": lambda: [
            window_moments(a, b, 15, 14)
            for a, b in ((angle, angle), (torque, angle), (torque, torque))
        ],
    }
    table = Table(title="second moments in an identification", title_justify="left")
    for heading in ("method", "identification, ms", "moments, ms", "share, %"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        for key, of_moments in moments.items():
            method = methods[key]
            whole, part = np.transpose(
                [(timed(lambda: method.identify(drawn)), timed(of_moments)) for _ in range(REPEATS)]  # noqa: B023
            )
            share = 100 * median(part) / median(whole)
            table.add_row(
                key, f"{1000 * median(whole):.1f}", f"{1000 * median(part):.1f}", f"{share:.0f}"
            )
    return table


def timed(call: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
