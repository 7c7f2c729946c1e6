"""Identify a joint with two pathways by subspaces: a short linear one and a Hammerstein one.

The Hammerstein system has a low order. All data are arrays. They come in *pieces*, each a stretch
of record without a gap; a whole record is one piece. What an earlier input of a piece still does is
estimated as the free response of its initial state.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import cholesky, solve_triangular

from tvsysid.numerics import Array

ROUNDING = 1e-9  # relative singular value below which a direction of the inputs is rounding
RIDGE = 1e-13  # share of an input's power: more than the rounding of its products
SLOWEST = 0.999  # size of a pole at most
TINY = 1e-12  # relative change of the error at which the alternation ends
ROUNDS = 1000  # of the alternation at most


class Piece(NamedTuple):
    """Stretch of record without a gap.

    The ``output`` (time,), the signal that the short linear path takes, ``lagged`` (time + 2
    lags,), from so many lags before the first output to as many after the last, and the
    ``inputs`` (time, input) of the Hammerstein system.
    """

    output: Array
    lagged: Array
    inputs: Array

    def regressors(self) -> Array:
        """Lagged signal at lags from -lags to lags, (time, lag)."""
        lags = len(self.lagged) - len(self.output)
        return sliding_window_view(self.lagged, lags + 1)[:, ::-1]

    def without(self, response: Array) -> Piece:
        """Return the piece without the output of the short path, whose response is given."""
        return self._replace(output=self.output - self.regressors() @ response)


class Rows(NamedTuple):
    """Rows of a least-squares problem, of all pieces.

    ``answers`` (row, (order + 1) input) of all systems with certain poles to all inputs,
    ``signals`` (row, lag) and ``output`` (row,).
    """

    answers: Array
    signals: Array
    output: Array

    @property
    def response(self) -> Array:
        """Least-squares response (lag,) of the output to the signals."""
        return _least_squares(self.signals, self.output)


class Hammerstein(NamedTuple):
    """Weighted sum of the inputs through numerator / denominator in 1/z.

    ``weights`` (input,) have unit norm. ``left`` is what the system leaves of the output.
    """

    weights: Array
    numerator: Array
    denominator: Array
    left: Array

    @property
    def static_gain(self) -> float:
        """Area under the impulse response of the linear part."""
        return float(self.numerator.sum() / self.denominator.sum())

    def impulse_response(self, samples: int) -> Array:
        """Of the linear part, (lag,) from 0."""
        impulse = np.eye(1, samples)[0]
        return scipy.signal.lfilter(self.numerator, self.denominator, impulse)


def dynamics(pieces: Sequence[Piece], horizon: int, order: int, lagged: bool = True) -> Array:
    r"""Return the denominator (order + 1,) of the system from inputs to output, in powers of 1/z.

    This is MOESP with past inputs. With future inputs, past inputs and future outputs as
    block-Hankel matrices of ``horizon`` samples, the part of the outputs that follows from past
    inputs and not from future ones spans the columns of the extended observability matrix
    :math:`[C; CA; CA^2; \dots]`, whose shift invariance gives A.

    The ``lagged`` signals are among the inputs where the short path is still in the output.
    """
    observability = np.linalg.svd(_from_past(pieces, horizon, lagged))[0][:, :order]
    poles = np.linalg.eigvals(np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0])
    within = poles / np.maximum(np.abs(poles), 1.0) ** 2  # reflected into the unit circle
    within *= SLOWEST / np.maximum(np.abs(within), SLOWEST)
    return np.real(np.poly(within))


def rows_of(pieces: Iterable[Piece], denominator: Array) -> Rows:
    """Return the rows of pieces, without the free responses of initial states."""
    order, rows = len(denominator) - 1, []
    for piece in pieces:
        once = scipy.signal.lfilter([1.0], denominator, piece.inputs, axis=0)
        delayed = [np.pad(once, ((k, 0), (0, 0)))[: len(once)] for k in range(order + 1)]
        parts = np.concatenate(delayed, axis=1), piece.regressors(), piece.output
        impulses = np.eye(len(once), order)
        free = np.linalg.qr(scipy.signal.lfilter([1.0], denominator, impulses, axis=0))[0]
        rows.append([each - free @ (free.T @ each) for each in parts])
    return Rows(*(np.concatenate(each) for each in zip(*rows, strict=True)))


def project(rows: Rows) -> Rows:
    r"""Remove from lagged signals and output all that a system with these poles can explain.

    .. math:: \hat h = (U^T M U)^{-1} U^T M\, y, \qquad M = 1 - \Phi \Phi^+

    are the least squares of what is left, the response of the short path whatever numerator and
    weights the system has: U are the lagged signals, :math:`\Phi` the answers.
    """
    columns = np.column_stack([rows.signals, rows.output])
    columns -= rows.answers @ _least_squares(rows.answers, columns)
    return Rows(rows.answers, columns[:, :-1], columns[:, -1])


def hammerstein(rows: Rows, denominator: Array) -> Hammerstein:
    """Return the Hammerstein system with these poles that fits the output of the rows.

    Numerator and weights take turns, each by least squares, from the matrix of rank one that is
    nearest to the coefficients of all inputs through all systems, until the error does not fall any
    more. The first weight that is not zero is positive.
    """
    # As many rows as columns, with the same products
    triangle = np.asarray(np.linalg.qr(np.column_stack([rows.answers, rows.output]), mode="r"))
    answers, target = triangle[:, :-1], triangle[:, -1]
    product = answers.reshape(len(target), len(denominator), -1)
    start = _least_squares(answers, target).reshape(product.shape[1:])
    weights = np.linalg.svd(start, full_matrices=False)[2][0]
    error = np.inf
    for _ in range(ROUNDS):
        columns = np.tensordot(_least_squares(product @ weights, target), product, (0, 1))
        turned = _least_squares(columns, target)
        if not turned.any():
            break
        weights = turned / np.linalg.norm(turned) * np.sign(turned[np.argmax(turned != 0)])
        before = error
        error = float(np.sum((target - columns @ turned) ** 2))
        if before - error <= TINY * float(target @ target):
            break
    columns = rows.answers.reshape(len(rows.output), len(denominator), -1) @ weights
    numerator = _least_squares(columns, rows.output)
    return Hammerstein(weights, numerator, denominator, rows.output - columns @ numerator)


def _from_past(pieces: Sequence[Piece], horizon: int, lagged: bool) -> Array:
    """Return future outputs (sample, direction) along directions that past inputs add.

    The directions of the future inputs are not among them.

    With [future inputs, past inputs, future outputs] = QR, it is the block of R for past inputs
    and future outputs. R is the Cholesky factor of the columns' products. A slight ridge serves
    inputs that are nearly collinear.
    """
    further = (len(pieces[0].lagged) - len(pieces[0].output)) * lagged  # samples of lagged signals
    reach = 2 * horizon + further
    gram: Array = np.zeros(())
    for output, angle, inputs in pieces:
        signals = np.pad(np.vstack([output, inputs.T]), ((0, 0), (further, 0)))
        signals = np.vstack([signals, angle]) if lagged else signals
        gram = gram + lagged_gram(signals, reach - 1)
    late = np.arange(reach) - np.full((len(signals), 1), horizon)  # the past begins at 0
    late[-1] -= further
    late[0] = horizon  # the output is no input
    future = np.flatnonzero(late < 0)
    past = np.flatnonzero((late >= 0) & (late < horizon))
    inputs = np.concatenate([future, past])
    gram = gram.reshape(late.size, -1)
    size = np.sqrt(np.diag(gram)[inputs, None])
    scaled = gram[np.ix_(inputs, inputs)] / (size * size.T)
    factor = cholesky(scaled + RIDGE * np.eye(len(inputs)), lower=True)
    outputs = gram[inputs, :horizon][:, ::-1] / size
    return solve_triangular(factor, outputs, lower=True)[len(future) :].T


def lagged_gram(signals: Array, before: int) -> Array:
    r"""Return sums of products of lagged signals (signal, before + time).

    .. math:: G_{ki,lj} = \sum_t u_k(t - i)\, u_l(t - j), \qquad 0 \le i, j \le before

    One sample later in both lags, a sum gains what comes in at the beginning and loses what goes
    out at the end, so that all follow from those with lag 0; no matrix of lagged signals is
    built.
    """
    count, length = signals.shape
    gram = np.empty((count, before + 1, count, before + 1))
    for lag in range(before + 1):
        gram[:, 0, :, lag] = signals[:, before:] @ signals[:, before - lag : length - lag].T
        gram[:, lag, :, 0] = gram[:, 0, :, lag].T
    entering, leaving = (
        each[:, ::-1].ravel() for each in (signals[:, :before], signals[:, length - before :])
    )
    change = np.outer(entering, entering) - np.outer(leaving, leaving)
    change = change.reshape(count, before, count, before)
    for lag in range(before):
        gram[:, lag + 1, :, 1:] = gram[:, lag, :, :-1] + change[:, lag]
    return gram


def _least_squares(columns: Array, target: Array) -> Array:
    return np.asarray(np.linalg.lstsq(columns, target, rcond=ROUNDING)[0])
