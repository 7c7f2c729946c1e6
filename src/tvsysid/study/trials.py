"""Trials of a simulation study: each is simulated once and identified by every method."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

import attrs
import cloudpickle
import numpy as np

from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import Simulation
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
TRAITS = ("profile", *Scenario._fields[1:])  # coordinates of a scenario in the results


@attrs.frozen(kw_only=True)
class Trial(Task):
    """One trial of one scenario.

    Parameters
    ----------
    scenario, seed
        What is simulated, and its random seed.
    simulated
        Pickled system and perturbation.
    rate, period, subtract_mean
        Those of the study.
    asked
        Labels of the methods that identify it. The others have no scores.
    """

    scenario: Scenario
    seed: np.random.SeedSequence
    simulated: bytes = attrs.field(repr=False)
    rate: float
    period: float
    subtract_mean: bool
    asked: tuple[str, ...]

    def scores(self) -> Scores:
        """Simulate the trial, identify it by each method, and score the models.

        Variables of :func:`measure` are over the methods.
        """
        clock = [time.perf_counter()]
        simulation = self.simulate()
        clock.append(time.perf_counter())
        ensemble = self.cut(simulation.recording)
        truth = self.truth(simulation, ensemble)
        clock.append(time.perf_counter())
        rows = [
            self.measure(label, ensemble, truth) if label in self.asked else {}
            for label in self.methods
        ]
        scores = stack(rows)
        clock.append(time.perf_counter())
        stages = np.diff(clock) - [0, 0, np.nansum(scores["seconds"])]
        return scores | {
            "warnings": np.char.replace(scores["warnings"], "\n", "; "),
            "stage_seconds": stages,
            **{f"truth/{name}": values for name, values in truth.quantities.items()},
        }

    def simulate(self) -> Simulation:
        """Simulate the recording."""
        system, perturbation = cloudpickle.loads(self.simulated)
        made = system.simulate(
            self.scenario.duration_s,
            perturbation=perturbation,
            snr_db=self.scenario.snr_db,
            seed=self.seed,
            rate=self.rate * max(1, -(-SIMULATED_HZ // self.rate)),
        )
        return checked_simulation(made, type(system).__name__)

    def cut(self, recording: Recording) -> Ensemble:
        """Return the realizations of the recording, as methods get them."""
        ensemble = segment(decimate(recording, self.rate), self.period)
        return subtract_mean(ensemble) if self.subtract_mean else ensemble

    def truth(self, simulation: Simulation, ensemble: Ensemble) -> Truth:
        """Return the noiseless torque, and the quantities' means over realizations."""
        pathways = simulation.pathways if len(simulation.pathways) > 1 else {}
        channels = {f"{name} pathway": torque for name, torque in pathways.items()}
        noiseless = attrs.evolve(simulation.noiseless, channels=channels)
        cut = segment(decimate(noiseless, self.rate), self.period)

        def torque(name: str) -> Array:
            values = np.asarray(cut.signal(name)[:, cut.core])
            return values - values.mean(axis=0) if self.subtract_mean else values

        return Truth(
            torque("torque"),
            {name: _mean(each) for name, each in simulation.truth_of(ensemble).items()},
            {name: torque(f"{name} pathway") for name in pathways},
        )


def _mean(values: Array) -> Array:
    """Return the mean over the first axis, exact where all values are equal."""
    return np.asarray(values[0] if (values == values[0]).all() else values.mean(axis=0))


def trials_of(study: Study) -> dict[tuple[int, int], Trial]:
    """Return the trials by the places of scenario and trial, the longest first."""
    named = study.named_methods
    methods = {label: pickled(f"method {label}", method) for label, method in named.items()}
    digests, tasks = digests_of(named | study.parts), {}
    scenarios = sorted(enumerate(study.scenarios), key=lambda item: -item[1].duration_s)
    for place, scenario in scenarios:
        parts = study.simulated(scenario)
        further = settings_of(parts[0]).values()
        simulated = pickled(f"scenario {scenario.label}", parts, *parts, *further)
        for number in range(study.trials):
            tasks[place, number] = Trial(
                label=f"trial {number} of {scenario.label}",
                digests=digests,
                methods=methods,
                scenario=scenario,
                seed=study.seed_of(scenario, number),
                simulated=simulated,
                rate=study.rate,
                period=study.period,
                subtract_mean=study.subtract_mean,
                asked=tuple(label for label in methods if label in study.methods_of[scenario]),
            )
    return tasks


def results_of_trials(study: Study, scores: Mapping[tuple[int, int], Scores]) -> xr.Dataset:
    """Return the results of all trials, from the scores by the places of scenario and trial."""
    scenarios, methods = study.scenarios, list(study.named_methods)
    results = dataset_of(
        [scores[place] for place in sorted(scores)],
        {"scenario": [each.label for each in scenarios], "trial": range(study.trials)},
        {"method_key": methods},
        {"statistic": STATISTICS, "stage": STAGES},
        period=study.period,
        rate=study.rate,
    )
    asked = [[label in study.methods_of[each] for label in methods] for each in scenarios]
    columns = zip(TRAITS, zip(*scenarios, strict=True), strict=True)
    results = results.assign_coords(
        {name: ("scenario", list(values)) for name, values in columns}
        | {"asked": (("scenario", "method_key"), asked)}
    )
    truth = results.truth.values
    if np.allclose(truth, truth[:, :1], rtol=1e-6, equal_nan=True):
        results = results.assign(truth=results.truth.isel(trial=0, drop=True))
    else:
        results = results.assign(truth=results.truth.mean("trial"), trial_truth=results.truth)
    return complete(results, SIMULATIONS, study=study.to_json())
