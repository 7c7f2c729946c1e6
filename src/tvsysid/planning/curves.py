"""Random error and bias against the number of realizations, from simulated ensembles of some sizes."""

from __future__ import annotations

import math
import warnings
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import attrs
import numpy as np
import scipy

from tvsysid.errors import DataQualityWarning, describe_error
from tvsysid.methods.base import Method
from tvsysid.metrics import debiased_bias_error, random_error, rise_time
from tvsysid.planning.setups import Pilot, Setup, Simulated
from tvsysid.preprocess import subtract_mean
from tvsysid.signals import Array, Ensemble

LEAST, RECORDS = (
    5,
    6,
)  # realizations of the smallest ensembles; records from which ensembles are cut
# relative standard error of a random error, with which no more ensembles of that size are simulated
SURE = 0.1
NEAR = 2.5  # octaves of realizations over which a bias is averaged
POWERS = np.array([0.75, 1.0, 2.0, 4.0])  # of 1/n that variances are sums of
STEEP = (
    4.0  # times the random error of twice as many realizations: with so few, a method breaks down
)
ROUNDS = 10  # in which weights are found from what was fitted
WITHIN = 0.4  # s about a step, at most, in which an estimate rises


class Errors(NamedTuple):
    """Random error and bias error of the stiffness in N·m/rad, as of :mod:`tvsysid.metrics`."""

    random: float
    bias: float

    @property
    def total(self) -> float:
        """Root mean square of both."""
        return math.hypot(self.random, self.bias)


@attrs.frozen(eq=False)
class Curve:
    """Errors of one method in ensembles of some numbers of ``realizations``, from so many ``draws`` of each.

    All of shape (size,); sizes at which the method cannot identify, or breaks down, are left
    out. ``why`` it cannot. A pilot's realizations scatter ``excess`` times as much as simulated
    ones, which :meth:`at` counts.
    """

    realizations: Array
    random: Array
    bias: Array
    draws: Array
    why: str = ""
    excess: float = 1.0

    @cached_property
    def powers(self) -> Array:
        """Variance as a sum of powers of 1/n, none of them negative; (power,).

        Least squares of relative errors, weighted by the number of draws. Few realizations take
        high powers, where a method nears what it cannot do without; smoothers that become finer
        with more data take one below 1.
        """
        columns, variance = self.realizations[:, None] ** -POWERS, self.random**2
        fitted, found = variance, np.zeros(len(POWERS))
        for _ in range(ROUNDS):
            weight = np.sqrt(self.draws - 1) / fitted
            found = scipy.optimize.nnls(columns * weight[:, None], variance * weight)[0]
            fitted = columns @ found
        return found

    def at(self, count: float) -> Errors:
        """Errors with so many realizations; NaN for fewer than were simulated.

        The bias is a mean over sizes near; beyond the largest, bias stays and variance falls as
        it did.
        """
        if not self.realizations.size or count < self.realizations[0]:
            return Errors(math.nan, math.nan)
        away = np.log2(self.realizations / min(count, self.realizations[-1]))
        weight = (1 - np.minimum(np.abs(away) / NEAR, 1.0) ** 3) ** 3 * (self.draws - 1)
        bias = math.sqrt(float(weight @ self.bias**2 / weight.sum()))
        return Errors(self.excess * math.sqrt(float(count**-POWERS @ self.powers)), bias)

    def needed(self, error: float, most: int) -> int | None:
        """Fewest realizations, up to a number, whose total error is no larger.

        None if there are none.
        """
        if not self.realizations.size:
            return None
        counts = range(int(self.realizations[0]), most + 1)
        place = bisect_left(counts, -error, key=lambda count: -self.at(count).total)
        return counts[place] if place < len(counts) else None


def sizes(most: int) -> list[int]:
    """Numbers of realizations that are simulated: each twice the one before."""
    return [round(most / 2**step) for step in range(int(math.log2(most / LEAST)), -1, -1)]


def curves_of(
    setup: Setup,
    methods: Mapping[str, Method],
    most: int,
    draws: int,
    seed: int,
    advance: Callable[[int], object],
) -> dict[str, Curve]:
    """Curve of each method.

    ``advance`` is called with the number of ensembles that are done or not needed.
    """
    rows: dict[str, list[tuple[float, ...]]] = {label: [] for label in methods}
    why: dict[str, str] = {}
    records = [setup.simulated(most, seed + number) for number in range(RECORDS)]
    for count in sizes(most):
        parts = list(_cut(records, count, draws))
        truth = np.mean([part.stiffness for part in parts], axis=(0, 1))
        for label, method in methods.items():
            known = _answers(method, label, [part.ensemble for part in parts], why)
            advance(draws)
            if len(known) > 1 and np.isfinite(known).all(axis=0).any():
                rows[label].append(
                    (count, scatter(known), debiased_bias_error(known, truth), len(known))
                )
    return {label: _curve(each, why.get(label, "")) for label, each in rows.items()}


def excesses(
    pilot: Pilot, methods: Mapping[str, Method], draws: int, seed: int
) -> dict[str, float]:
    """How many times as much each method's stiffness differs between halves of the pilot as between simulated ones.

    The root mean square over time, of the median of random halves and of simulated pairs; 1 at
    least, since a pilot that scatters less by chance promises nothing. What differs between
    realizations, a reflex, and noise that is neither Gaussian nor stationary are in it.
    """
    recorded = pilot.recorded
    half = 0 if recorded is None else len(recorded) // 2
    if recorded is None or half < LEAST:
        return dict.fromkeys(methods, 1.0)
    own, random, found = pilot.as_recorded(), np.random.default_rng(seed), {}
    records = [
        own.simulated(half * -(-draws // RECORDS), seed + number) for number in range(RECORDS)
    ]
    parts = [each.ensemble for each in _cut(records, half, draws)]
    orders = [random.permutation(len(recorded)) for _ in parts]
    halves = [
        recorded.select(np.sort(order[at : at + half])) for order in orders for at in (0, half)
    ]
    for label, method in methods.items():
        made = _answers(method, label, parts, {}, SURE / 2)
        pairs = identified(method, label, halves[: 2 * len(made)], {}).reshape(
            -1, 2, recorded.samples
        )
        drawn = answered(pairs[:, 0] - pairs[:, 1])
        if len(made) > 1 and len(drawn):
            apart = [made[i] - made[j] for i in range(len(made)) for j in range(i)]
            found[label] = max(1.0, _typical(drawn) / _typical(np.array(apart)))
        else:
            found[label] = 1.0
    return found


def _typical(differences: Array) -> float:
    """Root mean square over time of differences (difference, time), the median of them: one may be of a breakdown."""
    return float(np.median(np.sqrt(np.nanmean(differences**2, axis=1))))


def _curve(rows: list[tuple[float, ...]], why: str) -> Curve:
    columns = np.array(rows or np.empty((0, 4))).T
    random = columns[1]
    broken = np.flatnonzero(random[:-1] > STEEP * random[1:])
    first = broken[-1] + 1 if broken.size else 0
    count, random, bias, draws = columns[:, first:]
    return Curve(count, random, bias, draws, why)


def rises(
    setup: Setup, methods: Mapping[str, Method], counts: Mapping[str, int], draws: int, seed: int,
    advance: Callable[[int], object],
) -> dict[str, float]:  # fmt: skip
    """Seconds in which each method's mean estimate rises from 10 to 90 % of a step, with so many realizations."""
    stepped = setup.stepped()
    if stepped is None:
        return dict.fromkeys(methods, math.nan)
    record, found = stepped.simulated(max(counts.values()), seed), {}
    for label, method in methods.items():
        parts = [part.ensemble for part in _cut([record], counts[label], draws)]
        values = identified(method, label, parts, {})
        advance(draws)
        low, high = float(record.stiffness.min()), float(record.stiffness.max())
        both = np.concatenate([values, low + high - np.roll(values, values.shape[1] // 2, axis=1)])
        levels = low + 0.1 * (high - low), high - 0.1 * (high - low)
        within = min(WITHIN, 0.2 * setup.period)
        known, time = answered(both), parts[0].time
        risen = (
            float(rise_time(time, known, *levels, setup.period / 4, within))
            if len(known)
            else math.nan
        )
        found[label] = float(np.maximum(risen, time[1]))  # no sooner than a sample
    return found


def _answers(
    method: Method,
    label: str,
    ensembles: Sequence[Ensemble],
    why: dict[str, str],
    sure: float = SURE,
) -> Array:
    """Stiffness (estimate, time) in as many of the ensembles as make its scatter sure.

    Without failures.
    """
    known = np.empty((0, ensembles[0].samples))
    for first in range(0, len(ensembles), RECORDS):
        more = identified(method, label, ensembles[first : first + RECORDS], why)
        known = np.concatenate([known, answered(more)])
        if uncertainty(known) < sure:
            break
    return known


def identified(
    method: Method, label: str, ensembles: Iterable[Ensemble], why: dict[str, str]
) -> Array:
    """Return the stiffness in each ensemble (ensemble, time); NaN where the method fails.

    ``why`` gets the reason.
    """
    found: list[Array] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for each in ensembles:
            try:
                values = method.identify(subtract_mean(each)).stiffness
            except Exception as error:
                why[label], values = describe_error(error), np.full(each.samples, np.nan)
            found.append(values)
    return np.array(found)


def answered(estimates: Array) -> Array:
    """Those (estimate, time) that are known at some time."""
    return estimates[np.isfinite(estimates).any(axis=1)]


def scatter(estimates: Array) -> float:
    """Random error of which these few estimates (estimate, time) are a sample; NaN for one."""
    count = len(estimates)
    return random_error(estimates) * math.sqrt(count / (count - 1)) if count > 1 else math.nan


def uncertainty(estimates: Array) -> float:
    r"""Relative standard error of the scatter of few estimates (estimate, time).

    .. math:: 1 / \sqrt{2 f \nu}, \qquad \nu = (\operatorname{tr} \Sigma)^2 / \operatorname{tr} \Sigma^2

    with f one less than the estimates and :math:`\nu` the times at which a Gaussian estimate
    scatters independently, by the unbiased estimates of both traces.
    """
    known = estimates[:, np.isfinite(estimates).all(axis=0)]
    freedom = len(known) - 1
    if freedom < 2 or not known.size:
        return math.inf
    away = known - known.mean(axis=0)
    gram = away @ away.T / freedom
    squared, square = np.trace(gram) ** 2, float(np.sum(gram**2))
    times = (squared * (1 + 1 / freedom) - 2 * square / freedom) / max(
        square - squared / freedom, 1e-12 * squared
    )
    return 1 / math.sqrt(2 * freedom * max(times, 1.0))


def _cut(records: Sequence[Simulated], count: int, draws: int) -> Iterator[Simulated]:
    """Up to so many ensembles of consecutive realizations, none in two of them.

    The first of each record first.
    """
    size = len(records[0].ensemble)
    parts = max(1, min(-(-draws // len(records)), size // count))
    for first in np.linspace(0, max(size - count, 0), parts).astype(int):
        index = np.arange(first, min(first + count, size))
        for whole in records:
            yield Simulated(whole.ensemble.select(index), whole.stiffness[index])
