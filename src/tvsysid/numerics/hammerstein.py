"""Identify two linear pathways in parallel, each from what the other leaves of the output.

``alternate`` takes turns between pathways. Those of ``parallel_cascade`` do not change in time.
Their fits use sums of products of lagged signals, so that turns cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.pseudoinverse import Solution, truncated

MAX_TURNS = 10  # of either pathway
MIN_TURN_GAIN = 5e-4  # share of the output's power


class Turn(NamedTuple):
    """Weights after a turn, the explained share of the output's power, and the caller's details."""

    weights: Array = np.zeros(0)
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


class Pathway(NamedTuple):
    """Solution of a pathway, and mean products of its lagged input, and with the output."""

    solution: Solution
    gram: Array
    cross: Array


def parallel_cascade(moments: Moments, lags: int) -> Turn:
    """Identify two parallel pathways that do not change, in turn.

    There are two lagged signals. The first is the input of the first pathway, so many samples
    ``lags`` ahead: its response reaches as far to either side. Responses are truncated by
    description length, the directions that explain most first. The details of the turn are the
    two pathways.
    """
    gram, cross, power, _ = moments.times(1 / moments.number)
    pathways = np.arange(2 * lags + 1), np.arange(len(cross) // 2, len(cross))

    def step(before: Turn) -> Turn:
        weights, details = before.weights.copy(), []
        for own in pathways:
            weights[own] = 0.0
            left = cross - gram @ weights
            square = power - weights @ (cross + left)
            own_gram = gram[np.ix_(own, own)]
            solutions = truncated(
                own_gram[None], left[None, own], np.array([square]), moments.number, "output"
            )
            solution = Solution(*(values[0] for values in solutions))
            weights[own] = solution.weights
            details.append(Pathway(solution, own_gram, left[own]))
        explained = float(weights @ (2 * cross - gram @ weights)) / power
        return Turn(weights, explained, details)

    return alternate(step, Turn(np.zeros(len(cross))), MAX_TURNS, MIN_TURN_GAIN)
