"""Task of a simulation study: one trial, simulated once and identified by every method."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import NamedTuple

import attrs
import cloudpickle
import numpy as np

from tvsysid.errors import DataQualityWarning
from tvsysid.models import Model
from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import Perturbation, Simulation, System
from tvsysid.simulate.simulation import checked_simulation
from tvsysid.study import task
from tvsysid.study.task import Known, Outcome, Row

STAGES = ("simulation", "preprocessing", "bands", "scoring")  # what takes time beside the methods
SIMULATED_HZ = 1000.0
"""Rate of a simulation, which is decimated.

A little more where the rate after decimation is no part of it.
"""


class Setting(NamedTuple):
    """How a trial is simulated and cut, and which quantities and pathways are measured."""

    duration_s: float
    snr_db: float
    rate: float  # after decimation
    period: float
    quantities: tuple[str, ...]
    pathways: tuple[str, ...]
    scheduled: Mapping[str, int] = {}
    subtract_mean: bool = False

    def simulated(
        self, system: System, perturbation: Perturbation, seed: np.random.SeedSequence
    ) -> Simulation:
        """Record a system."""
        rate = self.rate * max(1, -(-SIMULATED_HZ // self.rate))
        made = system.simulate(
            self.duration_s, perturbation=perturbation, snr_db=self.snr_db, seed=seed, rate=rate
        )
        return checked_simulation(made, type(system).__name__)

    def cut(self, recording: Recording) -> Ensemble:
        """Return the realizations of a simulated recording."""
        return segment(decimate(recording, self.rate), self.period)

    def torques(self, simulation: Simulation) -> dict[str, Array]:
        """Return the noiseless ``"torque"`` and pathways, such as ``"reflex pathway"``.

        (realization, time).
        """
        beside = {
            f"{name} pathway": simulation.pathways[name]
            for name in self.pathways
            if name in simulation.pathways
        }
        cut = self.cut(
            attrs.evolve(simulation.noiseless, channels=beside)
        )  # a pathway may be at rest, a torque may not
        torques = {name: np.asarray(cut.signal(name)[:, cut.core]) for name in ("torque", *beside)}
        return (
            {name: each - each.mean(axis=0) for name, each in torques.items()}
            if self.subtract_mean
            else torques
        )


@attrs.frozen(kw_only=True)
class Trial(task.Task):
    """One trial of one scenario, as sent to a worker.

    System and perturbation (``simulated``) are pickled.

    Only the methods ``asked`` identify it; the others have no numbers, and did not fail.
    """

    setting: Setting
    simulated: bytes
    seed: np.random.SeedSequence
    asked: frozenset[str]

    def work(self) -> Outcome:
        """Simulate the trial and identify it by each method.

        Gives arrays of ``shapes``, ``warnings`` and ``failure``, each over (method, ...),
        ``stage_seconds`` over (stage,) and ``trial_truth`` over (quantity, time). Where a method
        failed its numbers are NaN and ``failure`` says why.
        """
        setting, clock = self.setting, task.Clock(STAGES)
        with clock.stage("simulation"):
            system, perturbation = cloudpickle.loads(self.simulated)
            simulation = setting.simulated(system, perturbation, self.seed)
        with clock.stage("preprocessing"):
            ensemble = setting.cut(simulation.recording)
            if setting.subtract_mean:
                ensemble = subtract_mean(ensemble)
            torques = setting.torques(simulation)
            truth = true_values(simulation, ensemble, setting.quantities)
            known: Known = {name: torques.get(f"{name} pathway") for name in setting.pathways}

        def measure(model: Model) -> Row:
            with clock.stage("bands"):
                bands = _bands(model, truth, setting.quantities)
            with clock.stage("scoring"):
                own = model.pathways(ensemble)
                estimate = {"estimate": task.over_time(model, setting.quantities)}
                estimate |= task.over_schedule(model, setting.scheduled)
                explained = task.explained(
                    torques["torque"], np.asarray(sum(own.values())), ensemble.sampling_rate
                )
                return bands | estimate | explained | task.of_pathways(own, known)

        rows = [
            self.attempt(label, ensemble, measure) if label in self.asked else task.failed("")
            for label in self.methods
        ]
        return self._outcome(rows, list(clock.seconds.values()), truth)

    def all_failed(self, reason: str) -> Outcome:
        """Return the outcome without any result."""
        unknown = np.full(self.shapes["estimate"], np.nan)
        return self._outcome(
            [task.failed(reason)] * len(self.methods), [np.nan] * len(STAGES), unknown
        )

    def _outcome(self, rows: list[Row], seconds: list[float], truth: Array) -> Outcome:
        texts = {
            "warnings": task.as_text(["; ".join(dict.fromkeys(row["warnings"])) for row in rows]),
            "failure": task.as_text([row["failure"] for row in rows]),
        }
        return (
            task.stacked(rows, self.shapes)
            | texts
            | {"stage_seconds": np.array(seconds), "trial_truth": truth}
        )


def true_values(simulation: Simulation, ensemble: Ensemble, quantities: tuple[str, ...]) -> Array:
    """Return the mean truth over an ensemble's realizations, (quantity, time).

    NaN where it does not.
    """
    known = simulation.truth_of(ensemble)
    return np.stack(
        [
            _mean(known[name]) if name in known else np.full(ensemble.samples, np.nan)
            for name in quantities
        ]
    )


def _mean(values: Array) -> Array:
    """Return the mean over the first axis, exact where all values are equal."""
    return np.asarray(values[0] if (values == values[0]).all() else values.mean(axis=0))


def _bands(model: Model, truth: Array, quantities: tuple[str, ...]) -> Row:
    """Return standard errors, and whether the 95 % bands hold the truth (1, 0, NaN).

    (quantity, time).
    """
    covered, errors = np.full((2, *truth.shape), np.nan)
    for place, name in enumerate(quantities):
        estimate = model.estimates.get(name)
        if estimate is None or estimate.axes != ("time",) or estimate.error is None:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # that there is no band
            lower, upper = estimate.band()
            error = estimate.standard_error
        known = np.isfinite(lower) & np.isfinite(upper) & np.isfinite(truth[place])
        covered[place] = np.where(known, (lower <= truth[place]) & (truth[place] <= upper), np.nan)
        if error is not None:
            errors[place] = np.where(np.isfinite(error.values), error.values, np.nan)
    return {"covered": covered, "standard_error": errors}
