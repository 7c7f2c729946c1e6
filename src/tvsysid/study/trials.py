"""Trials of a simulation study: each is simulated once and identified by every method."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import attrs
import cloudpickle
import numpy as np

from tvsysid.errors import InputError, describe_error
from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import Perturbation, Simulation, System
from tvsysid.simulate.simulation import checked_simulation
from tvsysid.study.dataset import SIMULATIONS, complete, dataset_of
from tvsysid.study.measure import STATISTICS, Scores, Truth, stack
from tvsysid.study.scenarios import Scenario, Study
from tvsysid.study.tasks import Task, digests_of, pickled
from tvsysid.validators import settings_of

if TYPE_CHECKING:
    import xarray as xr

STAGES = ("simulation", "preprocessing", "scoring")  # of a trial, beside the identifications
SIMULATED_HZ = 1000.0  # rate of a simulation at least; it is a multiple of the decimated rate


class Setting(NamedTuple):
    """How a trial is simulated and cut into realizations."""

    duration_s: float
    snr_db: float
    rate: float  # after decimation
    period: float
    subtract_mean: bool = False

    @classmethod
    def of(cls, study: Study, scenario: Scenario) -> Setting:
        """Return the setting of a scenario."""
        return cls(
            scenario.duration_s, scenario.snr_db, study.rate, study.period, study.subtract_mean
        )

    def simulate(
        self, system: System, perturbation: Perturbation, seed: np.random.SeedSequence
    ) -> Simulation:
        """Simulate a recording."""
        rate = self.rate * max(1, -(-SIMULATED_HZ // self.rate))
        made = system.simulate(
            self.duration_s, perturbation=perturbation, snr_db=self.snr_db, seed=seed, rate=rate
        )
        return checked_simulation(made, type(system).__name__)

    def cut(self, recording: Recording) -> Ensemble:
        """Return the realizations of a simulated recording, as methods get them."""
        ensemble = self._segment(recording)
        return subtract_mean(ensemble) if self.subtract_mean else ensemble

    def truth(self, simulation: Simulation, ensemble: Ensemble) -> Truth:
        """Return the noiseless torque, and the quantities' means over realizations."""
        pathways = simulation.pathways if len(simulation.pathways) > 1 else {}
        channels = {f"{name} pathway": torque for name, torque in pathways.items()}
        cut = self._segment(attrs.evolve(simulation.noiseless, channels=channels))
        torques = {name: cut.signal(name)[:, cut.core] for name in ("torque", *channels)}
        if self.subtract_mean:
            torques = {name: torque - torque.mean(axis=0) for name, torque in torques.items()}
        return Truth(
            np.asarray(torques.pop("torque")),
            {name: _mean(each) for name, each in simulation.truth_of(ensemble).items()},
            {name: np.asarray(torques[f"{name} pathway"]) for name in pathways},
        )

    def _segment(self, recording: Recording) -> Ensemble:
        return segment(decimate(recording, self.rate), self.period)


def _mean(values: Array) -> Array:
    """Return the mean over the first axis, exact where all values are equal."""
    return np.asarray(values[0] if (values == values[0]).all() else values.mean(axis=0))


@attrs.frozen(kw_only=True)
class Trial(Task):
    """One trial of one scenario.

    Parameters
    ----------
    simulated
        Pickled system and perturbation.
    asked
        Labels of the methods that identify it. The others have no scores.
    """

    setting: Setting
    simulated: bytes
    seed: np.random.SeedSequence
    asked: frozenset[str]

    def scores(self) -> Scores:
        """Simulate the trial, identify it by each method, and score the models.

        Variables of :func:`measure` are over the methods.
        """
        clock = [time.perf_counter()]
        try:
            system, perturbation = cloudpickle.loads(self.simulated)
            simulation = self.setting.simulate(system, perturbation, self.seed)
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"{self.label} cannot be simulated: {describe_error(error)}"
            ) from error
        clock.append(time.perf_counter())
        ensemble = self.setting.cut(simulation.recording)
        truth = self.setting.truth(simulation, ensemble)
        clock.append(time.perf_counter())
        rows = [
            self.measure(label, ensemble, truth) if label in self.asked else {}
            for label in self.methods
        ]
        scores = stack(rows)
        clock.append(time.perf_counter())
        stages = np.diff(clock)
        stages[-1] -= np.nansum(scores["seconds"])
        return scores | {
            "warnings": np.array(
                [text.replace("\n", "; ") for text in scores["warnings"]], dtype=object
            ),
            "stage_seconds": stages,
            "known_quantity": np.array(list(truth.quantities)),
            "truth": np.array(list(truth.quantities.values())),
        }


class Simulations:
    """Tasks and results of a simulation study."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._methods = {
            label: pickled(f"method {label}", method)
            for label, method in study.named_methods.items()
        }
        self._digests = digests_of(study.named_methods | study.parts)
        self._simulated: dict[Scenario, bytes] = {}

    @property
    def tasks(self) -> dict[tuple[int, int], Task]:
        """Trials by the places of scenario and trial, the longest first."""
        scenarios = list(enumerate(self._study.scenarios))
        scenarios.sort(key=lambda item: -item[1].duration_s)
        return {
            (place, number): self.trial(scenario, number)
            for place, scenario in scenarios
            for number in range(self._study.trials)
        }

    def trial(
        self, scenario: Scenario, number: int, methods: frozenset[str] = frozenset()
    ) -> Trial:
        """Return a trial of any scenario, by some methods or those of the scenario."""
        study, seed = self._study, self._study.seed_of(scenario, number)
        asked = methods or study.methods_of[scenario]
        setting = Setting.of(study, scenario)
        if scenario not in self._simulated:
            system, perturbation = study.simulated(scenario)
            parts = (system, perturbation, *settings_of(system).values())
            label = f"scenario {scenario.label}"
            self._simulated[scenario] = pickled(label, (system, perturbation), parts)
        return Trial(
            label=f"trial {number} of {scenario.label}",
            methods=self._methods,
            settings={
                "scenario": scenario,
                "setting": setting,
                "seed": [seed.entropy, seed.spawn_key],
                "methods": [(label, label in asked) for label in self._methods],
                "digests": self._digests,
            },
            setting=setting,
            simulated=self._simulated[scenario],
            seed=seed,
            asked=asked,
        )

    def results(self, scores: Mapping[tuple[int, int], Scores]) -> xr.Dataset:
        """Return the results of all trials."""
        study = self._study
        labels, methods = [each.label for each in study.scenarios], list(study.named_methods)
        asked = np.array(
            [[label in study.methods_of[each] for label in methods] for each in study.scenarios]
        )
        traits = ("profile", "perturbation", "duration_s", "snr_db", "viscosity", "system")
        results = dataset_of(
            scores,
            {"scenario": labels, "trial": range(study.trials)},
            {"method_key": methods},
            {"statistic": list(STATISTICS), "stage": list(STAGES)},
            period=study.period,
            rate=study.rate,
        )
        columns = dict(zip(traits, zip(*study.scenarios, strict=True), strict=True))
        results = results.assign_coords(
            {name: ("scenario", list(values)) for name, values in columns.items()}
        )
        if not asked.all():
            results = results.assign_coords(asked=(("scenario", "method_key"), asked))
        results = _with_truth(results)
        return complete(results, SIMULATIONS, study=study.to_json())


def _with_truth(results: xr.Dataset) -> xr.Dataset:
    """Return results with the truth of each scenario, and that of each trial where they differ."""
    by_trial = results.truth.transpose("scenario", "trial", "quantity", "time")
    first = by_trial.isel(trial=0)
    if np.allclose(by_trial, first.expand_dims(trial=1, axis=1), rtol=1e-6, equal_nan=True):
        return results.assign(truth=first.drop_vars("trial"))
    return results.assign(truth=by_trial.mean("trial"), trial_truth=by_trial)
