"""What the store of a simulation study holds."""

from __future__ import annotations

import json

import numpy as np

from tvsysid.benchmark.study import PERIOD, RATE, Study
from tvsysid.benchmark.trial import SAMPLES, STAGES, STATISTICS
from tvsysid.execution import Fixed, Layout, Variable, digests, versions

TITLE = "Simulation study of methods that identify joint impedance over time"
NUMBER = 3
"""Version of the layout."""
OVER_TIME, OVER_REALIZATIONS, OF_METHOD = ("method_key", "time"), ("method_key", "statistic"), ("method_key",)
MEASURED = {
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


def layout_of(study: Study) -> Layout:
    """Layout of a study's store."""
    scenarios = study.scenarios
    times = np.arange(SAMPLES) / RATE
    traits = ("profile", "perturbation", "duration_s", "snr_db", "viscosity")
    units = {"duration_s": {"units": "s"}, "snr_db": {"units": "dB"}}
    return Layout(
        title=TITLE,
        number=NUMBER,
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
        measured=MEASURED,
        coordinates=traits,
        identity={
            "study": (json.loads(study.to_json()), "another study"),
            "versions": (versions(), "other versions of the software"),
            "sources": (digests(study.named_methods), "methods whose files were other ones (digests)"),
        },
    )
