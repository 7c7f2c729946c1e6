"""Identify a linear and a Hammerstein pathway in parallel that do not change in time.

The Hammerstein pathway is a static function followed by linear dynamics. The fits use sums of
products of lagged signals, so that alternating between the pathways costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, NamedTuple, Protocol, TypeVar

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.pseudoinverse import Solution, truncated

RIDGE = 1e-10  # share of the signals' power
MAX_TURNS = 10  # of either pathway
MIN_TURN_GAIN = 5e-4  # share of the output's power

Nonlinearity = Literal["rectifier", "sls"]
# Signals (signal, realization, before + time) and output (realization, time)
Rows = tuple[Array, Array]


class Fit(Protocol):
    """Fit that explains a share of the output's power."""

    @property
    def explained(self) -> float:
        """Return the share."""
        ...  # pragma: no cover


AnyFit = TypeVar("AnyFit", bound=Fit)


def last_better(fits: Iterable[AnyFit], min_gain: float) -> AnyFit:
    """Return the last of some fits before one explains less than ``min_gain`` more."""
    fits = iter(fits)
    best = next(fits)
    for fit in fits:
        if not fit.explained >= best.explained + min_gain:
            break
        best = fit
    return best


def lagged_moments(rows: Sequence[Rows]) -> Moments:
    """Return moments of lagged signals, from lag 0 on. All lags of a signal stand together."""
    sums = []
    for signals, output in rows:
        late = sliding_window_view(signals, output.shape[1], axis=2)[:, :, ::-1]
        lagged = (each.reshape(len(signals), -1) for each in np.moveaxis(late, 2, 0))
        cross = np.stack([each @ output.ravel() for each in lagged], axis=1).ravel()
        gram = lagged_gram(signals, late.shape[2] - 1).reshape(cross.size, -1)
        sums.append((gram, cross, float(np.sum(output * output)), output.size))
    return Moments._make(sum(each) for each in zip(*sums, strict=True))


def less(moments: Moments, columns: NDArray[np.int64], weights: Array) -> Moments:
    """Return the moments of what some columns with these weights leave of the output."""
    gram, cross, square, number = moments
    explained = gram[:, columns] @ weights
    square += float(weights @ (explained - 2 * cross)[columns])
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


def response(moments: Moments) -> Solution:
    """Estimate weights of lags by least squares, truncated by description length.

    Directions that explain most come first. See :func:`tvsysid.numerics.pseudoinverse.truncated`;
    of its arrays, those of the one time.
    """
    number = moments.number
    gram, cross, square, _ = moments.times(1 / number)
    found = truncated(gram[None], cross[None], np.array([square]), number, "output")
    return Solution(*(values[0] for values in found))


def separable_least_squares(moments: Moments, start: Array) -> Array:
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


class Cascade(NamedTuple):
    """Two pathways that were identified in turn.

    The ``intrinsic`` response solves the ``moments`` of its input and of the output less the other
    pathway's. ``coefficients`` (signal,) are those of the static function, ``reflex`` weights
    (lag,) those of the dynamics behind it. They have explained a share of the output's power
    after so many ``turns``. ``parameters`` is the number of parameters.
    """

    intrinsic: Solution
    moments: Moments
    coefficients: Array
    reflex: Array
    explained: float
    turns: int
    parameters: float


def parallel_cascade(
    rows: Sequence[Rows], lags: int, start: Array, nonlinearity: Nonlinearity
) -> Cascade:
    """Identify two parallel pathways in turn, each from the output that the other leaves.

    The first of the signals is the input of the one, so many samples ``lags`` ahead: its
    response reaches as far to either side. The other signals are those of which the static
    function of the other pathway is a sum; the search for their coefficients begins with
    ``start``. A ``"rectifier"`` is one signal and needs no search.
    """
    return last_better(_turns(rows, lags, start, nonlinearity), MIN_TURN_GAIN)


def _turns(
    rows: Sequence[Rows], lags: int, coefficients: Array, nonlinearity: Nonlinearity
) -> Iterator[Cascade]:
    every, start = lagged_moments(rows), coefficients
    count = len(every.cross) // (1 + len(start))  # lags of a signal
    near, late = np.arange(2 * lags + 1), np.arange(count, len(every.cross))
    weights = np.zeros(count)
    for turn in range(1, MAX_TURNS + 1):
        moments = less(every, late, np.outer(coefficients, weights).ravel()).take(near)
        intrinsic = response(moments)
        rest = less(every, near, intrinsic.weights).take(late)
        if nonlinearity == "sls":
            coefficients = separable_least_squares(rest, coefficients)
        drive = mixed(rest, coefficients)
        reflex = response(drive)
        weights = reflex.weights
        explained = 1 - less(drive, np.arange(count), weights).square / every.square
        parameters = float(intrinsic.rank + reflex.rank + len(start) - 1)
        yield Cascade(intrinsic, moments, coefficients, weights, explained, turn, parameters)
