"""Identify a linear and a Hammerstein pathway in parallel, each from what the other leaves.

The Hammerstein pathway is a static function followed by linear dynamics. ``alternate`` takes
turns between the pathways. Those of ``parallel_cascade`` do not change in time. Their fits use
sums of products of lagged signals, so that turns cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.pseudoinverse import Solution, truncated

RIDGE = 1e-10  # share of the signals' power
MAX_TURNS = 10  # of either pathway
MIN_TURN_GAIN = 5e-4  # share of the output's power

# Signals (signal, realization, before + time) and output (realization, time)
Rows = tuple[Array, Array]


class Turn(NamedTuple):
    """Two pathways after a turn of each, which explain a share of the output's power.

    ``coefficients`` (signal,) are those of the static function, ``reflex`` weights those of the
    dynamics behind it. ``details`` are the caller's.
    """

    coefficients: Array
    reflex: Array
    explained: float = -np.inf
    details: Any = None
    number: int = 0


def alternate(step: Callable[[Turn], Turn], start: Turn, max_turns: int, min_gain: float) -> Turn:
    """Return the last turn before one explains less than ``min_gain`` more."""
    best = start
    for number in range(1, max_turns + 1):
        turn = step(best)
        if not turn.explained >= best.explained + min_gain:
            break
        best = turn._replace(number=number)
    return best


def lagged_moments(rows: Sequence[Rows]) -> Moments:
    """Return moments of lagged signals, from lag 0 on. All lags of a signal stand together."""
    sums = []
    for signals, output in rows:
        late = sliding_window_view(signals, output.shape[1], axis=2)[:, :, ::-1]
        cross = np.einsum("srlt,rt->sl", late, output).ravel()
        gram = lagged_gram(signals, late.shape[2] - 1).reshape(cross.size, -1)
        sums.append((gram, cross, float(np.sum(output * output)), output.size))
    return Moments._make(sum(each) for each in zip(*sums, strict=True))


def lagged_gram(signals: Array, before: int) -> Array:
    r"""Return sums of products of lagged signals (signal, realization, before + time).

    .. math:: G_{ki,lj} = \sum_{r,t} u_{kr}(t - i)\, u_{lr}(t - j), \qquad 0 \le i, j \le before

    One sample later in both lags, a sum gains what comes in at the beginning and loses what goes
    out at the end, so that all follow from those with lag 0; no matrix of lagged signals is
    built.
    """
    count, _, length = signals.shape
    times = length - before
    gram = np.empty((count, before + 1, count, before + 1))
    now = signals[:, :, before:].reshape(count, -1)
    for lag in range(before + 1):
        late = signals[:, :, before - lag : length - lag].reshape(count, -1)
        gram[:, 0, :, lag] = now @ late.T
        gram[:, lag, :, 0] = gram[:, 0, :, lag].T
    entering, leaving = (
        ends.transpose(0, 2, 1).reshape(count * before, -1)
        for ends in (signals[:, :, :before][:, :, ::-1], signals[:, :, times:][:, :, ::-1])
    )
    change = (entering @ entering.T - leaving @ leaving.T).reshape(count, before, count, before)
    for lag in range(before):
        gram[:, lag + 1, :, 1:] = gram[:, lag, :, :-1] + change[:, lag]
    return gram


def less(moments: Moments, weights: Array) -> Moments:
    """Return the moments of what columns with these weights leave of the output."""
    gram, cross, square, number = moments
    explained = gram @ weights
    square += float(weights @ (explained - 2 * cross))
    return Moments(gram, cross - explained, square, number)


def by_signal(moments: Moments, count: int) -> tuple[Array, Array]:
    """Return the gram (signal, lag, signal, lag) and cross (signal, lag) of lagged signals."""
    shape = count, len(moments.cross) // count
    return moments.gram.reshape(*shape, *shape), moments.cross.reshape(shape)


def mixed(moments: Moments, coefficients: Array) -> Moments:
    """Return the moments of the lags of a weighted sum of signals."""
    gram, cross = by_signal(moments, len(coefficients))
    gram = np.einsum("k,kilj,l->ij", coefficients, gram, coefficients, optimize=True)
    return moments._replace(gram=gram, cross=coefficients @ cross)


def response(moments: Moments) -> Solution:
    """Estimate weights of lags by least squares, truncated by description length.

    Directions that explain most come first. See :func:`tvsysid.numerics.pseudoinverse.truncated`;
    of its arrays, those of the one time.
    """
    number = moments.number
    gram, cross, square, _ = moments.times(1 / number)
    found = truncated(gram[None], cross[None], np.array([square]), number, "output")
    return Solution(*(values[0] for values in found))


def static_function(moments: Moments, start: Array) -> Array:
    r"""Return coefficients c (signal,) of unit length by separable least squares (Kaufman 1975).

    .. math:: y(t) = \sum_i g_i \sum_k c_k\, u_k(t - i)

    For any c the best response g is known, so that the search is over c alone; its length has no
    effect. A slight ridge keeps the squared error smooth.
    """
    ridge = RIDGE * np.trace(moments.gram) / len(moments.cross)
    terms, cross_terms = by_signal(moments, len(start))

    def cost(coefficients: Array) -> tuple[float, Array]:
        gram, cross, square, _ = mixed(moments, coefficients)
        raised = gram + ridge * (coefficients @ coefficients) * np.eye(len(cross))
        weights = np.linalg.solve(raised, cross)
        normal = np.einsum("i,kilj,j->kl", weights, terms, weights, optimize=True)
        slope = normal @ coefficients - cross_terms @ weights
        slope += ridge * (weights @ weights) * coefficients
        return -float(cross @ weights) / square, 2 * slope / square

    options = {"gtol": 1e-9, "maxiter": 1000}
    start = start / np.linalg.norm(start)
    found = scipy.optimize.minimize(cost, start, jac=True, method="BFGS", options=options).x
    return np.asarray(found / np.linalg.norm(found))


class Constant(NamedTuple):
    """Intrinsic pathway of a turn, the ``moments`` that it solves, and both pathways' ranks."""

    intrinsic: Solution
    moments: Moments
    rank: int


def parallel_cascade(every: Moments, lags: int, start: Array) -> Turn:
    """Identify two parallel pathways that do not change, in turn.

    The first of the signals is the input of the one, so many samples ``lags`` ahead: its
    response reaches as far to either side. The other signals are those of which the static
    function of the other pathway is a sum; the search for their coefficients begins with
    ``start``. A single signal needs no search. The details of the turn are a ``Constant``.
    """
    count, size = len(every.cross) // (1 + len(start)), len(every.cross)  # lags of a signal
    near, late = np.arange(2 * lags + 1), np.arange(count, size)

    def step(before: Turn) -> Turn:
        coefficients = before.coefficients
        reflex = np.outer(coefficients, before.reflex).ravel()
        moments = less(every, np.pad(reflex, (count, 0))).take(near)
        intrinsic = response(moments)
        rest = less(every, np.pad(intrinsic.weights, (0, size - len(near)))).take(late)
        if len(start) > 1:
            coefficients = static_function(rest, coefficients)
        drive = mixed(rest, coefficients)
        found = response(drive)
        details = Constant(intrinsic, moments, int(intrinsic.rank + found.rank))
        left = less(drive, found.weights).square
        return Turn(coefficients, found.weights, 1 - left / every.square, details)

    return alternate(step, Turn(start, np.zeros(count)), MAX_TURNS, MIN_TURN_GAIN)
