"""The unit of work: simulate one trial, let every method identify it, and score what they found."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import cloudpickle
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.errors import DataQualityWarning, describe_error
from tvsysid.models import Model
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Ensemble
from tvsysid.simulate import PERTURBATIONS, Joint
from tvsysid.study.simulated import PERIOD, RATE, Scenario
from tvsysid.study.task import Outcome, Task, identified, versions

Array = NDArray[np.float64]

SAMPLES = round(PERIOD * RATE)
STATISTICS = ("mean", "sd", "lowest")
"""Of the VAFs of a trial's realizations."""
STAGES = ("simulation", "preprocessing", "bands", "scoring")
"""What takes time beside the methods."""
STRINGS = ("doubts", "failure")
NUMBERS = {
    "stiffness": (SAMPLES,),
    "time_varying_vaf": (SAMPLES,),
    "covered": (SAMPLES,),
    "vaf": (len(STATISTICS),),
    "bandpassed_vaf": (len(STATISTICS),),
    "parameters": (),
    "seconds": (),
}
"""Measured of each method, and its shape."""


@dataclass(frozen=True)
class Trial(Task):
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

    def work(self) -> Outcome:
        """Simulate the trial and identify it by each method.

        Returns
        -------
        dict
            Arrays of ``NUMBERS`` and ``STRINGS``, each over (method, ...), and ``stage_seconds`` over (stage,). Where a
            method failed its numbers are NaN and ``failure`` says why.
        """
        scenario = self.scenario
        clock = _Clock()
        with clock.stage("simulation"):
            simulation = Joint(stiffness=scenario.profile, viscosity=scenario.viscosity_profile).simulate(
                scenario.duration_s,
                perturbation=PERTURBATIONS[scenario.perturbation],
                snr_db=scenario.snr_db,
                seed=self.seed,
            )
        with clock.stage("preprocessing"):
            ensemble = segment(decimate(simulation.recording, RATE), PERIOD)
            noiseless = segment(decimate(simulation.noiseless, RATE), PERIOD)
            torque = noiseless.torque[:, noiseless.core]
            truth = np.asarray(scenario.profile(ensemble.time))
        rows = [
            _failed(self.left_out[label])
            if label in self.left_out
            else _attempt(method, ensemble, torque, truth, clock)
            for label, method in self.methods.items()
        ]
        return _stacked(rows, [clock.seconds[stage] for stage in STAGES])

    def all_failed(self, reason: str) -> Outcome:
        """Outcome where no method gave a result."""
        return _stacked([_failed(reason)] * len(self.methods), [np.nan] * len(STAGES))


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


def _attempt(method: bytes, ensemble: Ensemble, torque: Array, truth: Array, clock: _Clock) -> dict[str, Any]:
    # A method that calls sys.exit() has failed like any other.
    try:
        # Unpickled for each trial, so that nothing that it remembers passes from one to the next.
        return _measure(cloudpickle.loads(method), ensemble, torque, truth, clock)
    except (Exception, SystemExit) as error:
        return _failed(describe_error(error))


def _measure(method: Any, ensemble: Ensemble, torque: Array, truth: Array, clock: _Clock) -> dict[str, Any]:
    started = time.perf_counter()
    model, doubts = identified(method, ensemble)
    seconds = time.perf_counter() - started
    with clock.stage("bands"):
        covered = _covered(model, truth)
    with clock.stage("scoring"):
        predicted = model.predict(ensemble)
        return {
            "stiffness": model.stiffness,
            "time_varying_vaf": metrics.time_varying_vaf(torque, predicted),
            "covered": covered,
            "vaf": _statistics(metrics.vaf(torque, predicted)),
            "bandpassed_vaf": _statistics(metrics.bandpassed_vaf(torque, predicted, RATE)),
            "parameters": model.diagnostics.parameters,
            "seconds": seconds,
            "doubts": "; ".join(dict.fromkeys(doubts)),
            "failure": "",
        }


def _covered(model: Model, truth: Array) -> Array:
    """1 where the 95 % band of the stiffness holds the truth, 0 where not, NaN where there is none; shape (time,)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # that there is no band
        lower, upper = model.estimates["stiffness"].band()
    inside = (lower <= truth) & (truth <= upper)
    return np.where(np.isfinite(lower) & np.isfinite(upper), inside, np.nan)


def _statistics(values: Array) -> Array:
    known = values[np.isfinite(values)]
    return np.array([known.mean(), known.std(), known.min()]) if len(known) else np.full(len(STATISTICS), np.nan)
