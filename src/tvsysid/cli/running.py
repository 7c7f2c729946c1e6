"""Run a study from the command line, and print what became of its tasks."""

from __future__ import annotations

import shlex
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import remark, say, say_written, show_table, shown_progress
from tvsysid.cli.options import Workers
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import pandas as pd
    import xarray as xr

    from tvsysid.report.sections import Problem
    from tvsysid.studies.published_study import Written
    from tvsysid.study import Experiment, Study

RESULTS = "results.nc"  # file of a study's results, in its folder
SCHEDULER_TIMEOUT = "10s"
SCORES = {  # names and formats, by heading
    "method": "method",
    "drawn": "realizations:d",
    "mean": "mean_stiffness:.1f",
    "bias": "bias_error:.1f",
    "random": "random_error:.1f",
    "total": "total_error:.1f",
    "rise": "rise_time:.2f",
    "VAF": "vaf:.1f",
    "VAF\n1-10 Hz": "bandpassed_vaf:.1f",
    "reflex\ngain": "reflex_gain total_error:.1f",
    "reflex\nVAF": "reflex pathway_vaf:.1f",
    "time": "seconds:.3f",
}
UNITS = (
    "stiffness and its errors in N·m/rad (those of the reflex gain in N·m·s/rad), rise and time in "
    "s, VAF in %"
)


def make_folder(out: Path) -> None:
    """Make a folder for results, and check before the work that it can be written to."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out).close()
    except OSError as error:
        raise InputError(
            f"{out}: cannot write to this folder: {error.strerror}; give another with --out"
        ) from error


def command_line() -> str:
    """Return the command as it was typed."""
    return shlex.join(["tvsysid", *sys.argv[1:]])


def run_study(study: Study | Experiment, out: Path, workers: Workers, **inputs: Any) -> xr.Dataset:
    """Run the missing tasks of a study in a folder, with progress.

    ``inputs`` are further arguments of :func:`tvsysid.study.run`.
    """
    from tvsysid.study import run

    make_folder(out)
    with shown_progress("running") as advance, _executor(workers) as (executor, processes):
        return run(study, out, workers=processes, executor=executor, progress=advance, **inputs)


@contextmanager
def _executor(workers: Workers) -> Iterator[tuple[Executor | None, int | None]]:
    """Yield the executor of a Dask cluster, or None, and the number of processes."""
    if workers.scheduler is None:
        yield None, workers.workers
        return
    try:
        from distributed import Client

        client: Any = Client(  # type: ignore[no-untyped-call]
            workers.scheduler, timeout=SCHEDULER_TIMEOUT
        )
    except (ImportError, OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {workers.scheduler}: no Dask scheduler answers there ({error}); check "
            "the address, and that Dask is installed: pip install 'tvsysid[dask]'"
        ) from error
    with client:
        threads = sum(client.nthreads().values())
        yield client.get_executor(pure=False), workers.workers or threads


def show_study(
    tables: Iterable[tuple[str, pd.DataFrame]],
    written: Written,
    results: xr.Dataset,
    out: Path,
    need: str,
) -> int:
    """Print what was written of a study, and return the exit code: 1 if a method failed.

    Parameters
    ----------
    tables
        Title and summary of each table of scores.
    need
        What the claims that were not studied need.
    """
    from tvsysid.report import problems

    for title, summary in tables:
        labels = [name for name in ("method", "realizations") if name in summary]
        scores = summary.pivot_table("value", labels, "metric", sort=False).reset_index()
        show_table(title, scores.to_dict("records"), SCORES)
    say(UNITS)
    studied = written.claims[written.claims.verdict != "not studied"]
    missing = len(written.claims) - len(studied)
    more = f"; {missing} more need {need}" if missing else ""
    columns = {"claim": "claim", "verdict": "verdict"}
    show_table(f"published claims{more}", studied.to_dict("records"), columns)
    for label, diagnosis in written.diagnoses.items():
        if names := ", ".join(finding.name for finding in diagnosis.findings):
            remark("warning", f"{label}: {names} (diagnosis.html says what to do)")
    if written.alignment:
        remark("warning", written.alignment)
    return show_end(out, written.files, problems(results))


def show_end(out: Path, files: Iterable[str], problems: Iterable[Problem]) -> int:
    """Print failures, warnings and files; return the exit code, 1 if a method failed."""
    code = 0
    for each in problems:
        failed = each["kind"] == "failed"
        text = "{method}: {kind} in {count} of {trials}; the first: {first}"
        remark("error" if failed else "warning", text.format(**each))
        code |= failed
    say_written(out, [*files, RESULTS])
    return code
