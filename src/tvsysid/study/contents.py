"""What the store of a study holds: of simulations, of recordings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.study.alignment import AlignmentEffect
from tvsysid.study.prepared import Prepared
from tvsysid.study.recorded import Experiment
from tvsysid.study.simulated import Study
from tvsysid.study.task import STATISTICS, digests, versions
from tvsysid.study.trial import STAGES

if TYPE_CHECKING:
    import xarray as xr


SIMULATIONS = "Simulation study of methods that identify joint impedance over time"
EXPERIMENT = "Experimental study of methods that identify joint impedance over time"
NUMBERS = {
    SIMULATIONS: 6,
    EXPERIMENT: 4,
}  # version of the layout of each kind of study, by its title
CHECKSUMS = (
    "checksums"  # the variable that has the checksum of each chunk of a task, its own the last
)
RECORDINGS = (
    "recordings.nc"  # file in the store of an experiment that holds what became of each recording
)
STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude, by the ending of the variable that counts what they did."""


class Variable(NamedTuple):
    """What each task measures: its dimensions there, what it means, and its unit.

    Texts have none.
    """

    dims: tuple[str, ...]
    meaning: str
    unit: str = ""

    @property
    def is_text(self) -> bool:
        """Whether it holds texts; else numbers, with NaN where there is none."""
        return not self.unit


class Fixed(NamedTuple):
    """Value that is known before any task is done: along a dimension, or of the study itself."""

    name: str
    dims: tuple[str, ...]
    values: Sequence[object] | NDArray[Any]
    attributes: Mapping[str, str] = {}


ASKED = {"long_name": "whether the method identifies the scenario"}
OF_METHOD, OVER_TIME, OF_QUANTITY = (
    ("method_key",),
    ("method_key", "time"),
    ("method_key", "quantity", "time"),
)
OVER_SCHEDULE = ("method_key", "scheduled", "scheduling")
OF_TRIAL = {
    "estimate": Variable(OF_QUANTITY, "estimate, in the unit of its quantity", "unit"),
    "standard_error": Variable(OF_QUANTITY, "standard error of the estimate", "unit"),
    "covered": Variable(OF_QUANTITY, "whether the 95 % band of the estimate holds the truth", "1"),
    "time_varying_vaf": Variable(
        OVER_TIME, "variance of the noiseless torque accounted for at each time", "percent"
    ),
    "vaf": Variable(
        ("method_key", "statistic"),
        "variance of the noiseless torque accounted for, over the realizations of a trial",
        "percent",
    ),
    "bandpassed_vaf": Variable(
        ("method_key", "statistic"), "the same after a band-pass from 1 to 10 Hz", "percent"
    ),
    "parameters": Variable(OF_METHOD, "effective number of parameters", "1"),
    "seconds": Variable(OF_METHOD, "time an identification took", "s"),
    "stage_seconds": Variable(("stage",), "time the rest of a trial took", "s"),
    "warnings": Variable(OF_METHOD, "warnings of the method"),
    "failure": Variable(OF_METHOD, "why the method gave no result"),
}
ROOT_MEAN_SQUARE = (
    "root mean square over realizations of each pathway's predicted torque at each time"
)
OF_SEVERAL_PATHWAYS = {
    "pathway_vaf": Variable(
        ("method_key", "pathway", "statistic"),
        "variance of each pathway's noiseless torque accounted for",
        "percent",
    ),
    "pathway_torque": Variable(("method_key", "pathway", "time"), ROOT_MEAN_SQUARE, "N m"),
}
"""Measured beside, where a simulated system or a method has several pathways."""
OF_SCHEDULED = {
    "scheduled_estimate": Variable(
        OVER_SCHEDULE, "estimate over a variable of the method's own", "unit"
    ),
    "scheduled_standard_error": Variable(OVER_SCHEDULE, "its standard error", "unit"),
    "scheduling_variable": Variable(OVER_SCHEDULE, "values of the variable", "unit"),
}
"""Measured beside, where a method says that it estimates something over a variable of its own."""
OF_CHANGING_TRUTH = {
    "trial_truth": Variable(
        ("quantity", "time"), "simulated value, mean over the trial's realizations", "unit"
    )
}
"""Measured beside, where the truth differs from trial to trial."""
OF_ANALYSIS = {
    "estimate": Variable(
        ("bootstrap", "quantity", "time"), "estimate, in the unit of its quantity", "unit"
    ),
    "time_varying_vaf": Variable(
        ("bootstrap", "time"),
        "variance of the recorded torque accounted for at each time",
        "percent",
    ),
    "vaf": Variable(
        ("bootstrap",),
        "variance of the recorded torque accounted for, mean over realizations",
        "percent",
    ),
    "bandpassed_vaf": Variable(
        ("bootstrap",), "the same after a band-pass from 1 to 10 Hz", "percent"
    ),
    "parameters": Variable(("bootstrap",), "effective number of parameters", "1"),
    "seconds": Variable((), "time all identifications took", "s"),
    "warnings": Variable((), "warnings of the method"),
    "digest": Variable((), "digest of the ensemble that was identified"),
    "failure": Variable((), "why the method gave no result"),
}
PATHWAYS_OF_ANALYSIS = {
    "pathway_vaf": Variable(
        ("bootstrap", "pathway"),
        "variance of each pathway's noiseless torque accounted for, mean over realizations",
        "percent",
    ),
    "pathway_torque": Variable(("bootstrap", "pathway", "time"), ROOT_MEAN_SQUARE, "N m"),
}
"""Measured beside in an experiment, where a method has several pathways."""
SCHEDULED_OF_ANALYSIS = {
    name: variable._replace(dims=("bootstrap", *variable.dims[1:]))
    for name, variable in OF_SCHEDULED.items()
    if name != "scheduled_standard_error"
}


@attrs.frozen
class Layout:
    """What the store of a study holds.

    ``title`` and ``number`` say of which kind it is, and in which version; tasks lie along the
    two dimensions ``places``; ``fixed`` has the values of each dimension under its name,
    ``coordinates`` names those of the others that are coordinates too. ``measured`` stands in
    the order in which it is written. ``identity`` holds the attributes that tell one study from
    another, as mappings, each with words for a difference.
    """

    title: str
    places: tuple[str, str]
    fixed: tuple[Fixed, ...]
    measured: Mapping[str, Variable]
    coordinates: tuple[str, ...]
    identity: Mapping[str, tuple[Mapping[str, object], str]] = attrs.field(factory=dict)

    @property
    def number(self) -> int:
        """Version of the layout of this kind."""
        return NUMBERS[self.title]

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Of each dimension."""
        known = {item.name: len(item.values) for item in self.fixed if item.dims == (item.name,)}
        return known | {"variable": len(self.measured) + 1}

    def shape(self, dims: Sequence[str]) -> tuple[int, ...]:
        """Return the lengths of some dimensions."""
        return tuple(self.lengths[dim] for dim in dims)

    def shapes(self, along: str) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the variables at one place along a dimension."""
        return {
            name: self.shape(variable.dims[1:])
            for name, variable in self.measured.items()
            if variable.dims[:1] == (along,) and not variable.is_text
        }

    @property
    def bytes_of_numbers(self) -> int:
        """About what it takes on a disk."""
        numbers = sum(
            int(np.prod(self.shape(variable.dims)))
            for variable in self.measured.values()
            if not variable.is_text
        )
        return 8 * int(np.prod(self.shape(self.places))) * (numbers + len(self.measured))


def layout_of(study: Study | Experiment) -> Layout:
    """Return the layout of a study's store."""
    return _of_simulations(study) if isinstance(study, Study) else _of_experiment(study)


def _of_simulations(study: Study) -> Layout:
    scenarios, known = study.scenarios, study.known
    traits = ("profile", "perturbation", "duration_s", "snr_db", "viscosity", "system")
    units = {"duration_s": {"units": "s"}, "snr_db": {"units": "dB"}}
    truth = np.stack([known.truth[scenario] for scenario in scenarios])
    asked = np.array(
        [[label in study.methods_of[each] for label in study.named_methods] for each in scenarios]
    )
    restricted = [] if asked.all() else [Fixed("asked", ("scenario", "method_key"), asked, ASKED)]
    return Layout(
        title=SIMULATIONS,
        places=("scenario", "trial"),
        fixed=(
            Fixed("scenario", ("scenario",), [scenario.label for scenario in scenarios]),
            *(
                Fixed(name, ("scenario",), values, units.get(name, {}))
                for name, values in zip(traits, zip(*scenarios, strict=True), strict=True)
            ),
            Fixed("trial", ("trial",), np.arange(study.trials)),
            # Not "method", which xarray's sel() takes for a way to interpolate.
            Fixed("method_key", ("method_key",), list(study.named_methods)),
            *restricted,
            *_shared(study, known.quantities, known.pathways, study.period, study.rate),
            Fixed("statistic", ("statistic",), STATISTICS),
            Fixed("stage", ("stage",), STAGES),
            Fixed(
                "truth",
                ("scenario", "quantity", "time"),
                truth,
                {"long_name": "simulated value, in the unit of its quantity"},
            ),
        ),
        measured=OF_TRIAL
        | (OF_SEVERAL_PATHWAYS if known.pathways else {})
        | (OF_SCHEDULED if study.scheduled else {})
        | (OF_CHANGING_TRUTH if known.changes else {}),
        coordinates=(*traits, "unit", *(item.name for item in restricted)),
        identity={
            "study": (json.loads(study.to_json()), "another study"),
            "versions": (versions(), "other versions of the software"),
            "sources": (
                digests(study.named_methods | study.parts),
                "methods or systems whose files were other ones (digests)",
            ),
        },
    )


def _of_experiment(experiment: Experiment) -> Layout:
    """Return the layout of an experiment's store. It depends on names of recordings only."""
    preparing, pathways = experiment.preparation, experiment.pathways
    recordings, analyses = experiment.recordings, experiment.analyses
    return Layout(
        title=EXPERIMENT,
        places=("recording", "analysis"),
        fixed=(
            Fixed("recording", ("recording",), [item.label for item in recordings]),
            Fixed("participant", ("recording",), [item.participant for item in recordings]),
            Fixed("perturbation", ("recording",), [item.perturbation for item in recordings]),
            Fixed("analysis", ("analysis",), [item.label for item in analyses]),
            Fixed("method_key", ("analysis",), [item.name for item in analyses]),
            Fixed("realizations", ("analysis",), [item.realizations for item in analyses]),
            Fixed("bootstrap", ("bootstrap",), np.arange(experiment.bootstraps)),
            *_shared(experiment, experiment.quantities, pathways, preparing.period, preparing.rate),
        ),
        measured=OF_ANALYSIS
        | (PATHWAYS_OF_ANALYSIS if pathways else {})
        | (SCHEDULED_OF_ANALYSIS if experiment.scheduled else {}),
        coordinates=("participant", "perturbation", "method_key", "realizations", "unit"),
        identity={
            "experiment": (experiment.identity, "another experiment"),
            "versions": (versions(), "other versions of the software"),
            "sources": (
                digests(experiment.named_methods),
                "methods whose files were other ones (digests)",
            ),
        },
    )


def _shared(
    study: Study | Experiment,
    quantities: Sequence[str],
    pathways: Sequence[str],
    period: float,
    rate: float,
) -> Iterator[Fixed]:
    """Yield the variables that both kinds of study have."""
    yield Fixed("quantity", ("quantity",), list(quantities))
    yield Fixed("unit", ("quantity",), [study.units.get(name, "") for name in quantities])
    if pathways:
        yield Fixed("pathway", ("pathway",), list(pathways))
    if scheduled := study.scheduled:
        yield Fixed("scheduled", ("scheduled",), list(scheduled))
        yield Fixed("scheduling", ("scheduling",), np.arange(max(scheduled.values())))
    times = np.arange(round(period * rate)) / rate
    yield Fixed(
        "time",
        ("time",),
        times,
        {"units": "s", "long_name": f"time within a realization of {period:g} s"},
    )


def of_recordings(experiment: Experiment, prepared: Sequence[Prepared]) -> xr.Dataset:
    """Return the preparation of each recording, over recording and time.

    Kept beside the store, and made anew with each run.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    counts = [
        {} if item.account is None else dict(item.account.excluded_by.value_counts())
        for item in prepared
    ]
    values: dict[str, Sequence[object]] = {
        "recorded": [0 if item.account is None else len(item.account) for item in prepared],
        "survivors": [0 if item.ensemble is None else len(item.ensemble) for item in prepared],
        **{
            f"excluded_{name}": [each.get(step, 0) for each in counts]
            for name, step in STEPS.items()
        },
        "trials": [item.trials for item in prepared],
        "trials_left_out": [len(item.refused) for item in prepared],
        "remarks": ["\n".join(item.remarks) for item in prepared],
        "digest": [item.digest for item in prepared],
    }
    variables: dict[str, Any] = {name: ("recording", list(each)) for name, each in values.items()}
    for name in ("target_torque", "mean_torque"):
        over_time = np.stack([getattr(item, name) for item in prepared])
        variables[name] = (("recording", "time"), over_time, {"units": "N m"})
    for name in AlignmentEffect._fields:
        effects = [getattr(item.alignment, name) for item in prepared]
        variables[f"alignment_{name}"] = ("recording", effects, {"units": "N m/rad"})
    unknown = np.full(variables["mean_torque"][1].shape[1], np.nan)
    truth = [[item.truth.get(name, unknown) for name in experiment.quantities] for item in prepared]
    variables["truth"] = (("recording", "quantity", "time"), np.array(truth))
    return xr.Dataset(
        variables,
        coords={"recording": [item.recorded.label for item in prepared]},
        attrs={"experiment": experiment.to_json()},
    )
