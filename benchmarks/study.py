"""Where the time of a study goes: run ``python benchmarks/study.py`` from the repository root.

Runs a study (``--preset paper`` for the whole of the paper's) with one process and with as many
as there are cores, and prints for each stage the simulated seconds that it gets through in a
second, what writing the results costs beside the trials, and the most memory that all processes
held at once (proportional set size; Linux only).
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time

import xarray as xr
from memory import watched_memory
from rich.console import Console
from rich.table import Table

import tvsysid as tv


def main() -> None:
    parser = argparse.ArgumentParser(description="Where the time of a study goes.")
    parser.add_argument("--preset", default="quick", choices=tv.studies.PRESETS)
    parser.add_argument("--workers", type=int, nargs="*", default=sorted({1, os.cpu_count() or 1}))
    chosen = parser.parse_args()
    study = tv.studies.preset(chosen.preset)
    console = Console()
    first = None
    for workers in chosen.workers:
        results, seconds, memory = timed(study, workers)
        first = first or seconds
        console.print(
            stages_table(
                results, seconds, f"{chosen.preset}, {workers} process{'es' * (workers > 1)}"
            )
        )
        simulated = float(results.duration_s.sum()) * study.trials
        console.print(
            f"{seconds:.1f} s, {simulated / seconds:,.0f} simulated seconds per second, "
            f"{first / seconds:.2f} x as fast as with {chosen.workers[0]} process(es); peak memory "
            f"{memory / 2**20:,.0f} MiB\n",
            highlight=False,
        )


def timed(study: tv.study.Study, workers: int) -> tuple[xr.Dataset, float, int]:
    """Results, seconds and bytes."""
    with tempfile.TemporaryDirectory() as folder, watched_memory() as peak:
        started = time.perf_counter()
        results = tv.study.run(study, folder=folder, workers=workers)
        seconds = time.perf_counter() - started
        return results.load(), seconds, peak[0]


def stages_table(results: xr.Dataset, seconds: float, title: str) -> Table:
    """A row for each stage, summed over all workers."""
    simulated = float(results.duration_s.sum()) * results.sizes["trial"]
    spent = results.seconds.sum(["scenario", "trial"]).to_series().to_dict()
    table = Table(
        title=title, title_justify="left", caption="times of all workers, but for the last row"
    )
    table.add_column("stage")
    for heading in ("s", "share, %", "simulated seconds per second"):
        table.add_column(heading, justify="right")
    total = sum(spent.values())
    for name, time_spent in [*spent.items(), ("identification", total)]:
        rate = f"{simulated / time_spent:,.0f}"
        table.add_row(name, f"{time_spent:.1f}", f"{100 * time_spent / total:.0f}", rate)
    table.add_row("from start to end", f"{seconds:.1f}", "", f"{simulated / seconds:,.0f}")
    return table


if __name__ == "__main__":
    main()
