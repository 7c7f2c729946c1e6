"""Identify a linear and a Hammerstein pathway in parallel that do not change in time.

The Hammerstein pathway is a static function followed by linear dynamics. The fits use sums of
products of lagged signals, so that alternating between the pathways costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import cho_factor, cho_solve, qr

from tvsysid.numerics import Array
from tvsysid.numerics.pseudoinverse import Solution, truncated

STEPS = 50  # of the search for a static function, at most
# share of the output's power below which a better fit ends Hunter and Korenberg's iteration
GAIN = 1e-5
# cosine between a slope and what is left, of the output's size, that counts as a gradient of zero
GRADIENT = 1e-7
RIDGE = 1e-10  # share of the signals' power
TURNS = 10  # of either pathway, at most
LEAST_GAIN = 5e-4  # share of the output's power by which a turn must improve the fit

Nonlinearity = Literal["rectifier", "hk", "sls"]
Rows = tuple[
    Array, Array
]  # signals (signal, realization, before + time) and output (realization, time)


class LaggedProducts(NamedTuple):
    """Sums over samples of products of lagged signals with each other and with an output.

    ``gram`` (signal, lag, signal, lag), ``cross`` (signal, lag), ``square`` and ``samples`` of
    the output; the lags begin with 0.
    """

    gram: Array
    cross: Array
    square: float
    samples: int

    def of(self, coefficients: Array) -> tuple[Array, Array]:
        """Return ``gram`` and ``cross`` of the lags of a sum of signals with these coefficients."""
        gram = np.einsum("k,kilj,l->ij", coefficients, self.gram, coefficients, optimize=True)
        return gram, coefficients @ self.cross

    def left(self, coefficients: Array, weights: Array) -> float:
        """Sum of squares of the output that these coefficients and a response (lag,) leave."""
        gram, cross = self.of(coefficients)
        return self.square - 2 * float(cross @ weights) + float(weights @ gram @ weights)


def lagged_products(*rows: Rows) -> LaggedProducts:
    """Return sums of products of lagged signals with each other, and with an output.

    Each of the ``rows`` has signals (signal, realization, before + time) and an output
    (realization, time).
    """
    sums = []
    for signals, output in rows:
        late = sliding_window_view(signals, output.shape[1], axis=2)[:, :, ::-1]
        cross = [
            each.reshape(len(signals), -1) @ output.ravel() for each in np.moveaxis(late, 2, 0)
        ]
        gram = lagged_gram(signals, late.shape[2] - 1)
        sums.append((gram, np.stack(cross, axis=1), float(np.sum(output * output)), output.size))
    return LaggedProducts._make(sum(each) for each in zip(*sums, strict=True))


def lagged_gram(signals: Array, before: int) -> Array:
    r"""Sums of products of lagged signals (signal, realization, before + time) with each other.

    .. math:: G_{ki,lj} = \sum_{r,t} u_{kr}(t - i)\, u_{lr}(t - j), \qquad 0 \le i, j \le before

    One sample later in both lags, a sum gains what comes in at the beginning and loses what goes
    out at the end, so that all follow from those with lag 0; no matrix of lagged signals is
    built.
    """
    count, _, length = signals.shape
    times = length - before
    now = signals[:, :, before:].reshape(count, -1)
    with_now = np.stack(
        [
            now @ signals[:, :, before - lag : length - lag].reshape(count, -1).T
            for lag in range(before + 1)
        ]
    )
    gram = np.empty((count, before + 1, count, before + 1))
    gram[:, 0] = with_now.transpose(1, 2, 0)
    gram[:, :, :, 0] = with_now.transpose(2, 0, 1)
    entering, leaving = (
        ends.transpose(0, 2, 1).reshape(count * before, -1)
        for ends in (signals[:, :, :before][:, :, ::-1], signals[:, :, times:][:, :, ::-1])
    )
    change = (entering @ entering.T - leaving @ leaving.T).reshape(count, before, count, before)
    for lag in range(before):
        gram[:, lag + 1, :, 1:] = gram[:, lag, :, :-1] + change[:, lag]
    return gram


def response(gram: Array, cross: Array, square: float, samples: int) -> Solution:
    """Estimate weights of lags by least squares, truncated by description length.

    Directions that explain most come first.

    See :func:`tvsysid.numerics.pseudoinverse.truncated`; of its arrays, those of the one time.
    """
    power = np.array([square / samples])
    found = truncated(gram[None] / samples, cross[None] / samples, power, float(samples), "output")
    return Solution(*(values[0] for values in found))


def separable_least_squares(products: LaggedProducts, start: Array) -> tuple[Array, Array]:
    r"""Return coefficients c (signal,) and response g (lag,) by separable least squares.

    After Kaufman (1975).

    .. math:: y(t) = \sum_i g_i \sum_k c_k\, u_k(t - i)

    For any c the best g is known, so that the search is over c alone, of length 1: Levenberg and
    Marquardt's steps in the tangent space of the unit sphere, until the gradient is zero. A
    slight ridge keeps what is minimised smooth; only the response that is returned is truncated.
    """
    coefficients, damping = start / np.linalg.norm(start), 1e-2
    diagonal = np.einsum("kiki->", products.gram) / products.cross.size
    ridge = RIDGE * diagonal * np.eye(products.cross.shape[1])

    def minimum(coefficients: Array) -> tuple[Any, Array, float]:
        """Return the factor of the normal equations, the best response and its squared error."""
        gram, cross = products.of(coefficients)
        factor = cho_factor(gram + ridge)
        weights = cho_solve(factor, cross)
        return factor, weights, products.square - float(cross @ weights)

    factor, weights, left = minimum(coefficients)
    for _ in range(STEPS):
        answers = np.tensordot(
            products.gram, weights, (3, 0)
        )  # (signal, lag, signal): with J_l = g * u_l
        normal = np.tensordot(weights, answers, (0, 1))
        shared = np.tensordot(coefficients, answers, (0, 0))  # (lag, signal)
        tangents = qr(coefficients[:, None])[0][:, 1:]
        downhill = (products.cross @ weights - normal @ coefficients) @ tangents
        normal = tangents.T @ (normal - shared.T @ cho_solve(factor, shared)) @ tangents
        if np.all(downhill**2 <= GRADIENT**2 * np.diag(normal) * products.square):
            break
        for _ in range(12):
            step = np.linalg.solve(
                normal + damping * np.mean(np.diag(normal)) * np.eye(len(normal)), downhill
            )
            tried = coefficients + tangents @ step
            tried /= np.linalg.norm(tried)
            found = minimum(tried)
            if found[2] < left:
                break
            damping *= 4
        else:
            break
        coefficients, (factor, weights, left) = tried, found
        damping /= 10
    return coefficients, _fitted(products, coefficients)[0].weights


def hunter_korenberg(
    products: LaggedProducts, rows: Sequence[Rows], start: Array
) -> tuple[Array, Array]:
    """Coefficients (signal,) and response (lag,) by the iteration of Hunter & Korenberg (1986).

    A two-sided filter that undoes the response, half as long to either side, gives from the
    output what the static function must have given; the signals are fitted to that, and the
    response to their sum. Ends where the fit does not become better. In the ``rows``, signals
    are as long as the output.
    """
    reach = min(
        (products.gram.shape[1] - 1) // 2, *((output.shape[1] - 1) // 4 for _, output in rows)
    )
    regressors = np.concatenate(
        [each[:, :, reach : each.shape[2] - reach].reshape(len(each), -1) for each, _ in rows], 1
    )
    windows = np.concatenate([_windows(output, 2 * reach + 1) for _, output in rows])
    moments = windows.T @ windows
    best, least, coefficients = (start, np.zeros(products.gram.shape[1])), np.inf, start
    for _ in range(STEPS):
        found, left = _fitted(products, coefficients)
        if not left < least - GAIN * products.square:
            break
        best, least = (coefficients, found.weights), left
        wanted = coefficients @ regressors
        undone = (
            windows
            @ response(moments, windows.T @ wanted, float(wanted @ wanted), wanted.size).weights
        )
        coefficients = np.linalg.lstsq(regressors.T, undone, rcond=None)[0]
    return best


def _windows(values: Array, length: int) -> Array:
    """Return sliding windows of values (realization, time), shape (place, sample).

    The latest sample of a window comes first.
    """
    return sliding_window_view(values, length, axis=1)[:, :, ::-1].reshape(-1, length)


class Cascade(NamedTuple):
    """Two pathways that were identified in turn.

    ``intrinsic`` weights (lag,) and the moments that they were solved from, ``gram`` (lag, lag)
    and ``cross`` (lag,); ``coefficients`` (signal,) of the static function, ``reflex`` weights
    (lag,) of what follows it; the share of the output's power that is ``explained``, of so many
    ``samples``, after so many ``turns``; number of ``parameters``.
    """

    intrinsic: Solution
    gram: Array
    cross: Array
    coefficients: Array
    reflex: Array
    explained: float
    samples: int
    turns: int
    parameters: float


def parallel_cascade(
    rows: Sequence[Rows], lags: int, start: Array, nonlinearity: Nonlinearity
) -> Cascade:
    """Identify two parallel pathways in turn, each from the output that the other leaves.

    The first of the signals is the input of the one, so many samples ``lags`` ahead: its
    response reaches as far to either side. The other signals are those of which the static
    function of the other pathway is a sum; the search for their coefficients begins with
    ``start``, and a ``"rectifier"`` is one signal and needs none.
    """
    products = lagged_products(*rows)
    near = slice(2 * lags + 1)
    gram, cross, link = (
        products.gram[0, near, 0, near],
        products.cross[0, near],
        products.gram[0, near, 1:],
    )
    reflex = products._replace(gram=products.gram[1:, :, 1:], cross=products.cross[1:])
    best, coefficients, weights = None, start, np.zeros(reflex.cross.shape[1])
    for turn in range(1, TURNS + 1):
        left = cross - np.einsum("akl,k,l->a", link, coefficients, weights)
        intrinsic = response(gram, left, reflex.left(coefficients, weights), reflex.samples)
        answer = intrinsic.weights
        beside = reflex._replace(
            cross=reflex.cross - np.tensordot(answer, link, 1),
            square=reflex.square - 2 * float(answer @ cross) + float(answer @ gram @ answer),
        )
        if nonlinearity == "hk":
            coefficients, weights = hunter_korenberg(
                beside, [_less(answer, *each) for each in rows], start
            )
        elif nonlinearity == "sls":
            coefficients, weights = separable_least_squares(beside, coefficients)
        else:
            weights = _fitted(beside, coefficients)[0].weights
        explained = 1 - beside.left(coefficients, weights) / reflex.square
        if best is not None and explained < best.explained + LEAST_GAIN:
            break
        count = float(intrinsic.rank + _fitted(beside, coefficients)[0].rank + len(start) - 1)
        best = Cascade(
            intrinsic, gram, left, coefficients, weights, explained, reflex.samples, turn, count
        )
    assert best is not None
    return best


def _less(answer: Array, signals: Array, output: Array) -> Rows:
    """Return the signals but the first, and the output without the response to the first.

    The signals are as long as the output.
    """
    before = signals.shape[2] - output.shape[1]
    angle = signals[0, :, before - len(answer) + 1 :]
    return signals[1:, :, before:], output - (_windows(angle, len(answer)) @ answer).reshape(
        output.shape
    )


def _fitted(products: LaggedProducts, coefficients: Array) -> tuple[Solution, float]:
    """Best response for these coefficients, and the sum of squares that it leaves."""
    found = response(*products.of(coefficients), products.square, products.samples)
    return found, products.left(coefficients, found.weights)
