"""Run a long study from the command line, and print how its tasks ended."""

from __future__ import annotations

import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import errors, progress, remark, show_table
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import pandas as pd
    import xarray as xr

    from tvsysid.report.sections import Problem

STORE = "results.zarr"  # where a study keeps its results, in its folder
SCHEDULER_TIMEOUT = "10s"


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


def run_in(
    out: Path,
    study_run: Callable[..., xr.Dataset],
    title: str,
    units: str,
    workers: int | None,
    scheduler: str | None,
) -> xr.Dataset:
    """Run what is missing of a study in a folder, with progress.

    Parameters
    ----------
    out
        Folder of the study.
    study_run
        Function that runs it, of store, workers, executor and progress.
    title, units
        Name of the study, and of its tasks, for the progress.
    workers, scheduler
        As of the options.
    """
    make_folder(out)
    counts: tuple[int, int] | None = None

    def kept() -> str:
        return f"{counts[0]} of {counts[1]} {units} are" if counts else "finished tasks are"

    try:
        with progress(title) as advance, _executor(scheduler) as (executor, threads):

            def count(done: int, total: int) -> None:
                nonlocal counts
                if done and counts is None:
                    errors.print(f"resuming: {done} of {total} {units} are done already")
                counts = done, total
                advance(done, total)

            return study_run(
                store=out / STORE,
                workers=threads if workers is None else workers,
                executor=executor,
                progress=count,
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; {kept()} in {out / STORE}; the same command resumes"
        ) from None
    except OSError as error:
        raise InputError(
            f"{error.filename or out}: {error.strerror or error}; {kept()} kept; solve this, and "
            "the same command resumes"
        ) from error


@contextmanager
def _executor(scheduler: str | None) -> Iterator[tuple[Executor | None, int | None]]:
    """Connect to a Dask cluster; yield its executor and its number of threads, or None for both."""
    if scheduler is None:
        yield None, None
        return
    try:
        from distributed import Client

        client: Any = Client(scheduler, timeout=SCHEDULER_TIMEOUT)  # type: ignore[no-untyped-call]
    except ImportError as error:
        raise InputError("--scheduler needs Dask: pip install 'tvsysid[dask]'") from error
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); check the address"
        ) from error
    with client:
        yield client.get_executor(pure=False), sum(client.nthreads().values())


def print_problems(results: xr.Dataset, problems: list[Problem], units: str, counted: str) -> bool:
    """Print failures, warnings and how much is missing; return whether no method failed."""
    done = results.checksums.values.any(axis=-1)
    if not done.all():
        remark(
            "warning",
            f"{done.sum()} of {done.size} {units} are done so far; the command that started them "
            "resumes",
        )
    for problem in problems:
        failed = problem["kind"] == "failed"
        what = {"failed": "failed and are left out", "skipped": "were skipped"}.get(
            problem["kind"], "gave warnings"
        )
        text = "{method}: {count} of {trials} {counted} {what}; the first: {first}"
        remark("error" if failed else "warning", text.format(what=what, counted=counted, **problem))
    return not any(problem["kind"] == "failed" for problem in problems)


def show_claims(claims: pd.DataFrame, of: str, need: str) -> None:
    """Print the verdicts on the paper's claims; ``need`` says what the other claims need."""
    symbols = {"holds": "✓", "does not hold": "✗", "undecided": "?"}
    studied = claims[claims.verdict != "not studied"]
    rows = [
        (claim, f"{symbols[verdict]} {verdict}")
        for claim, verdict in zip(studied.claim, studied.verdict, strict=True)
    ]
    missing = len(claims) - len(studied)
    caption = f"{missing} more of its claims need {need}" if missing else None
    show_table(f"published claims about {of}", ["claim", "verdict"], rows, "ll", caption)
