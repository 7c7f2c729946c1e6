"""Simulations of van de Ruit et al. (2021): studies, claims, and figure 2.

The paper gives few thresholds. Those here are ours, and part of the sentences.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tvsysid import figures
from tvsysid.figures.saving import Illustration
from tvsysid.methods import PAPER_METHODS as FIVE
from tvsysid.models import IMPEDANCE
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.studies.claims import HIGHER, HIGHER_RATIO, Margin, claim, labels, ranked, ratio
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.study.scenarios import RATE, Study
from tvsysid.study.trials import draw

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

DURATIONS = (40.0, 80.0, 150.0, 300.0, 600.0)  # s
SNRS = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)  # dB
VAF_OF_A_TRIAL = (
    "The paper does not say over what it is taken: here, the mean over the realizations of a trial."
)
DECIMATION = (
    "The low-pass before decimation smears every switch over some 30 ms, and noise does the rest: "
    "eirf errs there too, only far less than the others."
)
SINE_BIAS = (
    "Ten cubic B-splines represent a sine of the period almost exactly, so that little of birf's "
    "bias is left; esm's window of 0.3 s averages a curve that bends, and its estimate at 0 Hz "
    "leaks. An independent implementation finds the same."
)
VAF_RANKING = (
    "eirf estimates 25 numbers at each of 200 times and predicts with all their noise, so that "
    "against noiseless torque sds and kbr do better. Measured against noisy torque, as with "
    "people, the VAF rewards fitting the noise, and eirf has the highest; the paper's statement "
    "may come from there."
)
PERTURBATION = (
    "The noise is scaled to the torque, of which inertia takes a larger part with PRBS, and the "
    "two perturbations excite different bands: with PRBS the random error of esm is lower, that of "
    "sds and kbr higher."
)
RESIDUE = (
    "With little noise the random error no longer falls: what is left comes from the perturbation, "
    "which differs from trial to trial, where a method's model does not fit (switches within a "
    "window, leakage of esm). So the amounts of data tell what noise does only while it prevails, "
    "up to some 10 dB at 150 s."
)

WITH_RESPONSES = ("eirf", "sds", "birf:model=irf")
SHOWN_SAMPLES = [25, 100]  # half-way between two switches: low and high stiffness
RESPONSES_TITLE = "Impulse responses at a low and a high stiffness: PRBS, 150 s, 10 dB"
RESPONSES_TEXT = (
    "Impulse responses in N·m/(rad·s) over lags, at a low and a high stiffness (N·m/rad) of the "
    "square wave. Each is from one trial, by a method with the paper's settings. The true response "
    "behind them is limited to the band of the data."
)

PRESETS = {
    "quick": {},
    "paper": {
        "methods": FIVE,
        "duration_s": DURATIONS,
        "also": ({"stiffness": ("sine",), "duration_s": (150.0,)},),
        "trials": 100,
    },
    "snr": {"snr_db": SNRS, "trials": 100},
    "viscosity": {"viscosity": ("constant", "covarying"), "trials": 100},
}
"""The default study; that of the paper with its Appendix A; and two that it leaves open."""


def pairs(*sides: list[str]) -> list[tuple[str, ...]]:
    """Return the first of each side, the second of each, and so on."""
    return list(zip(*sides, strict=True))


# Each begins with all scenarios with noise; those with PRBS follow
SQUARES, SINES = labels(duration_s=DURATIONS), labels(stiffness="sine")
BY_PERTURBATION = pairs(SQUARES[: len(DURATIONS)], SQUARES[len(DURATIONS) :])
AT_40, AT_80, AT_600 = (labels(duration_s=seconds) for seconds in (40.0, 80.0, 600.0))
FEW_HUNDRED = labels(duration_s=DURATIONS[3:])  # of 300 s and more
BY_TEN_DECIBELS = pairs(labels(snr_db=SNRS[:-2]), labels(snr_db=SNRS[2:]))
BY_VISCOSITY = pairs(labels(), labels(viscosity="covarying"))

BIAS, RANDOM, TOTAL = "debiased_bias_error", "random_error", "total_error"
VARIES = "time_varying_vaf_sd"
HARDLY = ratio(1 / 1.25, 1.25)
LOWEST_EIRF, HIGHEST_EIRF = ranked("sds birf esm kbr > eirf"), ranked("eirf > sds birf esm kbr")
HIGHEST_BIRF, BETWEEN = ranked("birf > eirf sds esm kbr"), ranked("birf > sds esm kbr > eirf")

CLAIMS = (
    claim("eirf has the lowest bias", "3.4", HIGHER, BIAS, LOWEST_EIRF, SQUARES),
    claim("eirf has the highest random error", "3.4", HIGHER_RATIO, RANDOM, HIGHEST_EIRF, SQUARES),
    claim("eirf has the shortest rise time", "3.4", HIGHER, "rise_time", LOWEST_EIRF, SQUARES),
    claim("birf has the largest bias", "3.4", HIGHER, BIAS, HIGHEST_BIRF, SQUARES),
    claim(
        "birf has the smallest random error", "3.4",
        HIGHER_RATIO, RANDOM, ranked("eirf sds esm kbr > birf"), SQUARES,
    ),
    claim(
        "sds, esm, kbr lie between eirf and birf in bias", "3.4",
        HIGHER, BIAS, BETWEEN, SQUARES,
    ),
    claim(
        "sds, esm, kbr lie between birf and eirf in random error", "3.4",
        HIGHER_RATIO, RANDOM, ranked("eirf > sds esm kbr > birf"), SQUARES,
    ),
    claim(
        "sds, esm, kbr lie between eirf and birf in rise time", "3.4",
        HIGHER, "rise_time", BETWEEN, SQUARES,
    ),
    claim(
        "eirf is most sensitive to the amount of data", "3.4",
        HIGHER_RATIO, RANDOM, HIGHEST_EIRF, pairs(AT_40, AT_600),
    ),
    claim(
        "eirf improves strongly above 40 s", "3.4",
        # averaging alone gives the square root of two
        ratio(np.sqrt(2)), RANDOM, "eirf", pairs(AT_40, AT_80),
    ),
    claim(
        "Given a few hundred realizations, eirf has the smallest total error", "5",
        HIGHER_RATIO, TOTAL, LOWEST_EIRF, FEW_HUNDRED,
    ),
    claim(
        "Given a few hundred realizations, eirf has the highest VAF", "5",
        HIGHER, "vaf", HIGHEST_EIRF, FEW_HUNDRED, disagreement=VAF_RANKING,
    ),
    claim(
        "The time-varying VAF dips at the switches for sds, birf, esm and kbr (by more than 1 "
        "point)", "3.4", Margin(1), "switch_dip", FIVE[1:], SQUARES,
    ),
    claim(
        "The time-varying VAF of eirf does not dip at the switches (by less than 1 point)", "3.4",
        Margin(high=1), "switch_dip", "eirf", SQUARES, disagreement=DECIMATION,
    ),
    *(
        claim(
            f"Under most conditions the {metric.replace('_', ' ')} hardly depends on the "
            "perturbation (less than 25 %)", "3.4",
            HARDLY, metric, FIVE, BY_PERTURBATION,
            disagreement=PERTURBATION, most=True,
        )
        for metric in (TOTAL, RANDOM)
    ),
    claim(
        "With a sine, birf has the largest bias", "A",
        HIGHER, BIAS, HIGHEST_BIRF, SINES, disagreement=SINE_BIAS,
    ),
    claim("With a sine, eirf varies most", "A", HIGHER_RATIO, RANDOM, HIGHEST_EIRF, SINES),
    claim(
        "With a sine, sds and kbr have the lowest bias", "A",
        HIGHER, BIAS, ranked("eirf birf esm > sds kbr"), SINES, disagreement=SINE_BIAS,
    ),
    claim(
        "With a sine, birf and kbr have the lowest random error", "A",
        HIGHER_RATIO, RANDOM, ranked("eirf sds esm > birf kbr"), SINES,
    ),
    claim(
        "With a sine, the time-varying VAF varies more with PRBS than with noise", "A",
        HIGHER, VARIES, FIVE, [SINES[::-1]],
    ),
    claim(
        "With a sine, the time-varying VAF varies more where the stiffness is low", "A",
        HIGHER, [(f"{VARIES}_soft", f"{VARIES}_stiff")], FIVE, SINES,
    ),
    claim(
        "10 dB less noise lowers the random error as much as ten times the data: 3.2-fold (to "
        "within 25 %)", "5",
        ratio(np.sqrt(10) / 1.25, np.sqrt(10) * 1.25), RANDOM, FIVE, BY_TEN_DECIBELS,
        disagreement=RESIDUE,
    ),
    claim(
        "Viscosity that covaries from 1 to 3 N·m·s/rad changes nothing (errors differ by less than "
        "25 %)", "5", HARDLY, [TOTAL, RANDOM], FIVE, BY_VISCOSITY,
    ),
    claim(
        "Every VAF is above 85 % (square wave)", "3.4",
        Margin(85), "lowest_vaf", FIVE, SQUARES, disagreement=VAF_OF_A_TRIAL,
    ),
    claim(
        "Every VAF is above 90 % (sine)", "A",
        Margin(90), "lowest_vaf", FIVE, SINES, disagreement=VAF_OF_A_TRIAL,
    ),
)  # fmt: skip


def grouped(_: xr.Dataset, traits: pd.DataFrame) -> tuple[pd.Series, int]:
    """Return profile and perturbation of each scenario; no size is of interest."""
    ending = traits.viscosity.map({"constant": "", "covarying": "-covarying"})
    return traits.profile + ending + "-" + traits.perturbation, 0


def draw_responses() -> Figure:
    """Draw the impulse responses that the paper's figure 2 shows."""
    return figures.impulse_responses(example_responses(), RESPONSES_TITLE)


def example_responses() -> xr.Dataset:
    r"""Return impulse responses of the first trial of 150 s (square wave, PRBS), like figure 2.

    The true one is that of :math:`I s^2 + b s + k` in the band of the data (up to 80 % of the
    Nyquist frequency), for a response that holds all frequencies has no finite values.

    ``impulse_response`` over (method_key, instant, lag) and ``true_impulse_response`` over
    (instant, lag) are in N·m/(rad·s), with the coordinate ``stiffness`` in N·m/rad over (instant).
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    study = Study(perturbation=("prbs",), methods=WITH_RESPONSES)
    ensemble, truth = draw(study, study.scenarios[0], 0)
    models = [each.identify(ensemble) for each in study.parts["methods"].values()]
    true = np.stack([truth.quantities[name][SHOWN_SAMPLES] for name in IMPEDANCE], axis=-1)
    # Discrete weights of a derivative of order m are those for unit sample time, times the rate to
    # the power m; a response is per second, which is once more the rate.
    weights = derivative_weights(HALF_WIDTH) * RATE ** np.array([[1.0], [2.0], [3.0]])
    found = xr.concat([each.to_xarray()[["impulse_response"]] for each in models], "method_key")
    shown: xr.Dataset = found.isel(time=SHOWN_SAMPLES).rename(time="instant")
    shown["true_impulse_response"] = ("instant", "lag"), true @ weights
    return shown.assign_coords(method_key=[*WITH_RESPONSES], stiffness=("instant", true[:, 0]))


STUDY = PublishedStudy(
    ("joint",),
    "van de Ruit et al. (2021) say of their simulations",
    PRESETS,
    CLAIMS,
    grouped,
    of_square_wave={
        "impulse-responses": Illustration(draw_responses, RESPONSES_TITLE, RESPONSES_TEXT)
    },
)
