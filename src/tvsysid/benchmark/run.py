"""Run a study: each worker simulates one trial and lets every method identify it."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tvsysid import metrics
from tvsysid.benchmark.study import PERIOD, PERTURBATIONS, PROFILES, RATE, Scenario, Study
from tvsysid.errors import DoubtfulWarning, InputError
from tvsysid.preprocess import decimate, segment
from tvsysid.simulate import joint

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Outcome = dict[str, NDArray[Any]]

DTYPES = {"doubts": np.dtypes.StringDType()}
MEASURED = ("stiffness", "time_varying_vaf", "vaf", "bandpassed_vaf", "seconds", "doubts")


def run(
    study: Study,
    *,
    store: str | Path | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> xr.Dataset:
    """Run a study and collect what its metrics are made from.

    Parameters
    ----------
    study
        What to run.
    store
        Zarr store to write the results to when all are there; must not exist yet.
    workers
        Processes; None takes as many as there are cores, 1 works in this one. Each uses one thread. The results do not
        depend on it.
    progress
        Called with the numbers of trials done and in all, after each.

    Returns
    -------
    xarray.Dataset
        ``stiffness`` and ``time_varying_vaf`` over (profile, perturbation, duration_s, snr_db, method_key,
        trial, time), ``vaf`` and ``bandpassed_vaf`` (means over realizations, against the noiseless torque),
        ``seconds`` taken and ``doubts`` (the warnings met, or nothing) without time, and ``true_stiffness`` over
        (profile, time).

    Raises
    ------
    InputError
        If the store exists already, or a method's settings do not fit the data.
    """
    if store is not None and Path(store).exists():
        raise InputError(f"{store}: the store exists already; remove it or give another")
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers!r}")
    tasks = [(scenario, trial) for scenario in study.scenarios for trial in range(study.trials)]
    methods = study.named_methods
    outcomes: dict[tuple[Scenario, int], Outcome] = {}
    for task, outcome in _outcomes(study, methods, tasks, workers or os.cpu_count() or 1):
        outcomes[task] = outcome
        if progress is not None:
            progress(len(outcomes), len(tasks))
    results = _collect(study, list(methods), outcomes)
    if store is not None:
        _write(results, Path(store))
    return results


def run_trial(scenario: Scenario, seed: np.random.SeedSequence, methods: dict[str, Any]) -> Outcome:
    """Simulate one trial and identify it by each method; each value of shape (method,) or (method, time)."""
    simulation = joint(
        scenario.duration_s,
        stiffness=PROFILES[scenario.stiffness],
        perturbation=PERTURBATIONS[scenario.perturbation],
        snr_db=scenario.snr_db,
        seed=seed,
    )
    ensemble = segment(decimate(simulation.recording, RATE), PERIOD)
    noiseless = segment(decimate(simulation.noiseless, RATE), PERIOD)
    torque = noiseless.torque[:, noiseless.core]
    rows = [_measure(method, ensemble, torque) for method in methods.values()]
    return {name: np.array([row[name] for row in rows], dtype=DTYPES.get(name)) for name in MEASURED}


def _measure(method: Any, ensemble: Any, torque: Array) -> dict[str, Any]:
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DoubtfulWarning)
        model = method.identify(ensemble)
    seconds = time.perf_counter() - started
    predicted = model.predict(ensemble)
    return {
        "stiffness": model.stiffness,
        "time_varying_vaf": metrics.time_varying_vaf(torque, predicted),
        "vaf": np.nanmean(metrics.vaf(torque, predicted)),
        "bandpassed_vaf": np.nanmean(metrics.bandpassed_vaf(torque, predicted, RATE)),
        "seconds": seconds,
        "doubts": "; ".join(str(w.message) for w in caught if issubclass(w.category, DoubtfulWarning)),
    }


def _outcomes(
    study: Study, methods: dict[str, Any], tasks: list[tuple[Scenario, int]], workers: int
) -> Iterator[tuple[tuple[Scenario, int], Outcome]]:
    workers = min(workers, len(tasks))
    if workers == 1:
        with threadpool_limits(1):
            for scenario, trial in tasks:
                yield (scenario, trial), run_trial(scenario, study.seed_of(scenario, trial), methods)
        return
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker) as pool:
        queue = iter(tasks)
        pending: dict[Future[Outcome], tuple[Scenario, int]] = {}
        try:
            while True:
                # A few tasks ahead keep the workers busy; more would only take memory.
                for scenario, trial in islice(queue, 2 * workers - len(pending)):
                    future = pool.submit(run_trial, scenario, study.seed_of(scenario, trial), methods)
                    pending[future] = (scenario, trial)
                if not pending:
                    return
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    yield pending.pop(future), future.result()
        except BrokenProcessPool as error:
            raise InputError(
                "run: the worker processes died. A script must call run from under "
                "`if __name__ == '__main__':`, because each worker imports it; or give workers=1"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Keep a worker to its core, and leave an interruption to the parent.

    Lives here, so that BLAS is loaded by the time it is limited.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)


def _collect(study: Study, methods: list[str], outcomes: dict[tuple[Scenario, int], Outcome]) -> xr.Dataset:
    import xarray as xr  # noqa: PLC0415  # heavy

    axes: dict[str, list[Any]] = {
        "profile": list(study.stiffness),
        "perturbation": list(study.perturbation),
        "duration_s": list(study.duration_s),
        "snr_db": list(study.snr_db),
    }
    grid = tuple(len(values) for values in axes.values())
    times = np.arange(round(PERIOD * RATE)) / RATE
    variables: dict[str, Any] = {}
    units = {"stiffness": "N m/rad", "seconds": "s", "doubts": "1"}
    for name in MEASURED:
        stacked = np.stack(
            [
                np.stack([outcomes[scenario, trial][name] for trial in range(study.trials)], axis=1)
                for scenario in study.scenarios
            ]
        )
        dims = (*axes, "method_key", "trial", "time")[: stacked.ndim + 3]
        variables[name] = (dims, stacked.reshape(*grid, *stacked.shape[1:]), {"units": units.get(name, "percent")})
    truth = np.stack([np.asarray(PROFILES[name](times)) for name in study.stiffness])
    variables["true_stiffness"] = (("profile", "time"), truth, {"units": "N m/rad"})
    return xr.Dataset(
        variables,
        coords={
            **axes,
            # Not "method", which xarray's sel() takes for a way to interpolate.
            "method_key": methods,
            "trial": np.arange(study.trials),
            "time": ("time", times, {"units": "s"}),
        },
        attrs={"seed": str(study.seed)},
    )


def _write(results: xr.Dataset, store: Path) -> None:
    """Write the store beside its place and move it there, so that it is whole or absent."""
    store.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=store.parent, prefix=f".{store.name}-"))
    try:
        results.to_zarr(temporary / "store", mode="w", zarr_format=2)
        (temporary / "store").rename(store)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
