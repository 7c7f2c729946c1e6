"""Claims on methods with and without a reflex, tested against the scores of a study.

The limits are those of drawing trials. The literature gives no thresholds: those here are ours,
and part of the sentences.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.studies.reflex.presets import FEW, GAINS, MANY, NAMES, ONE_PATH, PERIOD, WINDOWLESS
from tvsysid.studies.scored import Margins, Scores, judged_by, margin
from tvsysid.studies.van_de_ruit_2021.simulations import ALIKE, Replicated
from tvsysid.studies.verdicts import RATIO, Claim, log_ratio
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

STIFFNESS, GAIN = "total_error", "reflex_gain total_error"
SINE = Scenario("sine", "noise", 80.0, 10.0, "constant", "reflex-sine")
CONSTANT = {gain: SINE._replace(system=name) for gain, name in NAMES.items()}
LOUD = SINE._replace(stiffness="constant", system="reflex", snr_db=0.0)
TIME_VARYING = ("cascade", "bpc", "tvpc")
MEAN_GAIN, MEAN_STIFFNESS = 8.0, 100.0  # of the joint that varies, in N·m·s/rad and N·m/rad
PART = 0.25  # of the bias of methods of one pathway that those of two may have
# total error of the reflex gain, relative to its mean, below which the gain counts as identified
SMALL = 0.25
TELLS = 0.10  # likewise for the stiffness
# N·m·s/rad of reflex gain up to which nothing is said to be found: a twentieth of the usual gain
INVENTED = 0.4


def judge(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim against the scores of a study.

    Columns are those of the claims of a published study.
    """
    return judged_by(CLAIMS, scores)


def _below(metric: str, limit: float, words: str, where: dict[str, Scenario]) -> Margins:
    """Test that a metric of each method in its scenario is below a limit.

    The words name ``method`` and ``value``.
    """

    def margins(scores: Scores) -> Iterator[Replicated]:
        for method, scenario in where.items():
            for found in scores.of((scenario, method, metric)):
                yield margin(words.format(method=method, value=found[0]), limit - found)

    return margins


def _takes_reflex_for_stiffness(scores: Scores) -> Iterator[Replicated]:
    for method, gain in itertools.product(ONE_PATH, GAINS):
        for bias in scores.of((CONSTANT[gain], method, "mean_bias")):
            yield margin(
                f"mean bias of {method} {bias[0]:.1f} N·m/rad at a gain of {gain:g} N·m·s/rad", bias
            )


def _in_proportion(scores: Scores) -> Iterator[Replicated]:
    """Test that twice the reflex doubles its share of the bias, to within a quarter."""
    for method, (one, other) in itertools.product(ONE_PATH, itertools.pairwise(GAINS)):
        if found := scores.of(
            *((CONSTANT[gain], method, "mean_bias") for gain in (0.0, one, other))
        ):
            none, low, high = found
            words = (
                f"mean bias of {method} {low[0]:.1f} N·m/rad at a gain of {one:g}, "
                f"{high[0]:.1f} at {other:g}"
            )
            off = log_ratio(high - none, low - none) - np.log(other / one)
            yield from (margin(words, np.log1p(ALIKE) - each) for each in (off, -off))


def _mends(scores: Scores) -> Iterator[Replicated]:
    for method, rival in itertools.product(TIME_VARYING, ("birf", "kbr")):
        if found := scores.of(*((SINE, each, "mean_bias") for each in (method, rival))):
            own, other = found
            words = f"mean bias of {method} {own[0]:.1f} N·m/rad, of {rival} {other[0]:.1f} N·m/rad"
            yield margin(words, PART * np.abs(other) - np.abs(own))


def _needs_many(scores: Scores) -> Iterator[Replicated]:
    for count in (*FEW, MANY):
        for found in scores.of((SINE._replace(duration_s=PERIOD * count), WINDOWLESS, GAIN)):
            words = (
                f"reflex gain off by {100 * found[0] / MEAN_GAIN:.0f} % with {count} realizations"
            )
            yield margin(words, (found / MEAN_GAIN - SMALL) * (1 if count in FEW else -1))


def _more_robust(scores: Scores) -> Iterator[Replicated]:
    for metric, what in ((STIFFNESS, "{:.1f} N·m/rad"), (GAIN, "{:.2f} N·m·s/rad")):
        if found := scores.of(*((LOUD, method, metric) for method in ("sdss", "pc"))):
            own, other = (what.format(each[0]) for each in found)
            yield margin(f"total error of sdss {own}, of pc {other}", log_ratio(found[1], found[0]))


N_M, SHARE, RATE_GAIN = "N·m/rad", "share of the mean", "N·m·s/rad"
PRESET = "the preset reflex"
ERROR = "total error {value:.2f} N·m·s/rad by {method} without a reflex"
WINDOW = (
    "Without a window, as its authors have it. The usual window pools 11 samples about each "
    "time: a tenth suffices."
)
CLAIMS: tuple[Claim, ...] = (
    Claim("Methods of one pathway take a reflex for "
          "stiffness", "Kearney et al. 1997", _takes_reflex_for_stiffness,
          N_M, f"methods of one pathway ({PRESET})"),
    Claim(f"They do so in proportion to the reflex's torque (to within {100 * ALIKE:g} "
          f"%)", "Kearney et al. 1997",
          _in_proportion, RATIO, f"three gains of the reflex, and none ({PRESET})"),
    Claim(f"Methods of two pathways are free of it (of {100 * (1 - PART):g} % at "
          f"least)", "Ludvig et al. 2011",
          _mends, N_M, f"cascade, bpc or tvpc beside birf and kbr ({PRESET})"),
    Claim(f"Without a reflex cascade finds none (of more than {INVENTED:g} "
          f"N·m·s/rad)", "this package",
          _below(GAIN, INVENTED, ERROR, {"cascade": CONSTANT[0.0]}), RATE_GAIN, f"cascade "
                                                                                f"({PRESET})"),
    Claim(f"tvpc needs 500 to 800 realizations (for a reflex gain to within {100 * SMALL:g} "
          f"%)", "Ludvig et al. 2011",
          _needs_many, SHARE, f"{WINDOWLESS} with {FEW[0]}, {FEW[1]} and {MANY} realizations "
                              f"({PRESET})", WINDOW),
    Claim(f"Forty cycles suffice for bpc: reflex gain to within {100 * SMALL:g} "
          f"%", "Guarin and Kearney 2017",
          _below(GAIN, SMALL * MEAN_GAIN, "total error of {method} {value:.2f} "
                                          "N·m·s/rad", {"bpc": SINE}),
          RATE_GAIN, f"bpc ({PRESET})"),
    Claim(f"Forty cycles suffice for bpc: stiffness to within {100 * TELLS:g} "
          f"%", "Guarin and Kearney 2017",
          _below(STIFFNESS, TELLS * MEAN_STIFFNESS, "total error of {method} {value:.1f} "
                                                    "N·m/rad", {"bpc": SINE}),
          N_M, f"bpc ({PRESET})"),
    Claim("With much noise (0 dB) sdss is more robust than "
          "pc", "Jalaleddini et al. 2017", _more_robust, RATIO,
          f"sdss and pc ({PRESET})"),
)  # fmt: skip
