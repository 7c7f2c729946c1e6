"""Claims of van de Ruit et al. (2021) about their experiment.

There is a comparison for each method and rival over participants, with limits of a t distribution.
The paper gives no thresholds: those here are ours, and part of the sentences.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import t as student

from tvsysid.figures.results import estimates, unique
from tvsysid.methods import PAPER_METHODS as FIVE
from tvsysid.numerics import Array
from tvsysid.studies.claims import (
    RATIO,
    Claim,
    Comparisons,
    Evidence,
    Rows,
    compare,
    judge_claims,
    log_ratio,
    within,
)
from tvsysid.study.bootstraps import STEPS
from tvsysid.study.summary import measured

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


FOUR = ("eirf", "sds", "birf", "esm")
MIN_PARTICIPANTS = 3  # below which nothing is decided
FEW = 75  # realizations in the paper's 150 s
POINTS, REALIZATIONS = "percentage points", "realizations"
MEAN_STAYS = 5.0  # change of the mean stiffness in per cent up to which it stays similar
MARGINAL = 1.0  # percentage points up to which a VAF rises only marginally
RISES = 0.5  # correlation over time of stiffness with torque from which on it rises with it
# part of a period about its beginning and its middle where the time-varying VAF is said to be
# reduced
DIP_WIDTH = 0.1
REPORTED = (
    300  # realizations recorded from each of the paper's participants under either perturbation
)
SURVIVED = {"noise": (260.0, 12.0), "prbs": (255.0, 14.0)}
"""Mean and standard deviation of the paper's survivors of 300 realizations (section 4.4)."""
EXCLUDED = {
    "noise": {"alignment": (0, 3), "task": (4, 12), "residual": (17, 29)},
    "prbs": {"alignment": (5, 40), "task": (3, 10), "residual": (15, 20)},
}
"""Range over the paper's participants of what each step excluded (section 4.1.5)."""
COUNTS = {
    perturbation: (
        f"{REPORTED}",
        *(f"{low} to {high}" for low, high in excluded.values()),
        "{:g} ± {:g}".format(*SURVIVED[perturbation]),
    )
    for perturbation, excluded in EXCLUDED.items()
}
"""Realizations recorded, excluded by each step, and kept, by perturbation, in the paper."""
LEVELS = {"prbs": (74.8, 87.2), "noise": (49.4, 62.7)}
"""Lowest and highest mean VAF of the four methods in the paper, from 150 s (section 4.4)."""
NEAR = 5.0  # percentage points within which a VAF is near the paper's
NAMES = {"noise": "noise", "prbs": "PRBS"}


class Participants(Evidence):
    """Numbers of each participant, from the results of an experiment.

    A place is a name, a perturbation and, of an analysis, a method and whether it has less (0) or
    more (1) realizations.
    """

    more = "participants"

    def __init__(self, results: xr.Dataset) -> None:
        recorded = np.where(results.recorded.values, results.recorded.values, np.nan)
        self._counts = {
            name: REPORTED * results[name].values / recorded
            for name in ("survivors", *(f"excluded_{step}" for step in STEPS))
        }
        people, perturbations = results.participant.values, results.perturbation.values
        self.participants = unique(people)
        pairs = zip(map(str, people), map(str, perturbations), strict=True)
        self._place = {pair: place for place, pair in enumerate(pairs)}
        self._realizations = results.realizations.values
        self._analyses: dict[str, list[int]] = {}
        for place in np.argsort(self._realizations, kind="stable"):
            self._analyses.setdefault(str(results.method_key.values[place]), []).append(int(place))
        stiffness = estimates(results).values
        several = [places[:2] for places in self._analyses.values() if len(places) > 1]
        own = measured(results).sel(quantity="stiffness")
        self._values = {str(name): each.values for name, each in own.items()} | {
            "rising": _rising(stiffness, results.mean_torque.values),
            "dip": _dips(results),
            "change": _changes(stiffness, several),
        }
        if len(self.participants) < MIN_PARTICIPANTS:
            self.too_few = f"Needs at least {MIN_PARTICIPANTS} participants."

    def has(self, *perturbations: str, methods: Sequence[str] = (), amounts: int = 1) -> bool:
        """Return whether a participant has all perturbations, and there are all analyses."""
        recorded = any(
            all((participant, each) in self._place for each in perturbations)
            for participant in self.participants
        )
        counts = [len(self._analyses.get(method, ())) for method in methods]
        return recorded and all(count >= amounts for count in counts)

    def drawn(self, method: str) -> int:
        """Return the smallest number of realizations."""
        return int(self._realizations[self._analyses[method][0]])

    def of(self, name: str, perturbation: str, method: str = "", amount: int = 0) -> Array:
        """Return a number for each participant. Counts are scaled to realizations of the paper."""
        values = (
            self._values[name][:, self._analyses[method][amount]] if method else self._counts[name]
        )
        places = [self._place.get((participant, perturbation)) for participant in self.participants]
        return np.array([math.nan if place is None else values[place] for place in places])

    def estimate(self, values: Array) -> Any:
        """Return the mean over participants."""
        return _mean(values)

    def limits(self, values: Array, tail: float) -> tuple[float, float]:
        """Return limits of a t distribution."""
        known = values[np.isfinite(values)]
        count = len(known)
        if count < MIN_PARTICIPANTS:
            return math.nan, math.nan
        width = float(student.isf(tail, count - 1) * known.std(ddof=1)) / math.sqrt(count)
        return float(known.mean()) - width, float(known.mean()) + width


def judge_experiment(results: xr.Dataset) -> pd.DataFrame:
    """Hold every claim of the paper's experiment against the results of one."""
    return judge_claims(CLAIMS, Participants(results))


def _rising(stiffness: Array, torque: Array) -> Array:
    """Return the correlation of mean stiffness and mean torque, (recording, analysis)."""
    mean = _mean(stiffness, axis=2)
    found = np.full(mean.shape[:2], np.nan)
    for recording, analysis in np.ndindex(*found.shape):
        pair = np.stack([mean[recording, analysis], torque[recording]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        if pair.size and (np.ptp(pair, axis=1) > 0).all():
            found[recording, analysis] = np.asarray(np.corrcoef(pair))[0, 1]
    return found


def _dips(results: xr.Dataset) -> Array:
    """Return the VAF at a period's quarters less that at ends and middle, (recording, analysis)."""
    phase = results.time.values / (
        results.time.values[-1] + results.time.values[1] - results.time.values[0]
    )
    from_turn = np.abs((2 * phase + 0.5) % 1 - 0.5) / 2
    vaf = _mean(results.time_varying_vaf.values, axis=2)
    at, away = from_turn < DIP_WIDTH / 2, from_turn > 0.25 - DIP_WIDTH / 2
    return np.asarray(_mean(vaf[..., away], axis=-1) - _mean(vaf[..., at], axis=-1))


def _changes(stiffness: Array, pairs: Sequence[Sequence[int]]) -> Array:
    """Return the RMS change of stiffness from less to more data in per cent, (recording, analysis).

    A mean over few bootstraps is off by chance; what that adds is taken off.
    """
    found = np.full(stiffness.shape[:2], np.nan)
    for recording, (few, many) in (
        (recording, pair) for recording in range(len(stiffness)) for pair in pairs
    ):
        one, other = (
            values[np.isfinite(values).any(axis=1)] for values in stiffness[recording, [few, many]]
        )
        if min(len(one), len(other)) < 2:  # draws that did not fail
            continue
        chance = one.var(axis=0, ddof=1) / len(one) + other.var(axis=0, ddof=1) / len(other)
        square = float(_mean((other.mean(axis=0) - one.mean(axis=0)) ** 2 - chance))
        found[recording, few] = 100 * math.sqrt(max(square, 0.0)) / float(np.nanmean(one))
    return found


def _mean(values: Array, axis: int | None = None) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where none is known
        return np.nanmean(values, axis=axis)


def _with_either(
    metric: str,
    words: str,
    margin: Callable[[Array, Array], Array],
    methods: Sequence[str],
    low: float = 0.0,
    high: float = math.inf,
) -> Comparisons:
    """Compare a metric under noise (0) with that under PRBS (1)."""

    def rows(people: Participants) -> Rows:
        for method in methods if people.has("noise", "prbs", methods=methods) else ():
            places = ((metric, name, method) for name in NAMES)
            yield words.replace("{method}", method), *places

    return compare(rows, lambda noise, prbs: within(low, high)(margin(noise, prbs)))


def _of_each(
    metric: str,
    words: str,
    margin: Callable[..., Array],
    methods: Sequence[str] = FIVE,
    amounts: int = 1,
) -> Comparisons:
    """Compare a metric of each perturbation and method between one or two amounts of data."""

    def rows(people: Participants) -> Rows:
        for name, method in product(_recorded(people), methods):
            if people.has(methods=(method,), amounts=amounts):
                places = ((metric, name, method, amount) for amount in range(amounts))
                yield f"{method}, {NAMES[name]}: {words}", *places

    return compare(rows, margin)


def _recorded(people: Participants) -> list[str]:
    return [name for name in NAMES if people.has(name)]


def _extreme(best: str, margin: Callable[[Array, Array], Array]) -> Comparisons:
    """Compare the random error of a method with those of all others."""

    def rows(people: Participants) -> Rows:
        others = [method for method in FIVE if method != best]
        names = _recorded(people) if people.has(methods=FIVE) else ()
        for name, rival in product(names, others):
            words = f"{NAMES[name]}: {best} {{0:.1f}} N·m/rad, {rival} {{1:.1f}} N·m/rad"
            yield words, *(("random_error", name, method) for method in (best, rival))

    return compare(rows, margin)


def _near_the_levels(people: Participants) -> Any:
    """Compare the lowest and the highest VAF of four methods with those of the paper."""
    for name, levels in LEVELS.items():
        if not people.has(name, methods=FOUR) or {people.drawn(each) for each in FOUR} != {FEW}:
            continue
        order = np.argsort([_mean(people.of("vaf", name, method)) for method in FOUR])
        for place, level, which in zip(order[[0, -1]], levels, ("lowest", "highest"), strict=True):
            words = f"the {which} is {{:.1f}} % ({FOUR[place]}), the paper's {level:g} %"
            row = (f"{NAMES[name]}: {words}", ("vaf", name, FOUR[place]))
            yield from compare([row], within(level - NEAR, level + NEAR))(people)


def _survivors(people: Participants) -> Any:
    """Compare the number of realizations that are kept with that of the paper."""
    for name in _recorded(people):
        counts, (mean, sd) = people.of("survivors", name), SURVIVED[name]
        known = counts[np.isfinite(counts)]
        spread = f" ± {known.std(ddof=1):.0f}" if len(known) > 1 else ""
        row = (f"{NAMES[name]}: {{:.0f}}{spread} of 300", ("survivors", name))
        yield from compare([row], within(mean - sd, mean + sd))(people)


def _excluded(people: Participants) -> Any:
    """Compare the numbers of excluded realizations with the ranges of the paper."""
    for name in _recorded(people):
        for step, (low, high) in EXCLUDED[name].items():
            words = f"{NAMES[name]}, {STEPS[step]}: {{:.1f}}, the paper's {low} to {high}"
            row = (words, (f"excluded_{step}", name))
            yield from compare([row], within(low - 0.5, high + 0.5))(people)


def _prbs_less_noise(noise: Array, prbs: Array) -> Array:
    return prbs - noise


ONE, FOUR_BOTH = (
    "a perturbation called noise or prbs",
    "both perturbations and the four methods eirf, sds, birf and esm",
)
KBR_BOTH, TWO_AMOUNTS = "both perturbations and kbr", "two numbers of realizations"
VAFS = "{method} {1:.1f} % with PRBS, {0:.1f} % with noise"
KBR = (
    "Why it should be so the paper does not say. Fitted to 20 Hz, ours predicts what inertia does "
    "as well as the other methods do, and so gains by PRBS as they do."
)
ALIKE = "The fluctuations of a virtual participant's torque are the same under either perturbation."

TORQUE = "a torque that varies"
MORE_DATA = "in the paper from 150 s to 300 s"

CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Some 255 to 260 of 300 realizations survive (within one standard deviation of the paper's "
        "mean)", "4.4", _survivors, REALIZATIONS, ONE,
    ),
    Claim(
        "Each step excludes as many realizations, on average, as some of the paper's participants "
        "lost", "4.1.5", _excluded, REALIZATIONS, ONE,
    ),
    Claim(
        "PRBS gives 20 to 30 % more VAF than noise for all but kbr", "4.4",
        _with_either("vaf", VAFS, _prbs_less_noise, FOUR, 20, 30), POINTS, FOUR_BOTH,
    ),
    Claim(
        "PRBS gives more VAF than noise for all but kbr", "4.4",
        _with_either("vaf", VAFS, _prbs_less_noise, FOUR), POINTS, FOUR_BOTH,
    ),
    Claim(
        "VAFs from 150 s lie near the paper's: 75 to 87 % with PRBS, 49 to 63 % with noise (within "
        f"{NEAR:g} points)", "4.4", _near_the_levels, POINTS,
        f"{FOUR_BOTH}, with 75 realizations",
    ),
    Claim(
        "kbr has more VAF with noise than with PRBS", "4.4",
        _with_either("vaf", "{0:.1f} % with noise, {1:.1f} % with PRBS", np.subtract, ["kbr"]),
        POINTS, KBR_BOTH, KBR,
    ),
    Claim(
        "Between 1 and 10 Hz, PRBS gives less VAF than noise", "4.4",
        _with_either("bandpassed_vaf", VAFS, np.subtract, FIVE), POINTS, FOUR_BOTH,
    ),
    Claim(
        "Between 1 and 10 Hz, PRBS gives about 10 % less VAF than noise (5 to 15)", "4.4",
        _with_either("bandpassed_vaf", VAFS, np.subtract, FIVE, 5, 15), POINTS, FOUR_BOTH, ALIKE,
    ),
    Claim(
        f"The random error falls with more data ({MORE_DATA})", "4.4",
        _of_each("random_error", "from {:.1f} to {:.1f} N·m/rad", log_ratio, amounts=2),
        RATIO, TWO_AMOUNTS,
    ),
    Claim(
        f"The mean stiffness stays as it is with more data (changes by less than {MEAN_STAYS:g} "
        "%)", "4.4",
        _of_each(
            "change", "by {:.1f} % (RMS over time)", lambda few, _: MEAN_STAYS - few, amounts=2
        ),
        POINTS, TWO_AMOUNTS,
    ),
    Claim(
        "The random error is largest for eirf", "4.4",
        _extreme("eirf", log_ratio), RATIO, "all five methods",
    ),
    Claim(
        "The random error is smallest for birf", "4.4",
        _extreme("birf", lambda own, other: log_ratio(other, own)), RATIO, "all five methods",
    ),
    Claim(
        "The random error of kbr is larger with PRBS than with noise", "4.4",
        _with_either(
            "random_error", "{1:.1f} N·m/rad with PRBS, {0:.1f} N·m/rad with noise",
            lambda noise, prbs: log_ratio(prbs, noise), ["kbr"],
        ),
        RATIO, KBR_BOTH,
    ),
    Claim(
        f"More data do not raise the VAF, which noisy torque limits (by less than {MARGINAL:g} "
        "point)", "4.4",
        _of_each(
            "vaf", "from {:.1f} to {:.1f} %", lambda few, many: MARGINAL - (many - few), amounts=2
        ),
        POINTS, TWO_AMOUNTS,
    ),
    Claim(
        f"Stiffness rises with torque (correlation over time above {RISES:g})", "4.4",
        _of_each("rising", "correlation {:.2f}", lambda found: found - RISES),
        "correlation", TORQUE,
    ),
    Claim(
        "The time-varying VAF is lower at the beginning and the middle of a realization", "4.4",
        _of_each("dip", "{:.1f} percentage points lower", lambda dip: dip, FOUR),
        POINTS, "one of eirf, sds, birf, esm",
    ),
)  # fmt: skip
"""In the order of the paper."""
