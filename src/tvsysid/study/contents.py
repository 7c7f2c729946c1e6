"""What the store of a study holds: of simulations, of recordings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.estimates import UNITS
from tvsysid.study.layout import Fixed, Layout, Variable
from tvsysid.study.prepared import Prepared
from tvsysid.study.recorded import Experiment
from tvsysid.study.simulated import Study
from tvsysid.study.task import STATISTICS, digests, versions
from tvsysid.study.trial import STAGES

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

SIMULATIONS = "Simulation study of methods that identify joint impedance over time"
EXPERIMENT = "Experimental study of methods that identify joint impedance over time"
NUMBERS = {SIMULATIONS: 4, EXPERIMENT: 2}
"""Version of the layout of each kind of study, by its title."""
STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude, by the ending of the variable that counts what they did."""
OF_METHOD, OVER_TIME, OF_QUANTITY = ("method_key",), ("method_key", "time"), ("method_key", "quantity", "time")
OVER_REALIZATIONS, OF_PATHWAY = ("method_key", "statistic"), ("method_key", "pathway", "statistic")
OF_TRIAL = {
    "estimate": Variable(OF_QUANTITY, "estimate, in the unit of its quantity", "unit"),
    "standard_error": Variable(OF_QUANTITY, "standard error of the estimate", "unit"),
    "covered": Variable(OF_QUANTITY, "whether the 95 % band of the estimate holds the truth", "1"),
    "time_varying_vaf": Variable(OVER_TIME, "variance of the noiseless torque accounted for at each time", "percent"),
    "vaf": Variable(
        OVER_REALIZATIONS, "variance of the noiseless torque accounted for, over the realizations of a trial", "percent"
    ),
    "bandpassed_vaf": Variable(OVER_REALIZATIONS, "the same after a band-pass from 1 to 10 Hz", "percent"),
    "parameters": Variable(OF_METHOD, "effective number of parameters", "1"),
    "seconds": Variable(OF_METHOD, "time an identification took", "s"),
    "stage_seconds": Variable(("stage",), "time the rest of a trial took", "s"),
    "warnings": Variable(OF_METHOD, "warnings of the method"),
    "failure": Variable(OF_METHOD, "why the method gave no result"),
}
OF_SEVERAL_PATHWAYS = {
    "pathway_vaf": Variable(OF_PATHWAY, "variance of each pathway's noiseless torque accounted for", "percent")
}
"""Measured beside, where a simulated system has several pathways."""
OF_CHANGING_TRUTH = {
    "trial_truth": Variable(("quantity", "time"), "simulated value, mean over the trial's realizations", "unit")
}
"""Measured beside, where the truth differs from trial to trial."""
OF_DRAW, DRAW_OVER_TIME = ("bootstrap",), ("bootstrap", "time")
OF_ANALYSIS = {
    "estimate": Variable(("bootstrap", "quantity", "time"), "estimate, in the unit of its quantity", "unit"),
    "time_varying_vaf": Variable(
        DRAW_OVER_TIME, "variance of the recorded torque accounted for at each time", "percent"
    ),
    "vaf": Variable(OF_DRAW, "variance of the recorded torque accounted for, mean over realizations", "percent"),
    "bandpassed_vaf": Variable(OF_DRAW, "the same after a band-pass from 1 to 10 Hz", "percent"),
    "parameters": Variable(OF_DRAW, "effective number of parameters", "1"),
    "seconds": Variable((), "time all identifications took", "s"),
    "warnings": Variable((), "warnings of the method"),
    "digest": Variable((), "digest of the ensemble that was identified"),
    "failure": Variable((), "why the method gave no result"),
}


def layout_of(study: Study | Experiment) -> Layout:
    """Layout of a study's store."""
    return _of_simulations(study) if isinstance(study, Study) else _of_experiment(study)


def _of_simulations(study: Study) -> Layout:
    scenarios, known = study.scenarios, study.known
    traits = ("profile", "perturbation", "duration_s", "snr_db", "viscosity", "system")
    units = {"duration_s": {"units": "s"}, "snr_db": {"units": "dB"}}
    measured: dict[str, Variable] = dict(OF_TRIAL)
    if known.pathways:
        measured |= OF_SEVERAL_PATHWAYS
    if known.changes:
        measured |= OF_CHANGING_TRUTH
    return Layout(
        title=SIMULATIONS,
        number=NUMBERS[SIMULATIONS],
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
            *_of_quantities(known.quantities),
            _times(study.period, study.rate),
            Fixed("statistic", ("statistic",), STATISTICS),
            *([Fixed("pathway", ("pathway",), list(known.pathways))] if known.pathways else []),
            Fixed("stage", ("stage",), STAGES),
            Fixed(
                "truth",
                ("scenario", "quantity", "time"),
                np.stack([known.truth[scenario] for scenario in scenarios]),
                {"long_name": "simulated value, in the unit of its quantity"},
            ),
        ),
        measured=measured,
        coordinates=(*traits, "unit"),
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
    """Holds nothing of the recordings but their names."""
    preparing = experiment.preparation
    recordings, analyses = experiment.recordings, experiment.analyses
    return Layout(
        title=EXPERIMENT,
        number=NUMBERS[EXPERIMENT],
        places=("recording", "analysis"),
        fixed=(
            Fixed("recording", ("recording",), [item.label for item in recordings]),
            Fixed("participant", ("recording",), [item.participant for item in recordings]),
            Fixed("perturbation", ("recording",), [item.perturbation for item in recordings]),
            Fixed("analysis", ("analysis",), [item.label for item in analyses]),
            Fixed("method_key", ("analysis",), [item.name for item in analyses]),
            Fixed("realizations", ("analysis",), [item.realizations for item in analyses]),
            Fixed("bootstrap", ("bootstrap",), np.arange(experiment.bootstraps)),
            *_of_quantities(experiment.quantities),
            _times(preparing.period, preparing.rate),
        ),
        measured=OF_ANALYSIS,
        coordinates=("participant", "perturbation", "method_key", "realizations", "unit"),
        identity={
            "experiment": (experiment.identity, "another experiment"),
            "versions": (versions(), "other versions of the software"),
            "sources": (digests(experiment.named_methods), "methods whose files were other ones (digests)"),
        },
    )


def _of_quantities(quantities: Sequence[str]) -> tuple[Fixed, Fixed]:
    units = [UNITS.get(name, "") for name in quantities]
    return Fixed("quantity", ("quantity",), list(quantities)), Fixed("unit", ("quantity",), units)


def _times(period: float, rate: float) -> Fixed:
    times = np.arange(round(period * rate)) / rate
    return Fixed("time", ("time",), times, {"units": "s", "long_name": f"time within a realization of {period:g} s"})


def of_recordings(experiment: Experiment, prepared: Sequence[Prepared]) -> xr.Dataset:
    """What became of each recording, over recording and time; kept beside the store, and made anew with each run."""
    import xarray as xr  # noqa: PLC0415  # heavy

    counts = [{} if item.account is None else item.account.counts for item in prepared]
    values: dict[str, Sequence[object]] = {
        "recorded": [_length(item.account) for item in prepared],
        "survivors": [_length(item.ensemble) for item in prepared],
        **{f"excluded_{name}": [each.get(step, 0) for each in counts] for name, step in STEPS.items()},
        "trials": [item.trials for item in prepared],
        "trials_left_out": [len(item.refused) for item in prepared],
        "remarks": ["\n".join(item.remarks) for item in prepared],
        "digest": [item.digest for item in prepared],
    }
    variables: dict[str, Any] = {name: ("recording", list(each)) for name, each in values.items()}
    for name in ("target_torque", "mean_torque"):
        over_time = np.stack([getattr(item, name) for item in prepared])
        variables[name] = (("recording", "time"), over_time, {"units": "N m"})
    truth = np.stack([_stacked(item, experiment.quantities) for item in prepared])
    variables["truth"] = (("recording", "quantity", "time"), truth)
    return xr.Dataset(
        variables,
        coords={"recording": [item.recorded.label for item in prepared]},
        attrs={"experiment": experiment.to_json()},
    )


def _stacked(item: Prepared, quantities: Sequence[str]) -> Array:
    unknown = np.full(len(item.mean_torque), np.nan)
    return np.stack([item.truth.get(name, unknown) for name in quantities])


def _length(item: object | None) -> int:
    return 0 if item is None else len(item)  # type: ignore[arg-type]
