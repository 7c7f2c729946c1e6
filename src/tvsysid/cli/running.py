"""Run a study from the command line, here or on a Dask cluster."""

from __future__ import annotations

import shlex
import sys
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

    with shown_progress("running") as advance:
        if workers.scheduler is None:
            return run(study, out, workers=workers.workers, progress=advance, **inputs)
        with _dask_client(workers.scheduler) as client:
            inputs["executor"] = client.get_executor(pure=False)
            count = workers.workers or sum(client.nthreads().values())
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
