"""Identify two linear pathways in parallel, each from what the other leaves of the output.

``alternate`` takes turns between pathways. Those of ``parallel_cascade`` do not change in time.
Their fits use sums of products of lagged signals, so that turns cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.pseudoinverse import Solution, truncated

MAX_TURNS = 10  # of either pathway
MIN_TURN_GAIN = 5e-4  # share of the output's power


class Turn(NamedTuple):
    """Weights of the second pathway after a turn, and the explained share of the output's power.

    ``details`` are the caller's.
    """

    second: Array
    explained: float = -np.inf
    details: Any = None


def alternate(step: Callable[[Turn], Turn], start: Turn, max_turns: int, min_gain: float) -> Turn:
    """Return the last turn before one explains less than ``min_gain`` more."""
    best = start
    for _ in range(max_turns):
        turn = step(best)
        if not turn.explained >= best.explained + min_gain:
            break
        best = turn
    return best


def lagged_moments(rows: Iterable[tuple[Array, Array]]) -> Moments:
    """Return moments of lagged signals, from lag 0 on. All lags of a signal stand together.

    Rows are signals (signal, realization, before + time) and output (realization, time).
    """
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
    flat = np.ascontiguousarray(signals.transpose(0, 2, 1))  # realizations of a time together

    def between(start: int, stop: int) -> Array:
        return flat[:, start:stop].reshape(count, -1)

    gram = np.empty((count, before + 1, count, before + 1))
    for lag in range(before + 1):
        gram[:, 0, :, lag] = between(before, length) @ between(before - lag, length - lag).T
        gram[:, lag, :, 0] = gram[:, 0, :, lag].T
    entering, leaving = (
        np.reshape(each[:, ::-1], (count * before, -1))
        for each in (flat[:, :before], flat[:, length - before :])
    )
    change = (entering @ entering.T - leaving @ leaving.T).reshape(count, before, count, before)
    for lag in range(before):
        gram[:, lag + 1, :, 1:] = gram[:, lag, :, :-1] + change[:, lag]
    return gram


class Constant(NamedTuple):
    """First pathway of a turn, the ``moments`` that it solves, and both pathways' ranks."""

    first: Solution
    moments: Moments
    rank: int


def parallel_cascade(every: Moments, lags: int) -> Turn:
    """Identify two parallel pathways that do not change, in turn.

    There are two lagged signals. The first is the input of the first pathway, so many samples
    ``lags`` ahead: its response reaches as far to either side. The details of the turn are a
    ``Constant``.
    """
    size = len(every.cross)
    near, late = np.arange(2 * lags + 1), np.arange(size // 2, size)

    def step(before: Turn) -> Turn:
        moments = _less(every, late, before.second).take(near)
        first = _response(moments)
        rest = _less(every, near, first.weights).take(late)
        second = _response(rest)
        left = _less(rest, np.arange(len(late)), second.weights).square
        details = Constant(first, moments, int(first.rank + second.rank))
        return Turn(second.weights, 1 - left / every.square, details)

    return alternate(step, Turn(np.zeros(len(late))), MAX_TURNS, MIN_TURN_GAIN)


def _less(moments: Moments, columns: NDArray[np.intp], weights: Array) -> Moments:
    """Return the moments of what some columns with these weights leave of the output."""
    gram, cross, square, number = moments
    explained = gram[:, columns] @ weights
    square += float(weights @ (explained - 2 * cross)[columns])
    return Moments(gram, cross - explained, square, number)


def _response(moments: Moments) -> Solution:
    """Estimate weights of lags by least squares, truncated by description length.

    Directions that explain most come first. See :func:`tvsysid.numerics.pseudoinverse.truncated`;
    of its arrays, those of the one time.
    """
    number = moments.number
    gram, cross, square, _ = moments.times(1 / number)
    found = truncated(gram[None], cross[None], np.array([square]), number, "output")
    return Solution(*(values[0] for values in found))
