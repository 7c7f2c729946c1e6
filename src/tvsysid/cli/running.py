"""Run a study from the command line, here or on a Dask cluster."""

from __future__ import annotations

import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import shown_progress
from tvsysid.cli.options import Workers
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from tvsysid.study import Experiment, Study


def command_line() -> str:
    """Return the command as it was typed."""
    return shlex.join(["tvsysid", *sys.argv[1:]])


def run_study(study: Study | Experiment, out: Path, workers: Workers, **inputs: Any) -> xr.Dataset:
    """Run the missing tasks of a study in a folder, with progress.

    ``inputs`` are further arguments of :func:`tvsysid.study.run`.
    """
    from tvsysid.study import run

    count = workers.workers
    with ExitStack() as stack:
        if workers.scheduler is not None:
            client = stack.enter_context(_dask_client(workers.scheduler))
            inputs["executor"] = client.get_executor(pure=False)
            count = count or sum(client.nthreads().values())
        advance = stack.enter_context(shown_progress("running"))
        return run(study, out, workers=count, progress=advance, **inputs)


def _dask_client(scheduler: str) -> Any:
    try:
        from distributed import Client

        return Client(scheduler, timeout="10s")  # type: ignore[no-untyped-call]
    except (ImportError, OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); check the "
            "address, and that Dask is installed: pip install 'tvsysid[dask]'"
        ) from error
