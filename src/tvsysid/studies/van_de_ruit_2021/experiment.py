"""What van de Ruit et al. (2021) say their experiment shows, held against the results of one.

There is a margin for each method and rival (:mod:`tvsysid.studies.verdicts`), taken over
participants, with limits of a t distribution. The paper gives no thresholds: those here are
ours, and are part of each sentence.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
import pandas as pd
from scipy.stats import t as student

from tvsysid.figures.results import estimates, unique
from tvsysid.methods import PAPER_METHODS
from tvsysid.numerics import Array
from tvsysid.studies.verdicts import COLUMNS, RATIO, Claim, judged, log_ratio
from tvsysid.study.bootstraps import STEPS
from tvsysid.study.summary import mean_over_draws, measured

if TYPE_CHECKING:
    import xarray as xr


FOUR, FIVE = ("eirf", "sds", "birf", "esm"), PAPER_METHODS
FEWEST = 3  # participants below which nothing is decided
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


@attrs.frozen
class Paired:
    """A margin with its value for each participant, shape (participant,)."""

    words: str
    values: Array

    @property
    def estimate(self) -> float:
        """Mean over participants."""
        return float(self.values.mean()) if len(self.values) else math.nan

    def limits(self, tail: float) -> tuple[float, float]:
        """Return limits of a t distribution."""
        count = len(self.values)
        if count < FEWEST:
            return math.nan, math.nan
        width = (
            float(student.isf(tail, count - 1)) * float(self.values.std(ddof=1)) / math.sqrt(count)
        )
        return self.estimate - width, self.estimate + width


class Figures:
    """Numbers of each participant by name, perturbation, method and amount of data."""

    def __init__(self, results: xr.Dataset) -> None:
        recorded = np.where(results.recorded.values, results.recorded.values, np.nan)
        self._counts = {
            name: REPORTED * results[name].values / recorded
            for name in ("survivors", *(f"excluded_{step}" for step in STEPS))
        }
        self.participants = unique(results.participant.values)
        pairs = zip(
            map(str, results.participant.values), map(str, results.perturbation.values), strict=True
        )
        self._place = {pair: place for place, pair in enumerate(pairs)}
        self._realizations = results.realizations.values
        self._analyses: dict[str, list[int]] = {}
        for place in np.argsort(self._realizations, kind="stable"):
            self._analyses.setdefault(str(results.method_key.values[place]), []).append(int(place))
        stiffness = estimates(results).values
        self._values = measured(results) | {
            "rising": _rising(stiffness, results.mean_torque.values),
            "dip": _dips(results),
            "change": _changes(
                stiffness, [places[:2] for places in self._analyses.values() if len(places) > 1]
            ),
        }

    def has(self, *perturbations: str, methods: Sequence[str] = FIVE, amounts: int = 1) -> bool:
        """Whether there is what a claim needs."""
        recorded = any(
            all((participant, perturbation) in self._place for perturbation in perturbations)
            for participant in self.participants
        )
        return recorded and all(
            len(self._analyses.get(method, ())) >= amounts for method in methods
        )

    def drawn(self, method: str) -> int:
        """Return the smallest number of realizations."""
        return int(self._realizations[self._analyses[method][0]])

    def of(self, name: str, perturbation: str, method: str, amount: int = 0) -> Array:
        """Return a number for each participant, with less (0) or more (1) realizations."""
        return self._over_participants(
            perturbation, self._values[name][:, self._analyses[method][amount]]
        )

    def share(self, name: str, perturbation: str) -> Array:
        """Return a number of realizations for each participant, scaled to the paper's."""
        return self._over_participants(perturbation, self._counts[name])

    def _over_participants(self, perturbation: str, values: Array) -> Array:
        places = [self._place.get((participant, perturbation)) for participant in self.participants]
        return np.array([math.nan if place is None else values[place] for place in places])


Margins = Callable[[Figures], Iterator[Paired]]


def judge_experiment(results: xr.Dataset) -> pd.DataFrame:
    """Hold every claim of the paper's experiment against the results of one."""
    figures = Figures(results)
    too_few = f"Needs at least {FEWEST} participants." if len(figures.participants) < FEWEST else ""
    rows = [
        judged(claim, list(claim.margins(figures)), too_few=too_few, more="participants")
        for claim in CLAIMS
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rising(stiffness: Array, torque: Array) -> Array:
    """Return the correlation of mean stiffness and mean torque, (recording, analysis)."""
    mean = mean_over_draws(stiffness)
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
    vaf = mean_over_draws(results.time_varying_vaf.values)
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


def _paired(words: str, *margins: Array) -> Iterator[Paired]:
    yield from (Paired(words, values[np.isfinite(values)]) for values in margins)


def _within(words: str, found: Array, low: float, high: float) -> Iterator[Paired]:
    """Test that a number is in a range: a margin at each end."""
    return _paired(words, found - low, *([high - found] if math.isfinite(high) else []))


def _with_either(
    metric: str,
    words: str,
    margin: Callable[[Array, Array], Array],
    methods: Sequence[str],
    low: float = 0.0,
    high: float = math.inf,
) -> Margins:
    """Compare a metric under noise with that under PRBS.

    The words say the means of both, and the method.
    """

    def margins(figures: Figures) -> Iterator[Paired]:
        for method in methods if figures.has("noise", "prbs", methods=methods) else ():
            noise, prbs = (figures.of(metric, name, method) for name in ("noise", "prbs"))
            said = words.format(method=method, noise=_mean(noise), prbs=_mean(prbs))
            yield from _within(said, margin(noise, prbs), low, high)

    return margins


def _of_each(
    metric: str,
    words: str,
    margin: Callable[..., Array],
    methods: Sequence[str] = FIVE,
    amounts: int = 1,
) -> Margins:
    """Return a metric by perturbation and method, with one or two amounts of data.

    The words say its means.
    """

    def margins(figures: Figures) -> Iterator[Paired]:
        for perturbation in _there(figures):
            for method in methods:
                if figures.has(methods=(method,), amounts=amounts):
                    found = [
                        figures.of(metric, perturbation, method, amount)
                        for amount in range(amounts)
                    ]
                    said = words.format(*map(_mean, found))
                    yield from _paired(f"{method}, {NAMES[perturbation]}: {said}", margin(*found))

    return margins


def _there(figures: Figures) -> list[str]:
    return [name for name in ("noise", "prbs") if figures.has(name, methods=())]


def _extreme(best: str, margin: Callable[[Array, Array], Array]) -> Margins:
    """Test that a method's random error exceeds that of all others."""

    def margins(figures: Figures) -> Iterator[Paired]:
        for perturbation in _there(figures) if figures.has() else ():
            own = figures.of("random_error", perturbation, best)
            for rival in (method for method in FIVE if method != best):
                other = figures.of("random_error", perturbation, rival)
                said = f"{best} {_mean(own):.1f} N·m/rad, {rival} {_mean(other):.1f} N·m/rad"
                yield from _paired(f"{NAMES[perturbation]}: {said}", margin(own, other))

    return margins


def _near_the_levels(figures: Figures) -> Iterator[Paired]:
    for perturbation, levels in LEVELS.items():
        if not figures.has(perturbation, methods=FOUR) or {
            figures.drawn(method) for method in FOUR
        } != {FEW}:
            continue
        values = np.array([figures.of("vaf", perturbation, method) for method in FOUR])
        order = np.argsort([_mean(each) for each in values])
        for place, level, which in zip(
            (order[0], order[-1]), levels, ("lowest", "highest"), strict=True
        ):
            said = (
                f"the {which} is {_mean(values[place]):.1f} % ({FOUR[place]}), the paper's "
                f"{level:g} %"
            )
            yield from _within(
                f"{NAMES[perturbation]}: {said}", values[place], level - NEAR, level + NEAR
            )


def _survivors(figures: Figures) -> Iterator[Paired]:
    for perturbation in _there(figures):
        found, (mean, sd) = figures.share("survivors", perturbation), SURVIVED[perturbation]
        known = found[np.isfinite(found)]
        spread = f" ± {known.std(ddof=1):.0f}" if len(known) > 1 else ""
        yield from _within(
            f"{NAMES[perturbation]}: {_mean(found):.0f}{spread} of 300", found, mean - sd, mean + sd
        )


def _excluded(figures: Figures) -> Iterator[Paired]:
    for perturbation in _there(figures):
        for step, (low, high) in EXCLUDED[perturbation].items():
            found = figures.share(f"excluded_{step}", perturbation)
            words = (
                f"{NAMES[perturbation]}, {STEPS[step]}: {_mean(found):.1f}, the paper's {low} "
                f"to {high}"
            )
            yield from _within(words, found, low - 0.5, high + 0.5)


def _prbs_less_noise(noise: Array, prbs: Array) -> Array:
    return prbs - noise


ONE, FOUR_BOTH = (
    "a perturbation called noise or prbs",
    "both perturbations and the four methods eirf, sds, birf and esm",
)
KBR_BOTH, TWO_AMOUNTS = "both perturbations and kbr", "two numbers of realizations"
VAFS = "{method} {prbs:.1f} % with PRBS, {noise:.1f} % with noise"
KBR = (
    "Why it should be so the paper does not say. Fitted to 20 Hz, ours predicts what inertia does "
    "as well as the other "
    "methods do, and so gains by PRBS as they do."
)
ALIKE = "The fluctuations of a virtual participant's torque are the same under either perturbation."

CLAIMS: tuple[Claim, ...] = (
    Claim("Some 255 to 260 of 300 realizations survive (within one standard deviation of the "
          "paper's mean)", "4.4",
          _survivors, REALIZATIONS, ONE),
    Claim("Each step excludes as many realizations, on average, as some of the paper's "
          "participants lost", "4.1.5",
          _excluded, REALIZATIONS, ONE),
    Claim("PRBS gives 20 to 30 % more VAF than noise for all but kbr", "4.4",
          _with_either("vaf", VAFS, _prbs_less_noise, FOUR, 20, 30), POINTS, FOUR_BOTH),
    Claim("PRBS gives more VAF than noise for all but kbr", "4.4",
          _with_either("vaf", VAFS, _prbs_less_noise, FOUR), POINTS, FOUR_BOTH),
    Claim(f"VAFs from 150 s lie near the paper's: 75 to 87 % with PRBS, 49 to 63 % with noise "
          f"(within {NEAR:g} points)",
          "4.4", _near_the_levels, POINTS, f"{FOUR_BOTH}, with 75 realizations"),
    Claim("kbr has more VAF with noise than with PRBS", "4.4",
          _with_either("vaf", "{noise:.1f} % with noise, {prbs:.1f} % with "
                              "PRBS", np.subtract, ["kbr"]),
          POINTS, KBR_BOTH, KBR),
    Claim("Between 1 and 10 Hz, PRBS gives less VAF than noise", "4.4",
          _with_either("bandpassed_vaf", VAFS, np.subtract, FIVE), POINTS, FOUR_BOTH),
    Claim("Between 1 and 10 Hz, PRBS gives about 10 % less VAF than noise (5 to 15)", "4.4",
          _with_either("bandpassed_vaf", VAFS, np.subtract, FIVE, 5, 15), POINTS, FOUR_BOTH, ALIKE),
    Claim("The random error falls with more data (in the paper from 150 s to 300 s)", "4.4",
          _of_each("random_error", "from {:.1f} to {:.1f} "
                                   "N·m/rad", log_ratio, amounts=2), RATIO, TWO_AMOUNTS),
    Claim(f"The mean stiffness stays as it is with more data (changes by less than {MEAN_STAYS:g} "
          f"%)", "4.4",
          _of_each("change", "by {:.1f} % (RMS over "
                             "time)", lambda change, _: MEAN_STAYS - change, amounts=2),
          POINTS, TWO_AMOUNTS),
    Claim("The random error is largest for "
          "eirf", "4.4", _extreme("eirf", log_ratio), RATIO, "all five methods"),
    Claim("The random error is smallest for "
          "birf", "4.4", _extreme("birf", lambda own, other: log_ratio(other, own)),
          RATIO, "all five methods"),
    Claim("The random error of kbr is larger with PRBS than with noise", "4.4",
          _with_either("random_error", "{prbs:.1f} N·m/rad with PRBS, {noise:.1f} N·m/rad with "
                                       "noise",
                       lambda noise, prbs: log_ratio(prbs, noise), ["kbr"]),
          RATIO, KBR_BOTH),
    Claim(f"More data do not raise the VAF, which noisy torque limits (by less than {MARGINAL:g} "
          f"point)", "4.4",
          _of_each("vaf", "from {:.1f} to {:.1f} "
                          "%", lambda few, many: MARGINAL - (many - few), amounts=2),
          POINTS, TWO_AMOUNTS),
    Claim(f"Stiffness rises with torque (correlation over time above {RISES:g})", "4.4",
          _of_each("rising", "correlation "
                             "{:.2f}", lambda found: found - RISES), "correlation", "a torque that "
                                                                                    "varies"),
    Claim("The time-varying VAF is lower at the beginning and the middle of a realization", "4.4",
          _of_each("dip", "{:.1f} percentage points lower", lambda dip: dip, FOUR),
          POINTS, "one of eirf, sds, birf, esm"),
)  # fmt: skip
"""In the order of the paper."""
