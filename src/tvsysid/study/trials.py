"""Cases of a simulation study: scenarios, of which each trial is a draw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import attrs
import cloudpickle
import numpy as np

from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import Simulation
from tvsysid.study.dataset import AXES, SIMULATIONS, complete, dataset_of
from tvsysid.study.measure import Rows, Truth
from tvsysid.study.scenarios import Scenario, Study
from tvsysid.study.tasks import Case, Task, digest_of, pickled
from tvsysid.validators import settings_of

if TYPE_CHECKING:
    import xarray as xr

SIMULATED_HZ = 1000.0  # rate of a simulation at least; it is a multiple of the decimated rate
TRAITS = ("profile", *Scenario._fields[1:])  # coordinates of a scenario in the results


@attrs.frozen(kw_only=True)
class Simulated(Case):
    """Scenario of a simulation study.

    Parameters
    ----------
    scenario, seed
        What is simulated, and its random seed, to which the number of the trial is added.
    simulated
        Pickled system and perturbation.
    digests
        What distinguishes systems, profiles and perturbations with the same label.
    rate, period, subtract_mean
        Those of the study.
    """

    scenario: Scenario
    seed: np.random.SeedSequence
    simulated: bytes = attrs.field(repr=False)
    digests: Mapping[str, str]
    rate: float
    period: float
    subtract_mean: bool

    def draw(self, number: int) -> tuple[Ensemble, Truth]:
        """Simulate a trial."""
        simulation = self.simulate(number)
        ensemble = self.cut(simulation.recording)
        return ensemble, self.truth(simulation, ensemble)

    def simulate(self, trial: int) -> Simulation:
        """Simulate the recording of a trial."""
        system, perturbation = cloudpickle.loads(self.simulated)
        key = (*self.seed.spawn_key, trial)
        simulation: Simulation = system.simulate(
            self.scenario.duration_s,
            perturbation=perturbation,
            snr_db=self.scenario.snr_db,
            seed=np.random.SeedSequence(self.seed.entropy, spawn_key=key),
            rate=self.rate * max(1, -(-SIMULATED_HZ // self.rate)),
        )
        return simulation

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


def case_of(study: Study, scenario: Scenario) -> Simulated:
    """Return the case of a scenario."""
    parts = study.simulated(scenario)
    further = settings_of(parts[0]).values()
    names = (
        f"{kind} {getattr(scenario, kind)}" for kind in ("system", "stiffness", "perturbation")
    )
    return Simulated(
        label=scenario.label,
        scenario=scenario,
        seed=study.seed_of(scenario),
        simulated=pickled(f"scenario {scenario.label}", parts, *parts, *further),
        digests={name: digest_of(study.parts[name]) for name in names if name in study.parts},
        rate=study.rate,
        period=study.period,
        subtract_mean=study.subtract_mean,
    )


def trials_of(study: Study) -> list[Task]:
    """Return a task for each trial, the longest first."""
    named, tasks = study.named_methods, []
    methods = {label: pickled(f"method {label}", method) for label, method in named.items()}
    rows = sorted(enumerate(study.scenarios), key=lambda item: -item[1].duration_s)
    for row, scenario in rows:
        asked = [label for label in methods if label in study.methods_of[scenario]]
        task = Task(
            case=case_of(study, scenario),
            draws=(0,),
            methods={label: methods[label] for label in asked},
            digests={label: digest_of(named[label]) for label in asked},
            row=row,
            columns=[list(methods).index(label) for label in asked],
        )
        tasks += [attrs.evolve(task, draws=(trial,)) for trial in range(study.trials)]
    return tasks


def results_of_trials(study: Study, rows: Rows) -> xr.Dataset:
    """Return the results of all trials."""
    scenarios, methods = study.scenarios, list(study.named_methods)
    labels = [each.label for each in scenarios], range(study.trials), methods
    coordinates = dict(zip(AXES[0], labels, strict=True))
    results = dataset_of(coordinates, rows, study.period, study.rate)
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
