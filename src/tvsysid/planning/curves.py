"""Measure how error depends on the number of realizations, in simulated ensembles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property, partial
from typing import NamedTuple

import attrs
import numpy as np
import scipy

from tvsysid.errors import describe_error, without_quality_warnings
from tvsysid.methods import Method
from tvsysid.metrics import debiased_bias_error, rise_time
from tvsysid.models import Model
from tvsysid.planning.protocol import Protocol, Simulated, scatter
from tvsysid.preprocess import subtract_mean
from tvsysid.signals import Array, Ensemble

MIN_REALIZATIONS = 10  # of a pilot's halves
DRAWS = 6  # simulated ensembles of each size
SPLITS = 6  # of a pilot into random halves
POWERS = np.array([0.75, 1.0, 2.0, 4.0])  # of 1/n, whose sum is the variance
ROUNDS = 10  # of reweighted least squares
MAX_RISE_S = 0.4  # on either side of a step


class Errors(NamedTuple):
    """Random error and bias error in N·m/rad (:mod:`tvsysid.metrics`), and RMS sum of both."""

    random: float
    bias: float
    total: float


@attrs.frozen(eq=False)
class Curve:
    """Errors of one method against the number of realizations.

    Parameters
    ----------
    realizations
        Numbers of realizations, shape (size,). Sizes at which the method fails are left out.
    random, bias
        Random error and bias in N·m/rad, shape (size,).
    why
        Why the method fails, if it does.
    excess
        Random error in a pilot over that in simulated realizations. :meth:`at` multiplies by it.
    """

    realizations: Array
    random: Array
    bias: Array
    why: str = ""
    excess: float = 1.0

    @cached_property
    def powers(self) -> Array:
        """Variance as a sum of powers of 1/n, none of them negative, shape (power,).

        The fit minimises relative errors. Few realizations take high powers, where a method nears
        the fewest that it needs. Smoothers that become finer with more data take a power below 1.
        """
        columns, variance = self.realizations[:, None] ** -POWERS, self.random**2
        fitted, found = variance, np.zeros(len(POWERS))
        for _ in range(ROUNDS):
            found = scipy.optimize.nnls(columns / fitted[:, None], variance / fitted)[0]
            fitted = columns @ found
        return found

    def at(self, count: float) -> Errors:
        """Return the errors with this number of realizations. NaN for fewer than were simulated.

        Beyond the largest size, the bias stays and the variance goes on falling.
        """
        if count < min(self.realizations, default=math.inf):
            return Errors(*[math.nan] * 3)
        bias = float(np.interp(math.log(count), np.log(self.realizations), self.bias))
        random = self.excess * math.sqrt(float(count**-POWERS @ self.powers))
        return Errors(random, bias, math.hypot(random, bias))

    def needed(self, error: float, most: int) -> int | None:
        """Return the fewest realizations up to ``most`` with a total error this small, or None."""
        return next((count for count in range(1, most + 1) if self.at(count).total <= error), None)


def measure_curve(
    method: Method, protocol: Protocol, records: Sequence[Simulated], seed: int
) -> Curve:
    """Return the curve of a method from ensembles that are cut from simulated records."""
    rows, why = [], ""
    truth = np.mean([whole.stiffness for whole in records], axis=(0, 1))
    for count in protocol.sizes:
        starts = np.linspace(0, len(records[0].ensemble) - count, DRAWS, endpoint=False, dtype=int)
        parts = (
            whole.ensemble.select(start + np.arange(count))
            for start, whole in zip(starts, records, strict=True)
        )
        known, reason = identify_each(method.identify, parts)
        why = reason or why
        if len(known) > 1 and np.isfinite(known).all(axis=0).any():
            rows.append((count, scatter(known), debiased_bias_error(known, truth)))
    excess = measure_excess(method, protocol, seed)
    realizations, random, bias = np.reshape(rows, (-1, 3)).T
    return Curve(realizations, random, bias, why, excess)


def measure_excess(method: Method, protocol: Protocol, seed: int) -> float:
    """Return how many times as much a method's stiffness scatters in a pilot as simulated.

    Random halves of the pilot are compared with simulated ensembles as large. Methods that search,
    as for a reflex, keep what they find in the whole pilot, for which a half may be too small. The
    result is 1 at least, since a pilot that scatters less by chance promises nothing. It counts
    differences between realizations, and noise that is neither Gaussian nor stationary.
    """
    pilot, random = protocol.pilot, np.random.default_rng(seed)
    if pilot is None or (half := len(pilot) // 2) < MIN_REALIZATIONS:
        return 1.0
    own, whole = protocol.like(pilot), cache(partial(method.identify, pilot))

    def measure(ensembles: Iterable[Ensemble]) -> float:
        return scatter(identify_each(lambda each: method.refit(each, whole()), ensembles)[0])

    promised = measure(own.simulated(half, seed + number).ensemble for number in range(2 * SPLITS))
    orders = (random.permutation(len(pilot))[: 2 * half] for _ in range(SPLITS))
    measured = [
        measure(pilot.select(np.sort(part)) for part in np.split(order, 2)) for order in orders
    ]
    return max(1.0, math.hypot(*measured) / math.sqrt(SPLITS) / promised)  # 1 if neither is known


def measure_rise(method: Method, stepped: Simulated) -> float:
    """Return the time in s in which a method's estimate rises from 10 to 90 % of a step."""
    known, _ = identify_each(method.identify, [stepped.ensemble])
    if not len(known):
        return math.nan
    low, high = float(stepped.stiffness.min()), float(stepped.stiffness.max())
    # The step down, turned over, is one more step up.
    both = np.concatenate([known, low + high - np.roll(known, known.shape[1] // 2, axis=1)])
    time, period = stepped.ensemble.time, stepped.ensemble.duration
    levels = low + 0.1 * (high - low), high - 0.1 * (high - low)
    rise = rise_time(time, both, *levels, period / 4, min(MAX_RISE_S, 0.2 * period))
    return float(np.maximum(rise, time[1]))  # no sooner than a sample


def identify_each(
    identify: Callable[[Ensemble], Model], ensembles: Iterable[Ensemble]
) -> tuple[Array, str]:
    """Return the stiffness in each ensemble, shape (ensemble, time), and the reason of a failure.

    Ensembles that a method fails to identify are left out.
    """
    found, why = list[Array](), ""
    with without_quality_warnings():
        for each in ensembles:
            try:
                found.append(identify(subtract_mean(each)).stiffness)
            except Exception as error:  # a method may fail on few ensembles
                why = describe_error(error)
    return np.array(found), why
