"""Joints on a compliant actuator, identified by methods with and without a reference.

The thresholds are ours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.methods import CLOSED_LOOP, resolve
from tvsysid.simulate import SYSTEMS
from tvsysid.studies.claims import Margin, claim, labels
from tvsysid.studies.published_study import PublishedStudy

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OPEN = ("sds", "esm:stiffness=fit", "birf", "kbr", "kbr:weighting=residual")
_, ESM, BIRF, BEST = CLOSED_LOOP
ACTUATORS = (30.0, 100.0, 300.0, 1000.0)  # N·m/rad
IMPOSED = 1e5  # N·m/rad, so stiff that the loop counts as open
SNR = {2.0: 5.0, 5.0: 5.0, 40.0: 10.0}  # dB, by the cut-off of the noise in Hz
USUAL = {"stiffness": ("sine",), "perturbation": ("noise:cutoff=20",), "duration_s": (40.0,)}


def grid(noise: float, *actuators: float) -> dict[str, Any]:
    """Return the settings of scenarios with this noise on these actuators."""
    system = f"loaded:actuator_stiffness={{:g}},noise_bandwidth={noise:g}"
    return {"snr_db": (SNR[noise],), "system": tuple(map(system.format, actuators))}


PRESETS = {
    "closed-loop": {
        **USUAL,
        "methods": (*OPEN, *CLOSED_LOOP, "kbr:reference=disturbance"),
        "subtract_mean": True,
        **grid(40.0, *ACTUATORS, IMPOSED),
        "also": (grid(5.0, *ACTUATORS, IMPOSED), grid(2.0, *ACTUATORS)),
    }
}
"""Twenty realizations of a joint whose stiffness varies in a sine, on actuators from 30 to
1000 N·m/rad and on one that imposes the angle, with noise of the torque up to 2, 5 and 40 Hz."""

ALL = [label for noise in SNR for label in labels(**USUAL, **grid(noise, *ACTUATORS))]
SLOW = ALL[4:8]  # of 5 Hz
CLAIMS = (
    claim(
        "Without a reference slow noise (5 Hz, 5 dB) takes over 18 of 100 N·m/rad, whatever the "
        "actuator", "Ludvig and Kearney 2009", Margin(high=-18), "mean_bias",
        OPEN[:4], SLOW,
    ),
    claim(
        "kbr with a reference and weights is off by less than 1.5 N·m/rad on any actuator",
        "van der Helm et al. 2002", Margin(high=1.5, of=np.abs), "mean_bias", BEST, ALL,
    ),
    claim(
        "esm and birf with a reference are off by less than 2.5 N·m/rad on any actuator",
        "van der Helm et al. 2002", Margin(high=2.5, of=np.abs), "mean_bias", (ESM, BIRF), ALL,
    ),
)  # fmt: skip


def grouped(_: xr.Dataset, traits: pd.DataFrame) -> tuple[list[str], list[float]]:
    """Return the noise of each scenario, such as ``"5 Hz"``, and its actuator's stiffness."""
    loops = [resolve(each, SYSTEMS, "system") for each in traits.system]
    names = [f"{loop.noise_bandwidth:g} Hz" for loop in loops]
    return names, [loop.actuator_stiffness for loop in loops]


STUDY = PublishedStudy(
    ("compliant", "loaded"),
    "is said of joints in closed loop",
    PRESETS,
    CLAIMS,
    grouped,
    "stiffness of the actuator (N·m/rad)",
)
