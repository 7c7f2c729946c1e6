"""What the store of an experimental study holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.execution import Fixed, Layout, Variable, digests, versions
from tvsysid.experiment.experiment import Experiment
from tvsysid.experiment.prepared import Prepared

if TYPE_CHECKING:
    import xarray as xr

TITLE = "Experimental study of methods that identify joint impedance over time"
PLACES = ("recording", "analysis")
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
    "digest": Variable((), "digest of the ensemble that was identified"),
    "failure": Variable((), "why the method gave no result"),
}
STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude, by the ending of the variable that counts what they did."""


def layout_of(experiment: Experiment) -> Layout:
    """Layout of an experiment's store, which holds nothing of the recordings but their names."""
    preparing = experiment.preparation
    times = np.arange(round(preparing.period * preparing.rate)) / preparing.rate
    recordings, analyses = experiment.recordings, experiment.analyses
    within = f"time within a realization of {preparing.period:g} s"
    return Layout(
        title=TITLE,
        number=NUMBER,
        places=PLACES,
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
        measured=MEASURED,
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
