"""Run a study from the command line, here or on a Dask cluster."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import errors, say, shown_progress
from tvsysid.cli.options import Workers
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from tvsysid.study import Experiment, Prepared, Study


def command_line() -> str:
    """Return the command as it was typed."""
    return shlex.join(["tvsysid", *sys.argv[1:]])


@contextmanager
def opened(workers: Workers) -> Iterator[Executor | None]:
    """Open the executor of a study; None is this process."""
    from tvsysid.study.workers import cores, local_workers

    if workers.scheduler is None:
        with local_workers(workers.workers or cores()) as pool:
            yield pool
    else:
        with _dask_client(workers.scheduler) as client:
            yield client.get_executor(pure=False)


def run_study(
    study: Study | Experiment,
    out: Path,
    workers: Workers,
    executor: Executor | None,
    prepared: Sequence[Prepared] = (),
) -> xr.Dataset:
    """Run the missing tasks of a study in a folder, with progress."""
    from tvsysid.study import run

    for module in ("xarray", "matplotlib.pyplot"):  # for the results; loaded while workers run
        Thread(target=import_module, args=(module,)).start()
    with shown_progress("running") as progress:
        return run(
            study,
            out,
            prepared=prepared,
            workers=workers.workers,
            executor=executor,
            progress=progress,
        )


def show_plan(
    study: Study | Experiment, workers: Workers, draws: str, prepared: Sequence[Prepared] = ()
) -> int:
    """Print how long a study will take, from one draw of each case; return the exit code.

    ``draws`` says what is drawn, ``prepared`` are the recordings of an experiment.
    """
    from tvsysid.study import cores, estimate_duration

    with errors.status("timing a draw of each case"):
        methods, identifications, seconds = estimate_duration(study, prepared)
    seconds /= workers.workers or cores()
    time = f"about {seconds / 60:,.0f} min" if seconds > 90 else f"about {seconds:.0f} s"
    say(
        f"methods: {', '.join(methods)}\n{draws}: {identifications:,} identifications\n"
        f"{time}, beside the start and the figures; nothing was run"
    )
    return 0


def _dask_client(scheduler: str) -> Any:
    try:
        from distributed import Client

        return Client(scheduler, timeout="10s")  # type: ignore[no-untyped-call]
    except (ImportError, OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); check the "
            "address, and that Dask is installed: pip install 'tvsysid[dask]'"
        ) from error
