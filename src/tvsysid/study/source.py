"""What a study gives to do: its tasks, and what is known beside their results."""

from __future__ import annotations

import json
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.study.contents import RECORDINGS, Layout, layout_of, of_recordings
from tvsysid.study.draws import DrawsTask
from tvsysid.study.prepared import Prepared, prepared_recordings
from tvsysid.study.recorded import Experiment
from tvsysid.study.simulated import Scenario, Study
from tvsysid.study.store import Place, Store
from tvsysid.study.task import Task, pickled
from tvsysid.study.trial import Trial
from tvsysid.validators import settings_of

if TYPE_CHECKING:
    import xarray as xr


class Source(ABC):
    """A study, ready to be run."""

    layout: Layout

    @abstractmethod
    def task_at(self, place: Place) -> Task:
        """Return the task for a place of the store."""

    def rank(self, place: Place) -> tuple[int, int]:
        """Return the priority of a task: the higher, the longer it is expected to take."""
        return place

    def begin(self, store: Store) -> None:  # noqa: B027  # most have nothing to do
        """Prepare the store before tasks run."""

    def completed(self, results: xr.Dataset) -> xr.Dataset:
        """Return results with further facts."""
        return results


class Simulations(Source):
    """Trials of a simulation study."""

    def __init__(self, study: Study) -> None:
        self.layout = layout_of(study)
        self._study, self._methods = study, pickled(study.named_methods)
        self._simulated: dict[Scenario, bytes] = {}

    def task_at(self, place: Place) -> Trial:
        """Return a trial of a scenario."""
        scenario = self._study.scenarios[place[0]]
        return self.trial(scenario, place[1], self._study.methods_of[scenario])

    def trial(
        self, scenario: Scenario, number: int, methods: frozenset[str] = frozenset()
    ) -> Trial:
        """Return a trial of any scenario, by some methods or all."""
        label = scenario.label
        if scenario not in self._simulated:
            system, perturbation = self._study.simulated(scenario)
            parts = (system, perturbation, *settings_of(system).values())
            self._simulated[scenario] = pickled({label: (system, perturbation)}, "scenario", parts)[
                label
            ]
        return Trial(
            label=f"trial {number} of {label}",
            setting=self._study.setting_of(scenario),
            simulated=self._simulated[scenario],
            seed=self._study.seed_of(scenario, number),
            methods=self._methods,
            shapes=self.layout.shapes("method_key"),
            asked=methods or frozenset(self._methods),
        )


class Recordings(Source):
    """Bootstraps of the recordings of an experiment."""

    def __init__(self, experiment: Experiment, prepared: Sequence[Prepared] | None) -> None:
        self._methods = pickled(experiment.named_methods)
        ready = prepared_recordings(experiment) if prepared is None else prepared
        if [item.recorded for item in ready] != list(experiment.recordings):
            given = ", ".join(item.recorded.label for item in ready)
            raise InputError(
                f"run: the recordings prepared are not the experiment's: {given}; give what "
                "prepared_recordings(experiment) returns"
            )
        self.layout = layout_of(experiment)
        self._experiment, self._ready = experiment, ready
        self._known = of_recordings(experiment, ready)

    def task_at(self, place: Place) -> DrawsTask:
        """Return the task of all bootstraps of one method from one recording."""
        item, analysis = self._ready[place[0]], self._experiment.analyses[place[1]]
        return DrawsTask(
            label=f"{analysis.label} of {item.recorded.label}",
            ensemble=item.ensemble,
            pathways={name: item.pathways.get(name) for name in self._experiment.pathways},
            scheduled=self._experiment.scheduled,
            digest=item.digest,
            realizations=analysis.realizations,
            contiguous=analysis.contiguous,
            bootstraps=self._experiment.bootstraps,
            seed=self._experiment.seed_of(item.recorded, analysis.realizations),
            quantities=self._experiment.quantities,
            shapes=self.layout.shapes("bootstrap"),
            # One recording alone may have a method kill its worker.
            methods={f"{analysis.name} on {item.recorded.label}": self._methods[analysis.name]},
            reason=item.failure,
        )

    def rank(self, place: Place) -> tuple[int, int]:
        """Return the priority: the last methods and most realizations take longest."""
        return place[1], place[0]

    def begin(self, store: Store) -> None:
        """Delete results from other data, and write the preparation of the recordings."""
        changed = store.forget_unless("digest", lambda place: self._ready[place[0]].digest)
        labels = list(dict.fromkeys(self._ready[place[0]].recorded.label for place in changed))
        if labels:
            warnings.warn(
                f"not the data that were identified before: {', '.join(labels)}; identified again",
                DataQualityWarning,
                stacklevel=3,
            )
        store.keep(RECORDINGS, bytes(self._known.to_netcdf(engine="h5netcdf")))

    def completed(self, results: xr.Dataset) -> xr.Dataset:
        """Return results with the facts of the recordings."""
        return with_recordings(results, self._known)


def source_of(study: Study | Experiment, prepared: Sequence[Prepared] | None) -> Source:
    """Return the source of a study of either kind."""
    return Simulations(study) if isinstance(study, Study) else Recordings(study, prepared)


def recordings_in(store: Store, results: xr.Dataset) -> xr.Dataset:
    """Return the prepared recordings of an experiment.

    Raises an InputError if it is damaged, or not of the results.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    known = xr.load_dataset(BytesIO(store.kept(RECORDINGS)), engine="h5netcdf")
    if ((results.digest != "") & (results.digest.astype(object) != known.digest)).any():
        raise InputError(
            f"{store.path / RECORDINGS}: this file is of other data than the results; give the "
            "command that ran the "
            "study again"
        )
    return known


def with_recordings(results: xr.Dataset, known: xr.Dataset) -> xr.Dataset:
    """Return results with the facts of the recordings, and all settings."""
    names: dict[Any, Any] = {
        name: each for name, each in known.data_vars.items() if name != "digest"
    }
    return results.assign(
        {name: (each.dims, each.values, each.attrs) for name, each in names.items()}
    ).assign_attrs(
        experiment=known.attrs["experiment"],
        data=json.dumps(
            dict(zip(known.recording.values.tolist(), known.digest.values.tolist(), strict=True))
        ),
    )
