"""What the store of a study holds: of simulations, of recordings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.study.prepared import Prepared
from tvsysid.study.recorded import Experiment
from tvsysid.study.simulated import PERIOD, RATE, Study
from tvsysid.study.store import Fixed, Layout, Variable
from tvsysid.study.task import digests, versions
from tvsysid.study.trial import SAMPLES, STAGES, STATISTICS

if TYPE_CHECKING:
    import xarray as xr

SIMULATIONS = "Simulation study of methods that identify joint impedance over time"
EXPERIMENT = "Experimental study of methods that identify joint impedance over time"
NUMBERS = {SIMULATIONS: 3, EXPERIMENT: 1}
"""Version of the layout of each kind of study, by its title."""
STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude, by the ending of the variable that counts what they did."""
OF_DRAW, DRAW_OVER_TIME = ("bootstrap",), ("bootstrap", "time")
OVER_TIME, OVER_REALIZATIONS, OF_METHOD = ("method_key", "time"), ("method_key", "statistic"), ("method_key",)
OF_TRIAL = {
    "stiffness": Variable(OVER_TIME, "estimated stiffness", "N m/rad"),
    "time_varying_vaf": Variable(OVER_TIME, "variance of the noiseless torque accounted for at each time", "percent"),
    "covered": Variable(OVER_TIME, "whether the 95 % band of the stiffness holds the truth", "1"),
    "vaf": Variable(
        OVER_REALIZATIONS,
        "variance of the noiseless torque accounted for, over the realizations of a trial",
        "percent",
    ),
    "bandpassed_vaf": Variable(OVER_REALIZATIONS, "the same after a band-pass from 1 to 10 Hz", "percent"),
    "parameters": Variable(OF_METHOD, "effective number of parameters", "1"),
    "seconds": Variable(OF_METHOD, "time an identification took", "s"),
    "stage_seconds": Variable(("stage",), "time the rest of a trial took", "s"),
    "doubts": Variable(OF_METHOD, "warnings of the method"),
    "failure": Variable(OF_METHOD, "why the method gave no result"),
}
OF_ANALYSIS = {
    "stiffness": Variable(DRAW_OVER_TIME, "estimated stiffness", "N m/rad"),
    "time_varying_vaf": Variable(
        ("bootstrap", "time"), "variance of the recorded torque accounted for at each time", "percent"
    ),
    "vaf": Variable(OF_DRAW, "variance of the recorded torque accounted for, mean over realizations", "percent"),
    "bandpassed_vaf": Variable(OF_DRAW, "the same after a band-pass from 1 to 10 Hz", "percent"),
    "parameters": Variable(OF_DRAW, "effective number of parameters", "1"),
    "seconds": Variable((), "time all identifications took", "s"),
    "doubts": Variable((), "warnings of the method"),
    "digest": Variable((), "digest of the ensemble that was identified"),
    "failure": Variable((), "why the method gave no result"),
}


def layout_of_study(study: Study) -> Layout:
    """Layout of a study's store."""
    scenarios = study.scenarios
    times = np.arange(SAMPLES) / RATE
    traits = ("profile", "perturbation", "duration_s", "snr_db", "viscosity")
    units = {"duration_s": {"units": "s"}, "snr_db": {"units": "dB"}}
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
            Fixed("time", ("time",), times, {"units": "s", "long_name": f"time within a realization of {PERIOD:g} s"}),
            Fixed("statistic", ("statistic",), STATISTICS),
            Fixed("stage", ("stage",), STAGES),
            Fixed(
                "true_stiffness",
                ("scenario", "time"),
                [np.asarray(scenario.profile(times)) for scenario in scenarios],
                {"units": "N m/rad", "long_name": "simulated stiffness"},
            ),
        ),
        measured=OF_TRIAL,
        coordinates=traits,
        identity={
            "study": (json.loads(study.to_json()), "another study"),
            "versions": (versions(), "other versions of the software"),
            "sources": (digests(study.named_methods), "methods whose files were other ones (digests)"),
        },
    )


def layout_of(study: Study | Experiment) -> Layout:
    """Layout of a study's store."""
    return layout_of_study(study) if isinstance(study, Study) else layout_of_experiment(study)


def layout_of_experiment(experiment: Experiment) -> Layout:
    """Layout of an experiment's store, which holds nothing of the recordings but their names."""
    preparing = experiment.preparation
    times = np.arange(round(preparing.period * preparing.rate)) / preparing.rate
    recordings, analyses = experiment.recordings, experiment.analyses
    within = f"time within a realization of {preparing.period:g} s"
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
            Fixed("time", ("time",), times, {"units": "s", "long_name": within}),
        ),
        measured=OF_ANALYSIS,
        coordinates=("participant", "perturbation", "method_key", "realizations"),
        identity={
            "experiment": (experiment.identity, "another experiment"),
            "versions": (versions(), "other versions of the software"),
            "sources": (digests(experiment.named_methods), "methods whose files were other ones (digests)"),
        },
    )


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
    over_time = {"target_torque": "N m", "mean_torque": "N m", "true_stiffness": "N m/rad"}
    return xr.Dataset(
        {name: ("recording", list(each)) for name, each in values.items()}
        | {
            name: (("recording", "time"), np.stack([getattr(item, name) for item in prepared]), {"units": unit})
            for name, unit in over_time.items()
        },
        coords={"recording": [item.recorded.label for item in prepared]},
        attrs={"experiment": experiment.to_json()},
    )


def _length(item: object | None) -> int:
    return 0 if item is None else len(item)  # type: ignore[arg-type]
