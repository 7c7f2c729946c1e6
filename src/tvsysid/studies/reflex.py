"""Joints with a stretch reflex, identified by methods of one pathway and of two.

The literature gives no thresholds: those here are ours, and part of the sentences.
"""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.numerics import Array
from tvsysid.studies.claims import HIGHER, Claim, Margin, claim, ratio
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

ONE_PATH = ("eirf", "sds", "birf", "kbr")
TWO_PATHS = ("cascade", "bpc", "tvpc", "pc", "sdss")
AMOUNTS = (200.0, 600.0, 1200.0)  # s, for 100, 300 and 600 realizations
WINDOWLESS = "tvpc:window=0"  # each time by itself, as its authors have it
NAMES = {gain: f"reflex:reflex_gain={gain:g}" for gain in (0.0, 4.0, 8.0, 16.0)}
"""Systems by their constant gain in N·m·s/rad."""

PRESETS = {
    "reflex": {
        "stiffness": ("sine",),
        "perturbation": ("noise",),
        "duration_s": (80.0,),
        "system": ("reflex-sine",),
        "methods": (*ONE_PATH, *TWO_PATHS),
        "trials": 10,
        "subtract_mean": True,
        "also": (
            {"perturbation": ("prbs", "pulses")},
            {"system": ("reflex-sine:noise_bandwidth=1", NAMES[0.0])},
            {"stiffness": ("square",), "system": ("reflex-square",)},
            {"stiffness": ("constant",), "system": ("reflex",), "snr_db": (10.0, 0.0)},
            {"system": (*NAMES.values(),)[1:], "methods": (*ONE_PATH, "cascade")},
            {"duration_s": AMOUNTS, "methods": ("tvpc", WINDOWLESS)},
        ),
    }
}
"""Forty realizations of a joint whose stiffness and reflex gain vary in a sine, by noise, PRBS,
pulses, and with slow noise; without a reflex; in a square wave; of a constant joint, with little
and much noise. Further scenarios vary the reflex gain, for methods of one pathway, and the amount
of data, for the ensemble cascade with and without its window."""

GAIN = "reflex_gain total_error"
VARYING = Scenario("sine", "noise", 80.0, 10.0, "constant", "reflex-sine")
SINE = VARYING.label
NO_GAIN, *GAINS = (VARYING._replace(system=name).label for name in NAMES.values())
LOUD = VARYING._replace(stiffness="constant", system="reflex", snr_db=0.0).label
*FEW, MANY = (VARYING._replace(duration_s=seconds).label for seconds in AMOUNTS)


def bias_ratio(none: Array, low: Array, high: Array) -> Array:
    """Return the logarithm of the ratio of biases at two gains, beyond the bias without gain.

    It is NaN where they have opposite signs.
    """
    return np.log((high - none) / (low - none))


WINDOW = (
    "Without a window, as its authors have it. The usual window pools 11 samples about each time: "
    "a tenth suffices."
)
CLAIMS = (
    claim(
        "Methods of one pathway take a reflex for stiffness", "Kearney et al. 1997",
        HIGHER, "mean_bias", ONE_PATH, GAINS,
    ),
    claim(
        "They do so in proportion to the reflex's torque (to within 25 %)", "Kearney et al. 1997",
        ratio(2 / 1.25, 2 * 1.25, of=bias_ratio), "mean_bias", ONE_PATH,
        [(NO_GAIN, *pair) for pair in pairwise(GAINS)],
    ),
    claim(
        "Methods of two pathways are free of it (of 75 % at least)", "Ludvig et al. 2011",
        ratio(high=0.25), "mean_bias",
        list(product(["cascade", "bpc", "tvpc"], ["birf", "kbr"])), SINE,
    ),
    Claim(
        "tvpc needs 500 to 800 realizations (for a reflex gain to within 25 %)",
        "Ludvig et al. 2011",
        [(Margin(2), GAIN, WINDOWLESS, FEW), (Margin(high=2), GAIN, WINDOWLESS, MANY)],
        WINDOW,
    ),
    claim(
        "Forty cycles suffice for bpc: reflex gain to within 25 %", "Guarin and Kearney 2017",
        Margin(high=2), GAIN, "bpc", SINE,
    ),
    claim(
        "Forty cycles suffice for bpc: stiffness to within 10 %", "Guarin and Kearney 2017",
        Margin(high=10), "total_error", "bpc", SINE,
    ),
    claim(
        "With much noise (0 dB) sdss is more robust than pc", "Jalaleddini et al. 2017",
        ratio(high=1), ["total_error", GAIN], [("sdss", "pc")], LOUD,
    ),
)  # fmt: skip
"""The joint that varies has a mean reflex gain of 8 N·m·s/rad and stiffness of 100 N·m/rad."""


def grouped(results: xr.Dataset, traits: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Return kind of system and profile of each scenario, and the mean gain of its reflex."""
    gains = results.truth.sel(quantity="reflex_gain").mean("time").to_series()
    return traits.system.str.partition(":")[0] + "-" + traits.profile, gains


STUDY = PublishedStudy(
    ("reflex", "reflex-sine", "reflex-square"),
    "the literature says of reflexes and of methods that separate them",
    PRESETS,
    CLAIMS,
    grouped,
    "gain of the reflex (N·m·s/rad)",
)
