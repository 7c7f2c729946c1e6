"""Measure what tuned settings gain over the paper's.

Run ``python benchmarks/tuning.py`` from the repository root.

The paper's simulation study, each method with its own settings and with settings chosen anew in
each trial, on the same data. For each scenario and method the total error of stiffness in N·m/rad,
with the paper's settings and tuned, the change in per cent with the standard error of the trials'
mean difference, and the seconds that a tuned identification took on average and at most.

With 100 trials it takes some hours of processor time, most of it the tuning. Name a ``--store``:
what was finished is then kept, and a run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table

import tvsysid as tv

TUNED = ":tuned=true"
COLUMNS = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()


def main() -> None:
    parser = argparse.ArgumentParser(description="What tuned settings gain over the paper's.")
    parser.add_argument("--stiffness", nargs="+", help="of the study only these profiles")
    parser.add_argument("--perturbations", nargs="+", help="only these")
    parser.add_argument("--durations", nargs="+", type=float, help="only these, in s")
    parser.add_argument("--methods", nargs="+", default=["kbr", "birf"])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--store", type=Path, help="folder that keeps the results")
    chosen = parser.parse_args()
    methods = [key + rest for key in chosen.methods for rest in ("", TUNED)]
    part = {
        "stiffness": chosen.stiffness,
        "perturbation": chosen.perturbations,
        "duration_s": chosen.durations,
    }
    given = {name: values for name, values in part.items() if values}
    study = tv.studies.preset("paper", methods=methods, trials=chosen.trials, **given)
    console = Console(width=None if sys.stdout.isatty() else 150)
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(*COLUMNS, disable=not sys.stdout.isatty()) as bar,
    ):
        task = bar.add_task("")
        results = tv.study.run(
            study,
            folder=chosen.store or folder,
            workers=chosen.workers,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        ).load()
    scores = tv.study.score(results)
    for key in chosen.methods:
        console.print(table(key, results, scores))


def table(key: str, results: xr.Dataset, scores: xr.Dataset) -> Table:
    """A row for each scenario."""
    shown = Table(
        title=f"{key}: total error of stiffness, {results.sizes['trial']} trials",
        title_justify="left",
    )
    shown.add_column("scenario")
    for heading in ("paper, N·m/rad", "tuned, N·m/rad", "change, %", "±", "seconds", "at most"):
        shown.add_column(heading, justify="right")
    error = scores.sel(metric="total_error")
    before, after = error.sel(method_key=key), error.sel(method_key=key + TUNED)
    for scenario in results.scenario.values:
        one, other = before.sel(scenario=scenario), after.sel(scenario=scenario)
        if np.isnan(one.value) or np.isnan(other.value):
            continue
        spread = float(np.nanstd(other.replicates / one.replicates))
        seconds = results.seconds.sel(scenario=scenario, method_key=key + TUNED)
        shown.add_row(
            str(scenario),
            f"{float(one.value):.2f}",
            f"{float(other.value):.2f}",
            f"{100 * (float(other.value / one.value) - 1):+.1f}",
            f"{100 * spread:.1f}",
            f"{float(seconds.mean()):.2f}",
            f"{float(seconds.max()):.2f}",
        )
    return shown


if __name__ == "__main__":
    main()
