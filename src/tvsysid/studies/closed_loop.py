"""Joints on a compliant actuator, identified by methods with and without a reference.

The thresholds are ours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.methods import CLOSED_LOOP, resolve
from tvsysid.simulate import SYSTEMS
from tvsysid.studies.claims import Claim, Margin, claim, ratio
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.study.scenarios import Scenario, Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OPEN = ("sds", "esm:stiffness=fit", "birf", "kbr", "kbr:weighting=residual")
UNWEIGHTED = "kbr:reference=disturbance"
WHITE, WEIGHTED = OPEN[3:]
SDS, ESM, BIRF, BEST = CLOSED_LOOP
ACTUATORS = (30.0, 100.0, 300.0, 1000.0)  # N·m/rad
IMPOSED = 1e5  # N·m/rad, so stiff that the loop counts as open
SNR = {2.0: 5.0, 5.0: 5.0, 40.0: 10.0}  # dB, by the cut-off of the noise in Hz
SHORT, LONG = 40.0, 150.0  # s


USUAL = {"stiffness": ("sine",), "perturbation": ("noise:cutoff=20",), "duration_s": (SHORT,)}


def grid(noise: float, *actuators: float) -> dict[str, Any]:
    """Return the settings of scenarios with this noise on these actuators."""
    system = f"loaded:actuator_stiffness={{:g}},noise_bandwidth={noise:g}"
    return {"snr_db": (SNR[noise],), "system": tuple(map(system.format, actuators))}


def sines(noise: float, *actuators: float, **others: float) -> tuple[Scenario, ...]:
    """Return scenarios of a sine wave with this noise on these actuators."""
    return Study(**USUAL | grid(noise, *actuators) | others).scenarios


PRESETS = {
    "closed-loop": {
        **USUAL,
        "methods": (*OPEN, SDS, ESM, BIRF, UNWEIGHTED, BEST),
        "trials": 20,
        "subtract_mean": True,
        **grid(40.0, *ACTUATORS, IMPOSED),
        "also": (
            grid(5.0, *ACTUATORS, IMPOSED),
            grid(2.0, *ACTUATORS),
            grid(5.0, 100.0) | {"stiffness": ("square",)},
            grid(5.0, 100.0) | {"duration_s": (LONG,)},
        ),
    }
}
"""Twenty realizations of a joint whose stiffness varies in a sine, on actuators from 30 to
1000 N·m/rad and on one that imposes the angle, with noise of the torque up to 2, 5 and 40 Hz; a
square wave, and a longer record."""

OWN, VAN_DER_HELM = "this package", "van der Helm et al. 2002"
BIAS, RANDOM, COVERAGE = "mean_bias", "random_error", "coverage"
VERY_SLOW, SLOW, WIDE = ([each.label for each in sines(noise, *ACTUATORS)] for noise in SNR)
ALL = VERY_SLOW + SLOW + WIDE
STIFF = [sines(noise, IMPOSED)[0].label for noise in (5.0, 40.0)]
LONGER = tuple(sines(5.0, 100.0, duration_s=each)[0].label for each in (LONG, SHORT))
CLAIMS = (
    claim(
        "Without a reference slow noise (5 Hz, 5 dB) takes over 18 of 100 N·m/rad, whatever the "
        "actuator", "Ludvig and Kearney 2009", Margin(high=-18), BIAS, OPEN[:4], SLOW,
    ),
    claim(
        "A longer record does not mend it (by 10 % at most)", OWN,
        ratio(0.9), BIAS, OPEN[:4], [LONGER],
    ),
    claim(
        "Noise up to 40 Hz at 10 dB takes less than 5 N·m/rad", OWN,
        Margin(high=5, of=np.abs), BIAS, OPEN[:4], WIDE,
    ),
    claim(
        "kbr with a reference and weights is off by less than 1.5 N·m/rad on any actuator",
        VAN_DER_HELM, Margin(high=1.5, of=np.abs), BIAS, BEST, ALL,
    ),
    claim(
        "esm and birf with a reference are off by less than 2.5 N·m/rad on any actuator",
        VAN_DER_HELM, Margin(high=2.5, of=np.abs), BIAS, (ESM, BIRF), ALL,
    ),
    claim(
        "The bands of kbr with a reference and weights hold the truth in 90 to 97 %, on any "
        "actuator", OWN, Margin(90, 97), COVERAGE, BEST, ALL,
    ),
    claim(
        "Those of esm and birf with a reference hold it in 90 % or more", OWN,
        Margin(90), COVERAGE, (ESM, BIRF), ALL,
    ),
    claim(
        "Where the angle is imposed a reference costs nothing (random error to within 2 %)", OWN,
        ratio(high=1.02), RANDOM, [(ESM, OPEN[1]), (BIRF, OPEN[2]), (BEST, WEIGHTED)],
        STIFF,
    ),
    Claim(
        "Weighting by the residual takes 25 % off kbr's random error under slow noise, and adds "
        "less than 6 % under wide-band noise", OWN,
        [
            (ratio(1 / 0.75), RANDOM, [(UNWEIGHTED, BEST)], VERY_SLOW + SLOW),
            (ratio(1 / 0.75), RANDOM, [(WHITE, WEIGHTED)], STIFF[:1]),
            (ratio(1 / 1.06), RANDOM, [(UNWEIGHTED, BEST)], WIDE),
        ],
    ),
)  # fmt: skip


def grouped(_: xr.Dataset, traits: pd.DataFrame) -> tuple[list[str], list[float]]:
    """Return the noise of each scenario, such as ``"5Hz"``, and the stiffness of its actuator."""
    loops: list[Any] = [resolve(each, SYSTEMS, "system") for each in traits.system]
    names = [f"{loop.noise_bandwidth:g}Hz" for loop in loops]
    return names, [loop.actuator_stiffness for loop in loops]


STUDY = PublishedStudy(
    ("compliant", "loaded"),
    "is said of joints in closed loop",
    PRESETS,
    CLAIMS,
    grouped,
    "stiffness of the actuator (N·m/rad)",
)
