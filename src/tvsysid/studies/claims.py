"""Published claims as rows of a table, and one function that judges a row.

A claim is a set of margins, numbers that must be positive for it to be true. It holds if the lower
95 % limit of every margin is above zero: to establish that all are positive, each may be tested by
itself. It does not hold if one margin is below zero with 95 % confidence for all of them jointly
(Bonferroni). It is undecided otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.numerics import Array
from tvsysid.study.scenarios import Scenario
from tvsysid.study.trials import TRAITS

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

COLUMNS = ("claim", "source", "finding", "estimate", "low", "high", "unit", "verdict", "remark")
HOLDS, FAILS, UNDECIDED, NOT_STUDIED = "holds", "does not hold", "undecided", "not studied"
FINDINGS = {
    FAILS: "{0} of {1} comparisons against it; the clearest: ",
    UNDECIDED: "{0} of {1} comparisons open; the most so: ",
    HOLDS: "all {1} comparisons speak for it; the closest: ",
}
"""Beginning of the finding, by verdict; the first verdict that any comparison has counts."""
RATIO = "ratio"  # unit of margins that are logarithms
MIN_TRIALS = 10  # below which limits from resampled trials are too narrow
TAIL = 0.025  # probability beyond either 95 % limit
SIGNS = np.array([1.0, -1.0, -1.0, 1.0])
HOW_DECIDED = (
    "Estimate and limits (95 %) are those of the comparison that decides: a difference above 0 or "
    "a ratio above 1 speaks for the claim. For “does not hold” the confidence is 95 % for all "
    "comparisons together."
)

Key = tuple[str, ...]
"""Name of a quantity, and what it belongs to: a method, a scenario."""


@attrs.frozen(eq=False)
class Evidence:
    """Numbers that claims are compared with.

    Parameters
    ----------
    values
        Samples of each number.
    units
        Unit of each quantity.
    interval
        Return estimate, lower and upper limit of samples. Each limit is exceeded with this
        probability.
    scenarios
        Scenarios of a simulation study, by label.
    more
        What to have more of where a claim is undecided.
    too_few
        Why nothing can be decided, if so.
    """

    values: Mapping[Key, Array]
    units: Mapping[str, str]
    interval: Callable[[Array, float], tuple[float, float, float]]
    scenarios: Mapping[str, Scenario] = MappingProxyType({})
    more: str = "trials"
    too_few: str = ""

    def describe(self, key: Key) -> str:
        """Return a number with its unit and what it belongs to, in words."""
        quantity, *owner = key
        value = f"{self.interval(self.values[key], TAIL)[0]:.3g} {self.units.get(quantity, '')}"
        return f"{quantity.replace('_', ' ')} {value.strip()} ({', '.join(owner)})"


@attrs.frozen
class Margin:
    """Distances of a comparison from its bounds; positive within them.

    Parameters
    ----------
    low, high
        Bounds of a number, of the difference of two, or of the difference of two differences.
    is_ratio
        Whether they are compared by the logarithm of their ratio, not by their difference.
    of
        Function of the numbers that replaces these; it returns a logarithm if it is a ratio.
    """

    low: float = -np.inf
    high: float = np.inf
    is_ratio: bool = False
    of: Callable[..., Array] | None = None

    def __call__(self, *samples: Array) -> list[Array]:
        """Return the samples of the margin to each finite bound."""
        terms = np.log(np.abs(samples)) if self.is_ratio else np.asarray(samples)
        value = self.of(*samples) if self.of else SIGNS[: len(terms)] @ terms
        low, high = np.log([self.low, self.high]) if self.is_ratio else (self.low, self.high)
        margins = ((low, value - low), (high, high - value))
        return [margin for bound, margin in margins if np.isfinite(bound)]


def ratio(low: float = 0.0, high: float = np.inf, **words: Any) -> Margin:
    """Return the margin of a ratio."""
    return Margin(low, high, is_ratio=True, **words)


HIGHER, HIGHER_RATIO = Margin(0), ratio(1)
"""Margins by which the first of two numbers is higher: their difference, and their ratio."""


@attrs.frozen
class Claim:
    """A published sentence, and the comparisons that decide on it.

    Parameters
    ----------
    sentence, source
        The claim, and the paper or section that has it.
    needs
        What a study needs to test the claim.
    comparisons
        Each is a margin and what it is of: quantities, methods, scenarios. All combinations are
        compared. A tuple in place of a name holds the sides of one comparison. What depends on the
        study is a function of the evidence. Combinations that the evidence lacks do not count.
    disagreement
        Why the claim may fail, where that is known.
    most
        Whether more than half of the comparisons suffice.
    all_of
        Methods without which it is not studied.
    """

    sentence: str
    source: str
    needs: str
    comparisons: Sequence[tuple[Any, ...]]
    disagreement: str = ""
    most: bool = False
    all_of: Sequence[str] = ()

    def margins(self, evidence: Evidence) -> list[tuple[Array, str, str]]:
        """Return samples and unit of each margin, and its numbers in words."""
        compared = []
        is_studied = {key[1] for key in evidence.values} >= set(self.all_of)
        for margin, *axes in self.comparisons if is_studied else ():
            parts = [axis(evidence) if callable(axis) else axis for axis in axes]
            for place in product(*map(_several, parts)):
                keys = list(product(*map(_several, place)))
                if evidence.values.keys() >= {*keys} and len({*keys}) == len(keys):
                    unit = RATIO if margin.is_ratio else evidence.units[keys[0][0]]
                    words = "; ".join(map(evidence.describe, keys))
                    margins = margin(*(evidence.values[key] for key in keys))
                    compared.append((margins, unit, words))
        if not self.most or not compared:
            return [(each, unit, words) for margins, unit, words in compared for each in margins]
        smallest = np.array([np.min(margins, axis=0) for margins, *_ in compared])
        share = np.where(np.isnan(smallest), np.nan, smallest > 0).mean(axis=0)
        words = f"{np.count_nonzero(smallest[:, 0] > 0)} of {len(smallest)} conditions"
        return [(share - 0.5, "share of conditions beyond half", words)]


def _several(axis: Any) -> Any:
    """Return an axis of one name as a list."""
    return [axis] if isinstance(axis, str) else axis


def judge_claims(claims: Iterable[Claim], evidence: Evidence) -> pd.DataFrame:
    """Return a row of ``COLUMNS`` for each claim."""
    import pandas as pd  # noqa: PLC0415  # heavy

    # Resampled trials may have no spread, and no logarithm
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = [judge_claim(claim, evidence) for claim in claims]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def judge_claim(claim: Claim, evidence: Evidence) -> tuple[object, ...]:
    """Return the row of ``COLUMNS`` for a claim; without comparisons it was not studied."""
    margins = claim.margins(evidence)
    if evidence.too_few or not margins:
        blank = (UNDECIDED, evidence.too_few) if margins else (NOT_STUDIED, f"Needs {claim.needs}.")
        return (claim.sentence, claim.source, "", *[np.nan] * 3, "", *blank)
    limits = np.array([evidence.interval(samples, TAIL) for samples, *_ in margins])
    known = np.isfinite(limits[:, 0])
    joint = TAIL / max(1, int(known.sum()))
    fails = known & np.array([evidence.interval(each, joint)[2] < 0 for each, *_ in margins])
    holds = known & (limits[:, 1] > 0)
    chosen = {FAILS: fails, UNDECIDED: ~holds & ~fails, HOLDS: holds}
    verdict = next(each for each in FINDINGS if chosen[each].any())
    order = limits[:, 1 if verdict == HOLDS else 0]
    place = int(np.argmin(np.where(chosen[verdict], order, np.inf)))  # one without results, if any
    _, unit, words = margins[place]
    count = FINDINGS[verdict].format(np.count_nonzero(chosen[verdict]), len(margins))
    remark = "" if verdict == HOLDS else claim.disagreement
    if verdict == UNDECIDED:
        why = f"More {evidence.more} may decide." if known[place] else "A method gave no results."
        remark = f"{why} {remark}".strip()
    return (
        claim.sentence,
        claim.source,
        f"{count if len(margins) > 1 else ''}{words}",
        *(np.exp(limits[place]) if unit == RATIO else limits[place]).tolist(),
        unit.replace("%", "percentage points"),
        verdict,
        remark,
    )


def simulation_evidence(scores: xr.Dataset) -> Evidence:
    """Return the scores of a simulation study by metric, method and label of the scenario.

    Samples are the metric, followed by its replicates.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    samples = xr.concat([scores.value, scores.replicates], "draw")
    samples = samples.stack(key=("metric", "method_key", "scenario")).transpose("key", "draw")
    samples = samples[samples.asked.values]
    columns = (scores[name].values.tolist() for name in ("scenario", *TRAITS))
    is_small = int(scores.trials.max()) < MIN_TRIALS
    return Evidence(
        dict(zip(samples.key.values, samples.values, strict=True)),
        scores.unit.to_series().to_dict(),
        replicate_interval,
        {label: Scenario(*settings) for label, *settings in zip(*columns, strict=True)},
        too_few=f"Needs at least {MIN_TRIALS} trials." if is_small else "",
    )


def replicate_interval(samples: Array, tail: float) -> tuple[float, float, float]:
    """Return a value and percentiles of the replicates that follow it.

    A value without replicates, such as that of the worst trial, is its own limits.
    """
    replicates = samples[1:][~np.isnan(samples[1:])]
    known = replicates if len(replicates) else samples[:1]
    low, high = np.quantile(known, [tail, 1 - tail], method="nearest")
    return samples[0], low, high
