"""How sure the coefficients are: their covariance under noise of any colour, and the standard errors that follow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from tvsysid.estimates import StandardError
from tvsysid.methods.cascade.regressors import Columns
from tvsysid.methods.cascade.shape import TERMS, Found, Problem
from tvsysid.numerics import Array
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.moments import row_blocks
from tvsysid.numerics.noise import autocovariance

LONGEST = 60  # samples up to which the noise's autocorrelation counts


class NonNegativeError(StandardError):
    """Random error of an estimate that is not negative: nor is its band."""

    def limits(self, values: Array, level: float, simultaneous: bool = False) -> tuple[Array, Array]:
        """See :meth:`tvsysid.Estimate.band`."""
        lower, upper = super().limits(values, level, simultaneous)
        return np.maximum(lower, 0.0), upper


class Covariance(NamedTuple):
    """Of the columns' coefficients from the ``first`` on, and then of the free numbers of the shape."""

    matrix: Array
    freedom: float
    first: int

    def error(
        self, features: Array, known: NDArray[np.bool_], start: int, kind: type[StandardError] = StandardError
    ) -> StandardError:
        """Standard error of sums of coefficients from ``start`` on, with features (time, coefficient), where known."""
        start -= self.first
        stop = start + features.shape[1]
        covariance = self.matrix[start:stop, start:stop]
        variance = np.einsum("tj,jk,tk->t", features, covariance, features, optimize=True)
        values = np.where(known, np.sqrt(np.maximum(variance, 0.0)), np.nan)
        return kind(values, np.array(self.freedom), arc_length(features, covariance))


def covariance_of(problem: Problem, found: Found, left: Array, first: int = 0) -> Covariance:
    r"""Sandwich covariance of a solution's coefficients from the ``first`` on; it ``left`` some torque.

    .. math:: H^{-1} \left(\Phi^T \Sigma \Phi + \sigma^4 P^{-1}\right) H^{-1}, \qquad
              H = \Phi^T \Phi + \sigma^2 P^{-1}

    with the derivatives by the shape among the columns, P the prior's covariance, and :math:`\Sigma` the noise's
    autocovariance within a realization, from what is left, with Bartlett's weights.
    """
    further = problem.columns_and_slopes(found)
    scale = np.concatenate([found.scale, np.ones(len(problem.free))])
    gram = problem.data.moments(further).scaled(scale).gram
    noise = found.solved.noise_variance
    shape = np.array([TERMS[name].spread for name in problem.free]) ** 2
    weight = np.concatenate([1 / found.spread**2, noise / shape])
    freedom = max(1.0, problem.data.number - found.solved.effective - len(shape))
    inverse = np.linalg.inv(gram + np.diag(weight))[first:] / scale[first:, None]
    weights = inverse / scale
    coloured = _coloured(problem, further, len(scale), weights if first else None, _spectrum(left, freedom))
    if not first:
        coloured = weights @ coloured @ weights.T
    matrix = problem.data.share**2 * coloured + noise * (inverse * weight) @ inverse.T
    return Covariance(matrix, freedom, first)


def _spectrum(left: Array, freedom: float) -> Array:
    """Power of the noise at the frequencies of transforms that are long enough for its correlation not to wrap."""
    times = left.shape[1]
    lags = min(times - 1, LONGEST)
    covariance = autocovariance(left, lags) * left.size / freedom
    covariance *= 1 - np.arange(lags + 1) / (lags + 1)
    size = 2 * next_fast_len((times + lags + 1) // 2, real=True)  # an even number
    both = np.zeros(size)
    both[: lags + 1] = covariance
    both[size - lags :] = covariance[:0:-1]
    return np.asarray(np.maximum(rfft(both).real, 0.0))


def _coloured(problem: Problem, further: Columns, every: int, mixture: Array | None, power: Array) -> Array:
    """Products of the columns, or of mixtures of them, weighted by the noise's autocovariance at their distance."""
    data = problem.data
    count = every if mixture is None else len(mixture)
    size = 2 * (len(power) - 1)
    times = data.torque.shape[1]
    out = np.zeros((count, count))
    # Frequencies between 0 and Nyquist's stand for their negative ones too.
    twice = np.full(len(power), 2.0)
    twice[[0, -1]] = 1.0
    weights = np.sqrt(power * twice / size)
    for rows in row_blocks(len(data.torque), every * times):
        columns = np.concatenate([data.modulated(rows), further(rows)])
        mixed = columns if mixture is None else np.tensordot(mixture, columns, axes=1)
        spectra = rfft(mixed, size, axis=-1) * weights
        flat = spectra.view(np.float64).reshape(count, -1)
        out += flat @ flat.T
    return out
