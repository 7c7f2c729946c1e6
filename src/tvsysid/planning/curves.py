"""Measure how error depends on the number of realizations, in simulated ensembles."""

from __future__ import annotations

import math
import warnings
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import attrs
import numpy as np
import scipy

from tvsysid.errors import DataQualityWarning, describe_error
from tvsysid.methods import Method
from tvsysid.metrics import debiased_bias_error, random_error, rise_time
from tvsysid.planning.setups import Pilot, Setup, Simulated
from tvsysid.preprocess import subtract_mean
from tvsysid.signals import Array, Ensemble

MIN_REALIZATIONS = 5  # of the smallest ensembles
RECORDS = 6  # simulated recordings from which ensembles are cut
MAX_DURATION_S = 2400.0  # of the largest ensemble that is simulated
# Relative standard error of a random error below which no more ensembles are identified.
MAX_UNCERTAINTY = 0.1
BIAS_OCTAVES = 2.5  # of realizations over which a bias is averaged
POWERS = np.array([0.75, 1.0, 2.0, 4.0])  # of 1/n, whose sum is the variance
# Random error over that of twice as many realizations from which on a method breaks down.
BREAKDOWN_RATIO = 4.0
ROUNDS = 10  # of reweighted least squares
MAX_RISE_S = 0.4  # on either side of a step


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
    """Errors of one method against the number of realizations.

    Parameters
    ----------
    realizations
        Numbers of realizations, shape (size,). Sizes at which the method fails or breaks down are
        left out.
    random, bias
        Random error and bias in N·m/rad, shape (size,).
    draws
        Number of ensembles of each size, shape (size,).
    why
        Why the method fails, if it does.
    excess
        Random error in a pilot over that in simulated realizations. :meth:`at` multiplies by it.
    """

    realizations: Array
    random: Array
    bias: Array
    draws: Array
    why: str = ""
    excess: float = 1.0

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]], why: str = "") -> Curve:
        """Return the curve of rows (realizations, random, bias, draws).

        It begins where the method does not break down.
        """
        table = np.reshape(rows, (-1, 4)).T
        broken = np.flatnonzero(table[1, :-1] > BREAKDOWN_RATIO * table[1, 1:])
        realizations, errors, bias, draws = table[:, max(broken, default=-1) + 1 :]
        return cls(realizations, errors, bias, draws, why)

    @cached_property
    def powers(self) -> Array:
        """Variance as a sum of powers of 1/n, none of them negative, shape (power,).

        The fit minimises relative errors, weighted by the number of draws. Few realizations take
        high powers, where a method nears the fewest that it needs. Smoothers that become finer
        with more data take a power below 1.
        """
        columns, variance = self.realizations[:, None] ** -POWERS, self.random**2
        fitted, found = variance, np.zeros(len(POWERS))
        for _ in range(ROUNDS):
            weight = np.sqrt(self.draws - 1) / fitted
            found = scipy.optimize.nnls(columns * weight[:, None], variance * weight)[0]
            fitted = columns @ found
        return found

    def at(self, count: float) -> Errors:
        """Return the errors with this number of realizations. NaN for fewer than were simulated.

        The bias is a mean over nearby sizes. Beyond the largest size, the bias stays and the
        variance goes on falling.
        """
        if not self.realizations.size or count < self.realizations[0]:
            return Errors(math.nan, math.nan)
        octaves = np.log2(self.realizations / min(count, self.realizations[-1]))
        weight = (1 - np.minimum(np.abs(octaves) / BIAS_OCTAVES, 1.0) ** 3) ** 3 * (self.draws - 1)
        bias = math.sqrt(float(weight @ self.bias**2 / weight.sum()))
        return Errors(self.excess * math.sqrt(float(count**-POWERS @ self.powers)), bias)

    def needed(self, error: float, most: int) -> int | None:
        """Return the fewest realizations up to ``most`` with a total error this small, or None."""
        counts = range(int(min(self.realizations, default=most + 1)), most + 1)
        place = bisect_left(counts, -error, key=lambda count: -self.at(count).total)
        return counts[place] if place < len(counts) else None


def sizes_of(setup: Setup) -> list[int]:
    """Return numbers of realizations to simulate, each twice the one before."""
    most = min(setup.most_simulated, int(MAX_DURATION_S / setup.period))
    octaves = max(1, int(math.log2(most / MIN_REALIZATIONS)))
    return [round(most / 2**octave) for octave in range(octaves, -1, -1)]


def measure_curve(
    method: Method,
    records: Sequence[Simulated],
    sizes: Iterable[int],
    draws: int,
    advance: Callable[[], None],
) -> Curve:
    """Return the curve of a method from ensembles of these sizes, cut from simulated records.

    ``advance`` is called after each size.
    """
    rows, why = [], ""
    for count in sizes:
        parts = list(cut(records, count, draws))
        values, reason = identify_each(method, [each.ensemble for each in parts], MAX_UNCERTAINTY)
        known, why = successful(values), reason or why
        if len(known) > 1 and np.isfinite(known).all(axis=0).any():
            truth = np.mean([each.stiffness for each in parts], axis=(0, 1))
            rows.append((count, scatter(known), debiased_bias_error(known, truth), len(known)))
        advance()
    return Curve.of(rows, why)


def measure_excess(method: Method, pilot: Pilot, draws: int, seed: int) -> float:
    """Return how many times as much a method's stiffness scatters in a pilot as simulated.

    Random halves of the pilot are compared with simulated ensembles as large. The result is 1 at
    least, since a pilot that scatters less by chance promises nothing. It counts differences
    between realizations, a reflex, and noise that is neither Gaussian nor stationary.
    """
    recorded, random = pilot.recorded, np.random.default_rng(seed)
    half = len(recorded) // 2
    if half < MIN_REALIZATIONS:
        return 1.0
    own = attrs.evolve(pilot, perturbation=None, amplitude=pilot.recorded_amplitude)
    simulated = (own.simulated(half, seed + number).ensemble for number in range(draws))
    promised = scatter(successful(identify_each(method, simulated)[0]))
    orders = [random.permutation(len(recorded)) for _ in range(draws)]
    first, second = (
        identify_each(method, (recorded.select(np.sort(order[part])) for order in orders))[0]
        for part in (slice(half), slice(half, 2 * half))
    )
    apart = successful(first - second)
    # The median, because a method may break down in one of them.
    typical = np.median(np.sqrt(np.nanmean(apart**2, axis=1) / 2)) if len(apart) else math.nan
    return max(1.0, float(typical / promised))  # 1 if neither is known


def measure_rise(method: Method, record: Simulated, count: int, draws: int) -> float:
    """Return the time in s in which a method's mean estimate rises from 10 to 90 % of a step."""
    parts = [part.ensemble for part in cut([record], count, draws)]
    values = identify_each(method, parts)[0]
    low, high = float(record.stiffness.min()), float(record.stiffness.max())
    # The step down, turned over, is one more step up.
    both = np.concatenate([values, low + high - np.roll(values, values.shape[1] // 2, axis=1)])
    known, time, period = successful(both), parts[0].time, parts[0].duration
    if not len(known):
        return math.nan
    levels = low + 0.1 * (high - low), high - 0.1 * (high - low)
    rise = rise_time(time, known, *levels, period / 4, min(MAX_RISE_S, 0.2 * period))
    return float(np.maximum(rise, time[1]))  # no sooner than a sample


def identify_each(
    method: Method, ensembles: Iterable[Ensemble], max_uncertainty: float = 0.0
) -> tuple[Array, str]:
    """Return the stiffness in each ensemble, shape (ensemble, time), and the reason of a failure.

    NaN where the method fails. It ends after some ensembles when the relative standard error of
    the scatter is below ``max_uncertainty``.
    """
    found, why = list[Array](), ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for each in ensembles:
            try:
                found.append(method.identify(subtract_mean(each)).stiffness)
            except Exception as error:  # a method may fail on few ensembles
                why = describe_error(error)
                found.append(np.full(each.samples, np.nan))
            is_round = max_uncertainty and len(found) % RECORDS == 0
            if is_round and uncertainty(successful(np.array(found))) < max_uncertainty:
                break
    return np.array(found), why


def successful(estimates: Array) -> Array:
    """Return the estimates (estimate, time) that are known at some time."""
    return estimates[np.isfinite(estimates).any(axis=-1)]


def scatter(estimates: Array) -> float:
    """Return the random error of which these few estimates (estimate, time) are a sample."""
    count = len(estimates)
    return random_error(estimates) * math.sqrt(count / (count - 1)) if count > 1 else math.nan


def uncertainty(estimates: Array) -> float:
    r"""Return the relative standard error of the scatter of few estimates (estimate, time).

    .. math:: 1 / \sqrt{2 f \nu}, \qquad
              \nu = (\operatorname{tr} \Sigma)^2 / \operatorname{tr} \Sigma^2

    with f one less than the estimates and :math:`\nu` the times at which a Gaussian estimate
    scatters independently, by the unbiased estimates of both traces.
    """
    known = estimates[:, np.isfinite(estimates).all(axis=0)]
    freedom = len(known) - 1
    if freedom < 2 or not known.size:
        return math.inf
    deviations = known - known.mean(axis=0)
    gram = deviations @ deviations.T / freedom
    squared, square = np.trace(gram) ** 2, float(np.sum(gram**2))
    times = (squared * (1 + 1 / freedom) - 2 * square / freedom) / max(
        square - squared / freedom, 1e-12 * squared
    )
    return 1 / math.sqrt(2 * freedom * max(times, 1.0))


def cut(records: Sequence[Simulated], count: int, draws: int) -> Iterator[Simulated]:
    """Yield about ``draws`` ensembles of ``count`` consecutive realizations of the records.

    No realization is in two of them, as far as the records last.
    """
    size = len(records[0].ensemble)
    parts = max(1, min(math.ceil(draws / len(records)), size // count))
    for first in np.linspace(0, max(size - count, 0), parts).astype(int):
        index = np.arange(first, min(first + count, size))
        for whole in records:
            yield Simulated(whole.ensemble.select(index), whole.stiffness[index])
