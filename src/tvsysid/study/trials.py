"""Tasks and results of a simulation study: a case is a scenario, a draw is a trial."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Ensemble
from tvsysid.simulate import Simulation
from tvsysid.study.dataset import dataset_of
from tvsysid.study.measure import Scores, Truth, mean_quantities
from tvsysid.study.scenarios import Scenario, Study
from tvsysid.study.tasks import Task, identity_of

if TYPE_CHECKING:
    import xarray as xr

MIN_SIMULATED_HZ = 1000.0  # rates of simulations are multiples of the decimated rate
TRAITS = ("profile", *Scenario._fields[1:])  # coordinates of a scenario in the results


def draw(study: Study, scenario: Scenario, trial: int) -> tuple[Ensemble, Truth]:
    """Return a trial, with its noiseless torque and the means of its quantities."""
    simulation = simulate(study, scenario, trial)
    recording, pathways = simulation.recording, simulation.pathways
    with_pathways = attrs.evolve(recording, channels={**recording.channels, **pathways})
    ensemble = segment(decimate(with_pathways, study.rate), study.period)
    if study.subtract_mean:
        ensemble = subtract_mean(ensemble, pathways)
    torques = {name: ensemble.channels[name][:, ensemble.core] for name in pathways}
    own = {name: each for name, each in ensemble.channels.items() if name not in pathways}
    truth = Truth(np.asarray(sum(torques.values())), mean_quantities(simulation, ensemble), torques)
    return attrs.evolve(ensemble, channels=own), truth


def simulate(study: Study, scenario: Scenario, trial: int) -> Simulation:
    """Simulate the recording of a trial."""
    return study.system_of(scenario).simulate(
        scenario.duration_s,
        perturbation=study.parts["perturbation"][scenario.perturbation],
        snr_db=scenario.snr_db,
        seed=study.seed_of(scenario, trial),
        rate=study.rate * max(1, -(-MIN_SIMULATED_HZ // study.rate)),  # rounded up
    )


def tasks_of(study: Study) -> list[Task]:
    """Return a task for each trial, the longest first."""
    tasks: list[Task] = []
    for scenario in sorted(study.scenarios, key=lambda each: -each.duration_s):
        perturbation = study.parts["perturbation"][scenario.perturbation]
        parts = map(identity_of, (study.system_of(scenario), perturbation))
        settings = study.rate, study.period, study.subtract_mean
        depends_on = scenario, study.seed_of(scenario), settings, [*parts]
        tasks += [
            Task(
                case=scenario.label,
                draw=partial(draw, study, scenario),
                draws=[trial],
                methods=study.methods_of[scenario],
                depends_on=depends_on,
            )
            for trial in range(study.trials)
        ]
    return tasks


def results_of(study: Study, measured: Iterable[tuple[Task, Scores]]) -> xr.Dataset:
    """Return the results of all trials, with the traits of each scenario."""
    scenarios, methods = study.scenarios, [*study.parts["methods"]]
    asked = [[label in study.methods_of[each] for label in methods] for each in scenarios]
    coordinates: dict[str, Any] = {
        "scenario": ("scenario", [each.label for each in scenarios]),
        "trial": ("trial", range(study.trials)),
        "method_key": ("method_key", methods),
        "asked": (("scenario", "method_key"), asked),
    }
    for name, values in zip(TRAITS, zip(*scenarios, strict=True), strict=True):
        coordinates[name] = "scenario", list(values)
    results = dataset_of(measured, coordinates, study.rate, study=study.to_json())
    truth = results.truth.max("method_key")  # the same for every method
    if np.allclose(truth, truth[:, :1], rtol=1e-6, equal_nan=True):
        return results.assign(truth=truth.isel(trial=0, drop=True))
    return results.assign(truth=truth.mean("trial"), trial_truth=truth)
