"""Published claims as rows of a table, and one function that judges a row.

A row has margins, numbers that must be positive for the claim to be true. The claim holds if the
lower 95 % limit of every margin is above zero: to establish that all are positive, each may be
tested by itself. It does not hold if one margin is below zero with 95 % confidence for all of them
jointly (Bonferroni). It is undecided otherwise.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.numerics import Array
from tvsysid.study.scenarios import PERIOD, RATE, Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

COLUMNS = ("claim", "source", "finding", "estimate", "low", "high", "unit", "verdict", "remark")
MIN_TRIALS = 10  # below which limits from resampled trials are too narrow
TAIL = 0.025  # probability beyond either 95 % limit
Key = tuple[str, ...]
"""Name of a quantity, and what it belongs to: a method, and a scenario or a kind of recording."""


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
    """

    values: Mapping[Key, Array]
    units: Mapping[str, str]
    interval: Callable[[Array, float], tuple[float, float, float]]

    def describe(self, key: Key) -> str:
        """Return a number with its unit and what it belongs to, in words."""
        quantity, *owner = key
        value = self.interval(self.values[key], TAIL)[0]
        words = quantity.replace("_", " ")
        return f"{words} {value:.3g} {self.units[quantity]} ({', '.join(owner)})"


def difference(*numbers: Array) -> Array:
    """Return a number, the difference of two, or that of the differences of two pairs."""
    return np.array([1.0, -1.0, -1.0, 1.0])[: len(numbers)] @ np.array(numbers)


def log_ratio(*numbers: Array) -> Array:
    """Return the logarithm of the ratio of the sizes of two numbers, or of those of two pairs."""
    return difference(*np.log(np.abs(numbers)))


@attrs.frozen
class Margin:
    """Distances of a comparison from its bounds; positive within them.

    Parameters
    ----------
    low, high
        Bounds.
    of
        Function that compares numbers.
    unit
        ``"ratio"`` if ``of`` returns the logarithm of one. Empty for the unit of the numbers.
    """

    low: float = -np.inf
    high: float = np.inf
    of: Callable[..., Array] = difference
    unit: str = ""

    def __call__(self, *numbers: Array) -> list[Array]:
        """Return the samples of the margin to each finite bound."""
        value, bounds = self.of(*numbers), np.array([self.low, self.high])
        low, high = np.log(bounds) if self.unit == "ratio" else bounds
        margins = {low: value - low, high: high - value}
        return [margin for bound, margin in margins.items() if np.isfinite(bound)]


ratio = partial(Margin, of=log_ratio, unit="ratio")
"""Margin of a ratio."""
HIGHER, HIGHER_RATIO = Margin(0), ratio(1)
"""Margins by which the first of two numbers is higher: their difference, and their ratio."""


@attrs.frozen
class Claim:
    """A published sentence, and the comparisons that decide on it.

    Parameters
    ----------
    sentence, source
        The claim, and the paper or section that has it.
    comparisons
        Each is a margin, and the parts of keys that it is of: quantities, methods, cases. All
        combinations are compared, but for those of cases that the evidence lacks. A tuple in place
        of a name holds the sides of one comparison.
    disagreement
        Why the claim may fail, where that is known.
    most
        Whether the median over comparisons decides: whether more than half hold.
    """

    sentence: str
    source: str
    comparisons: Sequence[tuple[Any, ...]]
    disagreement: str = ""
    most: bool = False

    def margins(self, evidence: Evidence) -> list[tuple[Array, str, str]]:
        """Return samples and unit of each margin, and its numbers in words.

        There are none if the evidence lacks one of the methods.
        """
        compared, methods, known = [], set(), evidence.values
        for margin, *axes in self.comparisons:
            for place in product(*map(np.atleast_1d, axes)):
                keys = list(product(*map(np.atleast_1d, place)))
                methods |= {key[1] for key in keys}
                if known.keys() >= {*keys}:
                    unit = margin.unit or evidence.units[keys[0][0]]
                    words = "; ".join(map(evidence.describe, keys))
                    compared.append((margin(*map(known.get, keys)), unit, words))
        if not compared or not methods <= {key[1] for key in known}:
            return []
        if self.most:
            smallest = [np.min(margins, axis=0) for margins, *_ in compared]
            return [(np.median(smallest, axis=0), unit, "median over comparisons")]
        return [(each, unit, words) for margins, unit, words in compared for each in margins]


def labels(**settings: Any) -> list[str]:
    """Return the labels of the scenarios that a study with these settings has."""
    return [each.label for each in Study(methods=(), **settings).scenarios]


def claim(sentence: str, source: str, *comparison: Any, **settings: Any) -> Claim:
    """Return the claim that is decided by combinations of one kind."""
    return Claim(sentence, source, [comparison], **settings)


def ranked(order: str) -> list[tuple[str, str]]:
    """Return pairs of methods in an order such as ``"eirf > sds kbr > birf"``."""
    groups = [group.split() for group in order.split(" > ")]
    return [pair for high, low in pairwise(groups) for pair in product(high, low)]


def judge_claims(claims: Iterable[Claim], evidence: Evidence) -> pd.DataFrame:
    """Return a row of ``COLUMNS`` for each claim."""
    import pandas as pd  # noqa: PLC0415  # heavy

    # Resampled trials may have no spread, and no logarithm
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = [(row.sentence, row.source, *judged(row, evidence)) for row in claims]
    return pd.DataFrame(rows, columns=COLUMNS)


def judged(row: Claim, evidence: Evidence) -> tuple[object, ...]:
    """Return the columns from the finding on; without comparisons a claim was not studied.

    The finding begins with how many comparisons agree with the verdict.
    """
    margins = row.margins(evidence)
    if not margins:
        return "", np.nan, np.nan, np.nan, "", "not studied", ""
    limits, joint = (
        np.array([evidence.interval(samples, tail) for samples, *_ in margins])
        for tail in (TAIL, TAIL / len(margins))
    )
    holds, fails = limits[:, 1] > 0, joint[:, 2] < 0
    verdict, agree, order = "undecided", ~holds, limits[:, 0]
    if fails.any():
        verdict, agree = "does not hold", fails
    elif holds.all():
        verdict, agree, order = "holds", holds, limits[:, 1]
    place = int(np.argmin(np.where(agree, order, np.inf)))  # one without results, if any
    _, unit, words = margins[place]
    return (
        f"{np.sum(agree)} of {len(margins)}: {words}",
        *(np.exp(limits[place]) if unit == "ratio" else limits[place]),
        unit.replace("%", "percentage points"),
        verdict,
        "" if verdict == "holds" else row.disagreement,
    )


def simulation_evidence(scores: xr.Dataset) -> Evidence:
    """Return the scores of a simulation study by metric, method and label of the scenario.

    Samples are the metric, followed by its replicates. A metric without replicates, such as that of
    the worst trial, is its own limits. There are no scores of a study with another sampling rate or
    duration of a realization than those of the papers.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    study = json.loads(scores.attrs["study"])
    is_papers = (study["rate"], study["period"]) == (RATE, PERIOD)
    replicates = scores.replicates.fillna(scores.value).where(scores.trials.max() >= MIN_TRIALS)
    samples = xr.concat([scores.value, replicates], "replicate")
    samples = samples.stack(key=("metric", "method_key", "scenario")).transpose("key", "replicate")
    samples = samples[samples.asked.values & is_papers]
    values = dict(zip(samples.key.values, samples.values, strict=True))
    return Evidence(values, scores.unit.to_series(), replicate_interval)


def replicate_interval(samples: Array, tail: float) -> tuple[float, float, float]:
    """Return a value and percentiles of the replicates that follow it; NaN if one of them is."""
    low, high = np.quantile(samples[1:], [tail, 1 - tail], method="nearest")
    return samples[0], low, high
