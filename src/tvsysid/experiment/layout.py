"""What the store of an experimental study holds."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from tvsysid.execution import Fixed, Layout, Variable, digests, versions
from tvsysid.experiment.experiment import Experiment
from tvsysid.experiment.prepared import Prepared

TITLE = "Experimental study of methods that identify joint impedance over time"
NUMBER = 1
"""Version of the layout."""
OVER_TIME, OF_DRAW = ("bootstrap", "time"), ("bootstrap",)
MEASURED = {
    "stiffness": Variable(OVER_TIME, "estimated stiffness", "N m/rad"),
    "time_varying_vaf": Variable(OVER_TIME, "variance of the recorded torque accounted for at each time", "percent"),
    "vaf": Variable(OF_DRAW, "variance of the recorded torque accounted for, mean over realizations", "percent"),
    "bandpassed_vaf": Variable(OF_DRAW, "the same after a band-pass from 1 to 10 Hz", "percent"),
    "parameters": Variable(OF_DRAW, "effective number of parameters", "1"),
    "seconds": Variable((), "time all identifications took", "s"),
    "doubts": Variable((), "warnings of the method"),
    "failure": Variable((), "why the method gave no result"),
}
STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude, by the ending of the variable that counts what they did."""


def layout_of(experiment: Experiment, prepared: Sequence[Prepared]) -> Layout:
    """Layout of an experiment's store."""
    preparing = experiment.preparation
    times = np.arange(round(preparing.period * preparing.rate)) / preparing.rate
    recordings, analyses = experiment.recordings, experiment.analyses
    within = f"time within a realization of {preparing.period:g} s"

    def of_recording(name: str, values: Sequence[object], meaning: str) -> Fixed:
        return Fixed(name, ("recording",), list(values), {"long_name": meaning})

    def over_time(name: str, unit: str, meaning: str) -> Fixed:
        values = [getattr(item, name) for item in prepared]
        return Fixed(name, ("recording", "time"), values, {"units": unit, "long_name": meaning})

    counts = [{} if item.account is None else item.account.counts for item in prepared]
    return Layout(
        title=TITLE,
        number=NUMBER,
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
            over_time("target_torque", "N m", "torque to be followed"),
            over_time("mean_torque", "N m", "mean torque of the survivors"),
            over_time("true_stiffness", "N m/rad", "mean true stiffness of the survivors"),
            of_recording("recorded", [_length(item.account) for item in prepared], "realizations recorded"),
            of_recording("survivors", [_length(item.ensemble) for item in prepared], "realizations kept"),
            *(
                of_recording(f"excluded_{name}", [each.get(step, 0) for each in counts], f"excluded by {step}")
                for name, step in STEPS.items()
            ),
            of_recording("trials", [item.trials for item in prepared], "trials used"),
            of_recording("trials_left_out", [len(item.refused) for item in prepared], "trials or files left out"),
            of_recording("remarks", ["\n".join(item.remarks) for item in prepared], "what should be known"),
        ),
        measured=MEASURED,
        coordinates=("participant", "perturbation", "method_key", "realizations"),
        identity={
            "experiment": (json.loads(experiment.to_json()), "another experiment"),
            "versions": (versions(), "other versions of the software"),
            "sources": (digests(experiment.named_methods), "methods whose files were other ones (digests)"),
            "data": ({item.recorded.label: item.digest for item in prepared}, "other recordings (digests)"),
        },
    )


def _length(item: object | None) -> int:
    return 0 if item is None else len(item)  # type: ignore[arg-type]
