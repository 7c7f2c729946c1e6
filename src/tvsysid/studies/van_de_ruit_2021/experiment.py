"""Claims of van de Ruit et al. (2021) about their experiment.

Samples are the numbers of participants, with limits of a t distribution. The paper gives no
thresholds: those here are ours, and part of the sentences.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import t as student

from tvsysid.figures.results import unique
from tvsysid.methods import PAPER_METHODS as FIVE
from tvsysid.numerics import Array
from tvsysid.studies.claims import HIGHER, HIGHER_RATIO, TAIL, Claim, Evidence, Margin
from tvsysid.study import score
from tvsysid.study.bootstraps import STEPS

if TYPE_CHECKING:
    import xarray as xr

FOUR = ("eirf", "sds", "birf", "esm")
MIN_PARTICIPANTS = 3  # below which nothing is decided
PAPER_REALIZATIONS = 75  # in the paper's 150 s
MAX_CHANGE = 5.0  # change of the mean stiffness in per cent up to which it stays similar
MAX_RISE = 1.0  # percentage points up to which a VAF rises only marginally
MIN_CORRELATION = 0.5  # over time, of stiffness with torque, from which on it rises with it
DIP_WIDTH = 0.1  # part of a period about its beginning and middle where the VAF is reduced
RECORDED = 300  # realizations from each of the paper's participants under either perturbation
SURVIVED = {"noise": (260.0, 12.0), "prbs": (255.0, 14.0)}
"""Mean and standard deviation of the paper's survivors of 300 realizations (section 4.4)."""
EXCLUDED = {
    "noise": {"alignment": (0, 3), "task": (4, 12), "residual": (17, 29)},
    "prbs": {"alignment": (5, 40), "task": (3, 10), "residual": (15, 20)},
}
"""Range over the paper's participants of what each step excluded (section 4.1.5)."""
COUNTS = {
    name: (
        f"{RECORDED}",
        *(f"{low} to {high}" for low, high in excluded.values()),
        "{:g} ± {:g}".format(*SURVIVED[name]),
    )
    for name, excluded in EXCLUDED.items()
}
"""Realizations recorded, excluded by each step, and kept, by perturbation, in the paper."""
LEVELS = {"prbs": (74.8, 87.2), "noise": (49.4, 62.7)}
"""Lowest and highest mean VAF of the four methods in the paper, from 150 s (section 4.4)."""
EXTREMES = ("lowest_vaf_of_four", "highest_vaf_of_four")
NEAR = 5.0  # percentage points within which a VAF is near the paper's
NAMES = ("noise", "prbs")
LESS, MORE = "less data", "more data"


UNITS = {
    "realizations": "",
    "vaf": "%",
    "bandpassed_vaf": "%",
    "random_error": "N·m/rad",
    "correlation_with_torque": "",
    "vaf_dip": "%",
    "stiffness_change": "%",
}
"""Unit of each quantity of an analysis."""


def experiment_evidence(results: xr.Dataset) -> Evidence:
    """Return the numbers of participants by quantity, method, perturbation and amount of data.

    Counts of realizations, of 300 as in the paper, belong to a perturbation alone. So do the lowest
    and the highest VAF of four methods, from as many realizations as in the paper.
    """
    counts = ["survivors", *(f"excluded_{step}" for step in STEPS)]
    recorded = results.recorded.where(results.recorded > 0)
    scaled = (RECORDED * results[counts] / recorded).to_dataframe()
    analyses = experiment_quantities(results).to_dataframe().reset_index()
    order = analyses.groupby(["participant", "perturbation", "method_key"]).realizations.rank()
    analyses["amount"] = order.map({1: LESS, 2: MORE})
    people = unique(results.participant.values)
    values = {
        (str(name), *key): mine.set_index("participant")[name].reindex(people).to_numpy()
        for table, keys, names in (
            (scaled, ["perturbation"], counts),
            (analyses, ["method_key", "perturbation", "amount"], UNITS),
        )
        for key, mine in table.reset_index().groupby(keys)
        for name in names
    }
    for name in NAMES:
        keys = [("realizations", method, name, LESS) for method in FOUR]
        if all(np.nanmax(values.get(key, [0])) == PAPER_REALIZATIONS for key in keys):
            vafs = [values["vaf", *key[1:]] for key in keys]
            ends = np.argsort([participant_interval(each, TAIL)[0] for each in vafs])[[0, -1]]
            for quantity, place in zip(EXTREMES, ends, strict=True):
                values[quantity, name] = vafs[place]
    few = len(people) < MIN_PARTICIPANTS
    return Evidence(
        values,
        UNITS | dict.fromkeys(counts, "realizations") | dict.fromkeys(EXTREMES, "%"),
        participant_interval,
        more="participants",
        too_few=f"Needs at least {MIN_PARTICIPANTS} participants." if few else "",
    )


def experiment_quantities(results: xr.Dataset) -> xr.Dataset:
    r"""Return what the claims are about, over recording and analysis.

    ``vaf_dip`` is the time-varying VAF at a period's quarters less that at its ends and middle.
    ``stiffness_change`` is the RMS change of the mean stiffness from less to more data, in per
    cent. A mean over few bootstraps is off by chance; what that adds is subtracted:

    .. math:: \overline{(\bar k_2 - \bar k_1)^2 - s_1^2 / n_1 - s_2^2 / n_2}
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    own = results.sel(quantity="stiffness", drop=True)
    draws = own.estimate
    mean = draws.mean("bootstrap")
    vaf = results.time_varying_vaf.mean("bootstrap")
    time = results.time - results.time[0]
    from_turn = np.abs((2 * time / (time[-1] + time[1]) + 0.5) % 1 - 0.5) / 2
    away, at = from_turn > 0.25 - DIP_WIDTH / 2, from_turn < DIP_WIDTH / 2
    scores = score(results.sel(quantity=["stiffness"])).value
    scores = scores.sel(metric=["vaf", "bandpassed_vaf", "random_error"])
    measured = scores.drop_vars("unit").to_dataset("metric")
    found: xr.Dataset = measured.assign(
        correlation_with_torque=xr.corr(mean, results.mean_torque, "time"),
        vaf_dip=vaf.where(away).mean("time") - vaf.where(at).mean("time"),
    )
    chance = draws.var("bootstrap", ddof=1) / draws.count("bootstrap")
    more = xr.Dataset({"mean": mean, "chance": chance}).sortby("realizations")
    less = more.groupby("method_key").map(lambda each: each.shift(analysis=1))
    square = ((more["mean"] - less["mean"]) ** 2 - more.chance - less.chance).mean("time")
    change = 100 * np.sqrt(square.clip(min=0)) / less["mean"].mean("time")
    return found.sortby("realizations").assign(stiffness_change=change).reset_coords("realizations")


def participant_interval(samples: Array, tail: float) -> tuple[float, float, float]:
    """Return mean and limits of a t distribution over participants; no limits of two or fewer."""
    known = samples[np.isfinite(samples)]
    count = len(known)
    mean = known.mean() if count else math.nan
    if count < MIN_PARTICIPANTS:
        return mean, math.nan, math.nan
    width = student.isf(tail, count - 1) * known.std(ddof=1) / math.sqrt(count)
    return mean, mean - width, mean + width


FOUR_BOTH = "both perturbations and the four methods eirf, sds, birf and esm"
EITHER = "a perturbation called noise or prbs"
FIVE_BOTH, KBR_BOTH = "both perturbations and all five methods", "both perturbations and kbr"
TWO_AMOUNTS = "two numbers of realizations"
KBR = (
    "Why it should be so the paper does not say. Fitted to 20 Hz, ours predicts what inertia does "
    "as well as the other methods do, and so gains by PRBS as they do."
)
ALIKE = "The fluctuations of a virtual participant's torque are the same under either perturbation."
AMOUNTS, BOTH = [(LESS, MORE)], [NAMES[::-1]]
EIRF_FIRST = [("eirf", each) for each in FIVE[1:]]
BIRF_LAST = [(each, "birf") for each in FIVE if each != "birf"]

CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Some 255 to 260 of 300 realizations survive (within one standard deviation of the paper's "
        "mean)", "4.4", EITHER,
        [
            (Margin(mean - sd, mean + sd), "survivors", name)
            for name, (mean, sd) in SURVIVED.items()
        ],
    ),
    Claim(
        "Each step excludes as many realizations, on average, as some of the paper's participants "
        "lost", "4.1.5", EITHER,
        [
            (Margin(low - 0.5, high + 0.5), f"excluded_{step}", name)
            for name, excluded in EXCLUDED.items()
            for step, (low, high) in excluded.items()
        ],
    ),
    Claim(
        "PRBS gives 20 to 30 % more VAF than noise for all but kbr", "4.4", FOUR_BOTH,
        [(Margin(20, 30), "vaf", FOUR, BOTH, LESS)], all_of=FOUR,
    ),
    Claim(
        "PRBS gives more VAF than noise for all but kbr", "4.4", FOUR_BOTH,
        [(HIGHER, "vaf", FOUR, BOTH, LESS)], all_of=FOUR,
    ),
    Claim(
        "VAFs from 150 s lie near the paper's: 75 to 87 % with PRBS, 49 to 63 % with noise (within "
        f"{NEAR:g} points)", "4.4", f"{FOUR_BOTH}, with {PAPER_REALIZATIONS:g} realizations",
        [
            (Margin(level - NEAR, level + NEAR), quantity, name)
            for name, levels in LEVELS.items()
            for quantity, level in zip(EXTREMES, levels, strict=True)
        ],
    ),
    Claim(
        "kbr has more VAF with noise than with PRBS", "4.4", KBR_BOTH,
        [(Margin(high=0), "vaf", "kbr", BOTH, LESS)], KBR,
    ),
    Claim(
        "Between 1 and 10 Hz, PRBS gives less VAF than noise", "4.4", FIVE_BOTH,
        [(Margin(high=0), "bandpassed_vaf", FIVE, BOTH, LESS)], all_of=FIVE,
    ),
    Claim(
        "Between 1 and 10 Hz, PRBS gives about 10 % less VAF than noise (5 to 15)", "4.4",
        FIVE_BOTH, [(Margin(-15, -5), "bandpassed_vaf", FIVE, BOTH, LESS)], ALIKE, all_of=FIVE,
    ),
    Claim(
        "The random error falls with more data (in the paper from 150 s to 300 s)", "4.4",
        TWO_AMOUNTS, [(HIGHER_RATIO, "random_error", FIVE, NAMES, AMOUNTS)],
    ),
    Claim(
        "The mean stiffness stays as it is with more data (changes by less than "
        f"{MAX_CHANGE:g} %)", "4.4", TWO_AMOUNTS,
        [(Margin(high=MAX_CHANGE), "stiffness_change", FIVE, NAMES, MORE)],
    ),
    Claim(
        "The random error is largest for eirf", "4.4", "all five methods",
        [(HIGHER_RATIO, "random_error", EIRF_FIRST, NAMES, LESS)], all_of=FIVE,
    ),
    Claim(
        "The random error is smallest for birf", "4.4", "all five methods",
        [(HIGHER_RATIO, "random_error", BIRF_LAST, NAMES, LESS)], all_of=FIVE,
    ),
    Claim(
        "The random error of kbr is larger with PRBS than with noise", "4.4", KBR_BOTH,
        [(HIGHER_RATIO, "random_error", "kbr", BOTH, LESS)],
    ),
    Claim(
        f"More data do not raise the VAF, which noisy torque limits (by less than {MAX_RISE:g} "
        "point)", "4.4", TWO_AMOUNTS, [(Margin(-MAX_RISE), "vaf", FIVE, NAMES, AMOUNTS)],
    ),
    Claim(
        f"Stiffness rises with torque (correlation over time above {MIN_CORRELATION:g})", "4.4",
        "a torque that varies",
        [(Margin(MIN_CORRELATION), "correlation_with_torque", FIVE, NAMES, LESS)],
    ),
    Claim(
        "The time-varying VAF is lower at the beginning and the middle of a realization", "4.4",
        "one of eirf, sds, birf, esm", [(HIGHER, "vaf_dip", FOUR, NAMES, LESS)],
    ),
)  # fmt: skip
"""In the order of the paper."""
