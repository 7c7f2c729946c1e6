"""How a long study is run from the command line: its folder, its workers, and what happens when it is interrupted."""

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
PATIENCE = "10s"  # how long a Dask scheduler may take to answer


def check_folder(out: Path) -> None:
    """Report a folder that cannot be made or written to before the work, not after it."""
    there = next(each for each in (out, *out.resolve().parents) if each.exists())
    if not there.is_dir():
        raise InputError(f"{there}: expected a folder, this is a file; give a folder with --out")
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise InputError(
            f"{there}: cannot write to this folder: {error.strerror}; give another with --out"
        ) from error


def command_line() -> str:
    """The command as it can be typed again."""
    return shlex.join(["tvsysid", *sys.argv[1:]])


def run_in(
    out: Path,
    study_run: Callable[..., xr.Dataset],
    title: str,
    units: str,
    workers: int | None,
    scheduler: str | None,
) -> xr.Dataset:
    """Results of a run with store, workers, executor and progress.

    If it ends early, the message says how to resume.
    """
    kept = [0, 0]

    def count() -> str:
        return f"{kept[0]} of {kept[1]} {units} are" if kept[1] else "what was done is"

    try:
        with progress(title) as advance, _executor(scheduler) as (executor, threads):

            def count_kept(done: int, total: int) -> None:
                if done and not kept[1]:
                    errors.print(f"resuming: {done} of {total} {units} are done already")
                kept[:] = done, total
                advance(done, total)

            at_a_time = threads if workers is None else workers
            return study_run(
                store=out / STORE, workers=at_a_time, executor=executor, progress=count_kept
            )
    except KeyboardInterrupt:
        sys.exit(f"interrupted; {count()} in {out / STORE}; the same command resumes")
    except OSError as error:
        raise InputError(
            f"{error.filename or out}: {error.strerror or error}; {count()} kept; "
            "solve this, and the same command resumes from there"
        ) from error


@contextmanager
def _executor(scheduler: str | None) -> Iterator[tuple[Executor | None, int | None]]:
    """Executor of a Dask cluster and the number of its threads.

    Without a scheduler, None for both.
    """
    if scheduler is None:
        yield None, None
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs Dask: pip install 'tvsysid[dask]'") from error
    try:
        client: Any = Client(scheduler, timeout=PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); check the address"
        ) from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(
                f"--scheduler {scheduler}: this cluster has no workers; start some with `dask "
                f"worker {scheduler}`"
            )
        yield client.get_executor(pure=False), threads


def print_met(results: xr.Dataset, met: list[Problem], units: str, counted: str) -> bool:
    """Print failures, warnings and what is missing; return whether no method failed."""
    there = results.checksums.values.any(axis=-1)
    if not there.all():
        text = (
            f"{there.sum()} of {there.size} {units} are done so far; the command that started "
            "them resumes"
        )
        remark("warning", text)
    for problem in met:
        failed = problem["kind"] == "failed"
        what = {"failed": "failed and are left out", "skipped": "were skipped"}.get(
            problem["kind"], "gave warnings"
        )
        text = "{method}: {count} of {trials} {counted} {what}; the first: {first}"
        remark("error" if failed else "warning", text.format(what=what, counted=counted, **problem))
    return not any(problem["kind"] == "failed" for problem in met)


def show_claims(claims: pd.DataFrame, of: str, need: str) -> None:
    """Print the verdicts on the paper's claims.

    `need` says what the claims without a verdict need.
    """
    symbols = {"holds": "✓", "does not hold": "✗", "undecided": "?"}
    studied = claims[claims.verdict != "not studied"]
    rows = [
        (claim, f"{symbols[verdict]} {verdict}")
        for claim, verdict in zip(studied.claim, studied.verdict, strict=True)
    ]
    missing = len(claims) - len(studied)
    caption = f"{missing} more of its claims need {need}" if missing else None
    show_table(f"published claims about {of}", ["claim", "verdict"], rows, "ll", caption)
