"""Joints with a stretch reflex, identified by methods of one pathway and of two.

The literature gives no thresholds: those here are ours, and part of the sentences.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import BARS_OF_PATHWAYS, Illustration, method_comparison
from tvsysid.figures.results import OVER_TIME, scenario_traits, unique
from tvsysid.figures.words import TRAITS, count, perturbation_name, profile_name
from tvsysid.numerics import Array
from tvsysid.studies.claims import (
    HOW_DECIDED,
    RATIO,
    Claim,
    Comparison,
    Comparisons,
    Published,
    Scores,
    compare,
    judge_claims,
    log_ratio,
)
from tvsysid.studies.error_over import error_over
from tvsysid.studies.van_de_ruit_2021.simulations import ALIKE
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
QUANTITIES = ["stiffness", "reflex_gain"]
NAMES = {0.0: "reflex:reflex_gain=0"} | {gain: f"reflex:reflex_gain={gain:g}" for gain in GAINS}
"""Systems of constant gain."""

PRESETS: dict[str, dict[str, object]] = {
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

STIFFNESS, GAIN = "total_error", "reflex_gain total_error"
SINE = Scenario("sine", "noise", 80.0, 10.0, "constant", "reflex-sine")
CONSTANT = {gain: SINE._replace(system=name) for gain, name in NAMES.items()}
LOUD = SINE._replace(stiffness="constant", system="reflex", snr_db=0.0)
TIME_VARYING = ("cascade", "bpc", "tvpc")
MEAN_GAIN, MEAN_STIFFNESS = 8.0, 100.0  # of the joint that varies, in N·m·s/rad and N·m/rad
PART = 0.25  # of the bias of methods of one pathway that those of two may have
SMALL = 0.25  # total error of the reflex gain, as a share of its mean, of one that is identified
SMALL_STIFFNESS = 0.10  # likewise of the stiffness
INVENTED = 0.4  # N·m·s/rad of reflex gain that is none: a twentieth of the usual one


def judge(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim against the scores of a study."""
    return judge_claims(CLAIMS, Scores(scores))


def _below(metric: str, limit: float, words: str, scenario: Scenario, method: str) -> Comparisons:
    """Compare a metric of a method with a limit."""
    return compare([(words, (scenario, method, metric))], lambda value: limit - value)


def _in_proportion(none: Array, low: Array, high: Array) -> Array:
    """Return the margins of a bias that doubles with the gain, to within a quarter."""
    off = log_ratio(high - none, low - none) - np.log(2)
    return np.asarray(np.log1p(ALIKE) - np.stack([off, -off]))


N_M, RATE_GAIN, PRESET = "N·m/rad", "N·m·s/rad", "the preset reflex"
WINDOW = (
    "Without a window, as its authors have it. The usual window pools 11 samples about each time: "
    "a tenth suffices."
)
BIASED = [
    (
        f"mean bias of {method} {{0:.1f}} N·m/rad at a gain of {gain:g} N·m·s/rad",
        (CONSTANT[gain], method, "mean_bias"),
    )
    for method, gain in product(ONE_PATH, GAINS)
]
DOUBLED = [
    (
        f"mean bias of {method} {{1:.1f}} N·m/rad at a gain of {low:g}, {{2:.1f}} at {high:g}",
        *((CONSTANT[gain], method, "mean_bias") for gain in (0.0, low, high)),
    )
    for method, (low, high) in product(ONE_PATH, pairwise(GAINS))
]
FREE = [
    (
        f"mean bias of {method} {{0:.1f}} N·m/rad, of {rival} {{1:.1f}} N·m/rad",
        *((SINE, each, "mean_bias") for each in (method, rival)),
    )
    for method, rival in product(TIME_VARYING, ("birf", "kbr"))
]
ROBUST = [
    (
        f"total error of sdss {{0:{form}}} {unit}, of pc {{1:{form}}} {unit}",
        *((LOUD, method, metric) for method in ("sdss", "pc")),
    )
    for metric, form, unit in ((STIFFNESS, ".1f", N_M), (GAIN, ".2f", RATE_GAIN))
]


def _needs_many(scores: Scores) -> Iterator[Comparison]:
    """Compare the error of the reflex gain with a limit: above it with few data, else below."""
    for number in (*FEW, MANY):
        error = scores.of(SINE._replace(duration_s=PERIOD * number), WINDOWLESS, GAIN)
        if error is not None:
            share = error / MEAN_GAIN
            words = f"reflex gain off by {100 * share[0]:.0f} % with {number} realizations"
            yield Comparison(words, (share - SMALL) * (1 if number in FEW else -1))


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Methods of one pathway take a reflex for stiffness", "Kearney et al. 1997",
        compare(BIASED, lambda bias: bias), N_M, f"methods of one pathway ({PRESET})",
    ),
    Claim(
        f"They do so in proportion to the reflex's torque (to within {100 * ALIKE:g} %)",
        "Kearney et al. 1997", compare(DOUBLED, _in_proportion), RATIO,
        f"three gains of the reflex, and none ({PRESET})",
    ),
    Claim(
        f"Methods of two pathways are free of it (of {100 * (1 - PART):g} % at least)",
        "Ludvig et al. 2011",
        compare(FREE, lambda own, other: PART * np.abs(other) - np.abs(own)), N_M,
        f"cascade, bpc or tvpc beside birf and kbr ({PRESET})",
    ),
    Claim(
        f"Without a reflex cascade finds none (of more than {INVENTED:g} N·m·s/rad)",
        "this package",
        _below(
            GAIN, INVENTED, "total error {:.2f} N·m·s/rad by cascade without a reflex",
            CONSTANT[0.0], "cascade",
        ),
        RATE_GAIN, f"cascade ({PRESET})",
    ),
    Claim(
        f"tvpc needs 500 to 800 realizations (for a reflex gain to within {100 * SMALL:g} %)",
        "Ludvig et al. 2011", _needs_many, "share of the mean",
        f"{WINDOWLESS} with {FEW[0]}, {FEW[1]} and {MANY} realizations ({PRESET})", WINDOW,
    ),
    Claim(
        f"Forty cycles suffice for bpc: reflex gain to within {100 * SMALL:g} %",
        "Guarin and Kearney 2017",
        _below(GAIN, SMALL * MEAN_GAIN, "total error of bpc {:.2f} N·m·s/rad", SINE, "bpc"),
        RATE_GAIN, f"bpc ({PRESET})",
    ),
    Claim(
        f"Forty cycles suffice for bpc: stiffness to within {100 * SMALL_STIFFNESS:g} %",
        "Guarin and Kearney 2017",
        _below(
            STIFFNESS, SMALL_STIFFNESS * MEAN_STIFFNESS, "total error of bpc {:.1f} N·m/rad",
            SINE, "bpc",
        ),
        N_M, f"bpc ({PRESET})",
    ),
    Claim(
        "With much noise (0 dB) sdss is more robust than pc", "Jalaleddini et al. 2017",
        compare(ROBUST, lambda own, other: log_ratio(other, own)), RATIO,
        f"sdss and pc ({PRESET})",
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
        As of :func:`tvsysid.study.run`, and of these results, with full names
        (:func:`tvsysid.study.by_full_name`).
    """
    traits = scenario_traits(results)
    traits = traits.assign(
        kind=traits.system.str.partition(":")[0], methods=results.asked.values.sum(axis=1)
    )
    compared = traits[traits.methods >= min(2, traits.methods.max())]
    shown: dict[str, Illustration] = {}
    for (kind, profile), rows in compared.groupby(["kind", "profile"], sort=False):
        widest = rows[rows.methods == rows.methods.max()]
        own = widest.system.iloc[0] if widest.system.nunique() == 1 else kind
        what = ", ".join(
            [own, profile_name(profile), *map(perturbation_name, unique(widest.perturbation))]
        )
        shown[f"pathways-{kind}-{profile}"] = _pathways(results, summary, widest, what)
        gains = (
            results.truth.sel(scenario=list(rows.index), quantity="reflex_gain")
            .mean("time")
            .to_series()
        )
        if gains.nunique() > 2:
            shown[f"bias-{kind}-{profile}"] = _bias(
                summary, gains, f"{kind}, {profile_name(profile)}"
            )
    same = [name for name in TRAITS if name != "duration_s"]
    for _, rows in traits.groupby(same, sort=False):
        if rows.duration_s.nunique() > 2:
            system, profile = rows.system.iloc[0], rows.profile.iloc[0]
            shown[f"amount-{system}-{profile}"] = _amount(
                summary, rows.duration_s, f"{system}, {profile_name(profile)}"
            )
    return shown


def _pathways(
    results: xr.Dataset, summary: pd.DataFrame, rows: pd.DataFrame, what: str
) -> Illustration:
    labels, title = list(rows.index), f"Both pathways: {what}"
    mine = summary[summary.scenario.isin(labels)]
    methods = unique(mine.method)
    drawing = partial(
        method_comparison,
        results[OVER_TIME].sel(
            scenario=labels, quantity=["stiffness", "reflex_gain"], method_key=methods
        ),
        mine,
        labels[:1],
        labels,
        title,
        BARS_OF_PATHWAYS,
    )
    text = (
        f"A column for each of {count(len(methods), 'method')}. Upper rows, over one realization "
        f"of {labels[0]}: estimated stiffness and reflex gain, mean and two standard deviations "
        f"over {count(results.sizes['trial'], 'trial')}, against the truth, and time-varying VAF. "
        "Lower rows: bars of the errors and of the VAF of each pathway for "
        f"{count(len(labels), 'scenario')}: {', '.join(labels)}."
    )
    return Illustration(drawing, title, text)


def _bias(summary: pd.DataFrame, gains: pd.Series, what: str) -> Illustration:
    return error_over(
        summary,
        "mean_bias",
        gains,
        f"What a reflex does to the stiffness: {what}",
        "Mean bias of the stiffness in N·m/rad against the gain of the reflex in N·m·s/rad.",
        "gain of the reflex (N·m·s/rad)",
    )


def _amount(summary: pd.DataFrame, durations: pd.Series, what: str) -> Illustration:
    return error_over(
        summary,
        "reflex_gain total_error",
        durations,
        f"How much data a reflex needs: {what}",
        "Total error of the reflex gain in N·m·s/rad against seconds of data.",
        "data (s)",
        "total error of the reflex gain (N·m·s/rad)",
    )


LITERATURE = Published(
    judge,
    reflex_figures,
    "What the literature says of reflexes and of methods that separate them, and whether this "
    f"study finds it. {HOW_DECIDED}",
    tuple(PRESETS),
)


def published(results: xr.Dataset) -> Published | None:
    """Return the claims for a simulation study of a joint with a reflex."""
    gain = {"quantity": "reflex_gain"}
    if "reflex_gain" not in results.quantity.values or results.truth.sel(gain).isnull().any():
        return None
    return LITERATURE if results.estimate.sel(gain).notnull().any() else None
