"""The unit of work: simulate one trial, let every method identify it, and score what they found."""

from __future__ import annotations

import platform
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any

import cloudpickle
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from tvsysid import __version__, metrics
from tvsysid.benchmark.study import PERIOD, PERTURBATIONS, RATE, Scenario
from tvsysid.errors import DoubtfulWarning, InputError
from tvsysid.methods.foreign import adopted, is_loose, told
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Ensemble
from tvsysid.simulate import joint

Array = NDArray[np.float64]
Outcome = dict[str, NDArray[Any]]

SAMPLES = round(PERIOD * RATE)
STATISTICS = ("mean", "sd", "lowest")
"""Of the VAFs of a trial's realizations."""
STAGES = ("simulation", "preprocessing", "scoring")
"""What takes time beside the methods."""
STRINGS = ("doubts", "failure")
NUMBERS = {
    "stiffness": (SAMPLES,),
    "time_varying_vaf": (SAMPLES,),
    "vaf": (len(STATISTICS),),
    "bandpassed_vaf": (len(STATISTICS),),
    "parameters": (),
    "seconds": (),
}
"""Measured of each method, and its shape."""


@cache
def versions() -> dict[str, str]:
    """What the last bits of a result depend on; looked up once, for every trial carries it."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "zarr")}
    return {"tvsysid": __version__} | libraries | {"python": platform.python_version()}


@dataclass(frozen=True)
class Trial:
    """One trial of one scenario, as sent to a worker.

    Parameters
    ----------
    scenario, number
        Which it is.
    seed
        Of its simulation.
    methods
        Pickled methods by label. Each is unpickled by itself, so that one that cannot be spoils no other.
    versions
        Software of the process that sends it; a worker with another is refused.
    left_out
        Methods not to be tried, and why.
    """

    scenario: Scenario
    number: int
    seed: np.random.SeedSequence
    methods: Mapping[str, bytes]
    versions: Mapping[str, str] = field(default_factory=versions)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"trial {self.number} of {self.scenario.label}"


def pickled(methods: Mapping[str, Any]) -> dict[str, bytes]:
    """Methods as they travel; a class from a script, notebook or loose file travels whole, for workers lack that.

    Raises
    ------
    InputError
        If one cannot be pickled.
    """
    travelling = {}
    for label, method in methods.items():
        module = sys.modules.get(type(method).__module__)
        by_value = module is not None and is_loose(module)
        if by_value:
            cloudpickle.register_pickle_by_value(module)
        try:
            travelling[label] = cloudpickle.dumps(method)
        except Exception as error:
            raise InputError(f"method {label}: cannot be sent to a worker: {type(error).__name__}: {error}") from error
        finally:
            if by_value:
                cloudpickle.unregister_pickle_by_value(module)
    return travelling


def run_trial(trial: Trial) -> Outcome:
    """Simulate a trial and identify it by each method; one trial at a time in a process.

    Returns
    -------
    dict
        Arrays of ``NUMBERS`` and ``STRINGS``, each over (method, ...), and ``stage_seconds`` over (stage,). Where a
        method failed its numbers are NaN and ``failure`` says why.

    Raises
    ------
    InputError
        If this process has other versions of the software than the one that sent the trial.
    """
    if (here := versions()) != trial.versions:
        raise InputError(f"run: a worker has other software: {differences(trial.versions, here)}")
    # Warnings are caught and BLAS is limited for a whole process: one trial at a time in it.
    with _ONE_AT_A_TIME, _blas().limit(limits=1):
        return _run_trial(trial)


def _run_trial(trial: Trial) -> Outcome:
    scenario = trial.scenario
    clock = _Clock()
    with clock.stage("simulation"):
        simulation = joint(
            scenario.duration_s,
            stiffness=scenario.profile,
            perturbation=PERTURBATIONS[scenario.perturbation],
            snr_db=scenario.snr_db,
            viscosity=scenario.viscosity_profile,
            seed=trial.seed,
        )
    with clock.stage("preprocessing"):
        ensemble = segment(decimate(simulation.recording, RATE), PERIOD)
        noiseless = segment(decimate(simulation.noiseless, RATE), PERIOD)
        torque = noiseless.torque[:, noiseless.core]
    rows = [
        _failed(trial.left_out[label]) if label in trial.left_out else _attempt(method, ensemble, torque, clock)
        for label, method in trial.methods.items()
    ]
    return _stacked(rows, [clock.seconds[stage] for stage in STAGES])


def all_failed(methods: int, reason: str) -> Outcome:
    """Outcome of a trial in which no method gave a result."""
    return _stacked([_failed(reason)] * methods, [np.nan] * len(STAGES))


def differences(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> str:
    """What differs between two mappings, in words."""
    return "; ".join(
        f"{name}: {theirs.get(name, 'nothing')} there, {ours.get(name, 'nothing')} here"
        for name in dict.fromkeys([*theirs, *ours])
        if theirs.get(name) != ours.get(name)
    )


_blas = cache(ThreadpoolController)
_ONE_AT_A_TIME = threading.Lock()


class _Clock:
    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - started


def _stacked(rows: list[dict[str, Any]], seconds: list[float]) -> Outcome:
    outcome: Outcome = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in NUMBERS}
    outcome |= {name: np.array([row[name] for row in rows], dtype=np.dtypes.StringDType()) for name in STRINGS}
    return outcome | {"stage_seconds": np.array(seconds)}


def _failed(reason: str) -> dict[str, Any]:
    return {name: np.full(shape, np.nan) for name, shape in NUMBERS.items()} | {"doubts": "", "failure": reason}


def _attempt(method: bytes, ensemble: Ensemble, torque: Array, clock: _Clock) -> dict[str, Any]:
    # A method that calls sys.exit() has failed like any other.
    try:
        # Unpickled for each trial, so that nothing that it remembers passes from one to the next.
        return _measure(cloudpickle.loads(method), ensemble, torque, clock)
    except (Exception, SystemExit) as error:
        return _failed(told(error))


def _measure(method: Any, ensemble: Ensemble, torque: Array, clock: _Clock) -> dict[str, Any]:
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DoubtfulWarning)
        found = method.identify(ensemble)
    seconds = time.perf_counter() - started
    model = adopted(found, type(method).__name__, ensemble)
    if not np.isfinite(model.stiffness).any():
        raise InputError("it found no stiffness at any time")
    doubts = [str(item.message) for item in caught if issubclass(item.category, DoubtfulWarning)]
    with clock.stage("scoring"):
        predicted = model.predict(ensemble)
        return {
            "stiffness": model.stiffness,
            "time_varying_vaf": metrics.time_varying_vaf(torque, predicted),
            "vaf": _statistics(metrics.vaf(torque, predicted)),
            "bandpassed_vaf": _statistics(metrics.bandpassed_vaf(torque, predicted, RATE)),
            "parameters": model.diagnostics.parameters,
            "seconds": seconds,
            "doubts": "; ".join(dict.fromkeys(doubts)),
            "failure": "",
        }


def _statistics(values: Array) -> Array:
    known = values[np.isfinite(values)]
    return np.array([known.mean(), known.std(), known.min()]) if len(known) else np.full(len(STATISTICS), np.nan)
