"""Joints with a stretch reflex, identified by methods of one pathway and of two.

The literature gives no thresholds: those here are ours, and part of the sentences.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import METRICS_OF_PATHWAYS, Illustration
from tvsysid.figures.results import scenario_traits, unique
from tvsysid.figures.words import TRAITS, perturbation_name, profile_name
from tvsysid.numerics import Array
from tvsysid.studies.claims import HIGHER, HOW_DECIDED, Claim, Margin, ratio
from tvsysid.studies.pictures import comparison, error_over_size
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

ONE_PATH = ("eirf", "sds", "birf", "kbr")
TWO_PATHS = ("cascade", "bpc", "tvpc", "pc", "sdss")
GAINS = (4.0, 8.0, 16.0)  # of the reflex in N·m·s/rad, beside 0
FEW, MANY = (100, 300), 600  # realizations; the ensemble cascade is said to need 500 to 800
WINDOWLESS = "tvpc:window=0"  # each time by itself, as its authors have it
PERIOD = 2.0  # s
NAMES = {gain: f"reflex:reflex_gain={gain:g}" for gain in (0.0, *GAINS)}
"""Systems of constant gain."""

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
            {
                "system": tuple(NAMES[gain] for gain in GAINS),
                "methods": (*ONE_PATH, *TWO_PATHS[:1]),
            },
            {
                "duration_s": tuple(PERIOD * count for count in (*FEW, MANY)),
                "methods": ("tvpc", WINDOWLESS),
            },
        ),
    }
}
"""Forty realizations of a joint whose stiffness and reflex gain vary in a sine, by noise, PRBS,
pulses, and with slow noise; without a reflex; in a square wave; of a constant joint, with little
and much noise. Further scenarios vary the reflex gain, for methods of one pathway, and the amount
of data, for the ensemble cascade with and without its window."""

STIFFNESS, GAIN, BIAS = "total_error", "reflex_gain total_error", "mean_bias"
SINE = Scenario("sine", "noise", 80.0, 10.0, "constant", "reflex-sine")
CONSTANT = {gain: SINE._replace(system=name) for gain, name in NAMES.items()}
LOUD = SINE._replace(stiffness="constant", system="reflex", snr_db=0.0)
AMOUNTS = {count: SINE._replace(duration_s=PERIOD * count).label for count in (*FEW, MANY)}
MEAN_GAIN, MEAN_STIFFNESS = 8.0, 100.0  # of the joint that varies, in N·m·s/rad and N·m/rad
ALIKE = 1.25  # ratio within which a bias counts as proportional to the gain
PART = 0.25  # of the bias of methods of one pathway that those of two may have
SMALL = 0.25  # total error of the reflex gain, as a share of its mean, of one that is identified
SMALL_STIFFNESS = 0.10  # likewise of the stiffness
INVENTED = 0.4  # N·m·s/rad of reflex gain that is none: a twentieth of the usual one


def bias_ratio(none: Array, low: Array, high: Array) -> Array:
    """Return the logarithm of the ratio of biases at two gains, beyond the bias without gain.

    It is NaN where they have opposite signs.
    """
    return np.asarray(np.log((high - none) / (low - none)))


PRESET = "the preset reflex"
WINDOW = (
    "Without a window, as its authors have it. The usual window pools 11 samples about each time: "
    "a tenth suffices."
)
CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Methods of one pathway take a reflex for stiffness", "Kearney et al. 1997",
        f"methods of one pathway ({PRESET})",
        [(HIGHER, BIAS, ONE_PATH, [CONSTANT[gain].label for gain in GAINS])],
    ),
    Claim(
        "They do so in proportion to the reflex's torque (to within "
        f"{100 * (ALIKE - 1):g} %)", "Kearney et al. 1997",
        f"three gains of the reflex, and none ({PRESET})",
        [(
            ratio(2 / ALIKE, 2 * ALIKE, of=bias_ratio), BIAS, ONE_PATH,
            [tuple(CONSTANT[gain].label for gain in (0.0, *pair)) for pair in pairwise(GAINS)],
        )],
    ),
    Claim(
        f"Methods of two pathways are free of it (of {100 * (1 - PART):g} % at least)",
        "Ludvig et al. 2011", f"cascade, bpc or tvpc beside birf and kbr ({PRESET})",
        [(
            ratio(high=PART), BIAS,
            [(own, other) for own in ("cascade", "bpc", "tvpc") for other in ("birf", "kbr")],
            SINE.label,
        )],
    ),
    Claim(
        f"Without a reflex cascade finds none (of more than {INVENTED:g} N·m·s/rad)",
        "this package", f"cascade ({PRESET})",
        [(Margin(high=INVENTED), GAIN, "cascade", CONSTANT[0.0].label)],
    ),
    Claim(
        f"tvpc needs 500 to 800 realizations (for a reflex gain to within {100 * SMALL:g} %)",
        "Ludvig et al. 2011",
        f"{WINDOWLESS} with {FEW[0]}, {FEW[1]} and {MANY} realizations ({PRESET})",
        [
            (Margin(SMALL * MEAN_GAIN), GAIN, WINDOWLESS, [AMOUNTS[count] for count in FEW]),
            (Margin(high=SMALL * MEAN_GAIN), GAIN, WINDOWLESS, AMOUNTS[MANY]),
        ],
        WINDOW,
    ),
    Claim(
        f"Forty cycles suffice for bpc: reflex gain to within {100 * SMALL:g} %",
        "Guarin and Kearney 2017", f"bpc ({PRESET})",
        [(Margin(high=SMALL * MEAN_GAIN), GAIN, "bpc", SINE.label)],
    ),
    Claim(
        f"Forty cycles suffice for bpc: stiffness to within {100 * SMALL_STIFFNESS:g} %",
        "Guarin and Kearney 2017", f"bpc ({PRESET})",
        [(Margin(high=SMALL_STIFFNESS * MEAN_STIFFNESS), STIFFNESS, "bpc", SINE.label)],
    ),
    Claim(
        "With much noise (0 dB) sdss is more robust than pc", "Jalaleddini et al. 2017",
        f"sdss and pc ({PRESET})",
        [(ratio(high=1), [STIFFNESS, GAIN], [("sdss", "pc")], LOUD.label)],
    ),
)  # fmt: skip


def reflex_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, by the stem of the file's name.

    ``"pathways-reflex-sine-sine"``: stiffness and reflex gain over time of the first scenario of a
    system and a profile, with bars of all its scenarios; ``"bias-reflex-sine"``: bias of the
    stiffness against the gain, where several constant gains were simulated;
    ``"amount-reflex-sine"``: error of the gain against the data, where more than two durations
    were.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    """
    gain = results.truth.sel(quantity="reflex_gain").mean("time").to_series()
    traits = scenario_traits(results).assign(gain=gain, methods=results.asked.values.sum(axis=1))
    traits = traits.assign(kind=traits.system.str.partition(":")[0])
    compared = traits[traits.methods >= min(2, traits.methods.max())]
    shown: dict[str, Illustration] = {}
    for (kind, profile), rows in compared.groupby(["kind", "profile"], sort=False):
        widest = rows[rows.methods == rows.methods.max()]
        systems = unique(widest.system)
        words = [systems[0] if len(systems) == 1 else kind, profile_name(profile)]
        words += map(perturbation_name, unique(widest.perturbation))
        labels = list(widest.index)
        shown[f"pathways-{kind}-{profile}"] = comparison(
            results,
            summary,
            labels[:1],
            labels,
            f"Both pathways: {', '.join(words)}",
            ("stiffness", "reflex_gain"),
            METRICS_OF_PATHWAYS,
        )
        if rows.gain.nunique() > 2:
            title = f"What a reflex does to the stiffness: {kind}, {profile_name(profile)}"
            shown[f"bias-{kind}-{profile}"] = error_over_size(
                summary, BIAS, rows.gain, title, "gain of the reflex (N·m·s/rad)"
            )
    same = [name for name in TRAITS if name != "duration_s"]
    for (name, profile, *_), rows in traits.groupby(same, sort=False):
        if rows.duration_s.nunique() > 2:
            title = f"How much data a reflex needs: {name}, {profile_name(profile)}"
            shown[f"amount-{name}-{profile}"] = error_over_size(
                summary,
                GAIN,
                rows.duration_s,
                title,
                "data (s)",
                "total error of the reflex gain (N·m·s/rad)",
            )
    return shown


def separates_pathways(results: xr.Dataset) -> bool:
    """Whether every joint has a reflex gain, and a method estimates it."""
    if "reflex_gain" not in results.quantity:
        return False
    gain = results.sel(quantity="reflex_gain")
    return bool(gain.truth.notnull().all() and gain.estimate.notnull().any())


STUDY = PublishedStudy(
    PRESETS,
    CLAIMS,
    "What the literature says of reflexes and of methods that separate them, and whether this "
    f"study finds it. {HOW_DECIDED}",
    reflex_figures,
    separates_pathways,
)
