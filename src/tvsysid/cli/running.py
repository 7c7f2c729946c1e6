"""Run a study from the command line, and print what became of its tasks."""

from __future__ import annotations

import shlex
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import errors, remark, say_written, show_table, shown_progress
from tvsysid.cli.options import Workers
from tvsysid.errors import InputError
from tvsysid.progress import Progress

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import pandas as pd
    import xarray as xr

    from tvsysid.report.sections import Problem

RESULTS = "results.nc"  # file of a study's results, in its folder
SCHEDULER_TIMEOUT = "10s"
RESUMES = "what is finished is kept, and the same command resumes"
VERDICTS = {"holds": "✓", "does not hold": "✗", "undecided": "?"}
PROBLEMS = {
    "failed": "failed and are left out",
    "skipped": "were skipped",
    "warning": "gave warnings",
}


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


def run_study(
    study_run: Callable[..., xr.Dataset], out: Path, title: str, workers: Workers
) -> xr.Dataset:
    """Run the missing tasks of a study in a folder, with progress.

    Parameters
    ----------
    study_run
        Function that runs them, of folder, workers, executor and progress.
    out
        Folder of the study.
    title
        Description of the study.
    workers
        Processes to use.
    """
    make_folder(out)
    try:
        with shown_progress(title) as advance, _executor(workers) as (executor, processes):
            return study_run(
                folder=out,
                workers=processes,
                executor=executor,
                progress=_with_start(advance),
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {RESUMES}") from None
    except OSError as error:
        raise InputError(
            f"{error.filename or out}: {error.strerror or error}; {RESUMES}"
        ) from error


def _with_start(advance: Progress) -> Progress:
    """Print at the first call how many tasks are done already."""
    calls: list[int] = []

    def count(done: int, total: int) -> None:
        if done and not calls:
            errors.print(f"resuming: {done} of {total} tasks are done already")
        calls.append(done)
        advance(done, total)

    return count


@contextmanager
def _executor(workers: Workers) -> Iterator[tuple[Executor | None, int | None]]:
    """Yield the executor of a Dask cluster, or None, and the number of processes."""
    if workers.scheduler is None:
        yield None, workers.workers
        return
    try:
        from distributed import Client

        client: Any = Client(workers.scheduler, timeout=SCHEDULER_TIMEOUT)  # type: ignore[no-untyped-call]
    except ImportError as error:
        raise InputError("--scheduler needs Dask: pip install 'tvsysid[dask]'") from error
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {workers.scheduler}: no Dask scheduler answers there ({error}); check "
            "the address"
        ) from error
    with client:
        threads = sum(client.nthreads().values())
        yield client.get_executor(pure=False), workers.workers or threads


def show_claims(claims: pd.DataFrame, about: str, need: str) -> None:
    """Print the verdicts on published claims; ``need`` says what the other claims need."""
    studied = claims[claims.verdict != "not studied"]
    records = [
        {"claim": claim, "verdict": f"{VERDICTS[verdict]} {verdict}"}
        for claim, verdict in zip(studied.claim, studied.verdict, strict=True)
    ]
    missing = len(claims) - len(studied)
    title = f"published claims about {about}"
    title += f"; {missing} more need {need}" if missing else ""
    show_table(title, records, {"claim": "{claim}", "verdict": "{verdict}"})


def show_end(out: Path, files: Iterable[str], problems: Iterable[Problem]) -> bool:
    """Print failures, warnings and files; return whether no method failed."""
    complete = True
    for each in problems:
        failed = each["kind"] == "failed"
        complete = complete and not failed
        text = "{method}: {count} of {trials} {what}; the first: {first}"
        remark("error" if failed else "warning", text.format(what=PROBLEMS[each["kind"]], **each))
    say_written(out, [*files, RESULTS])
    return complete
