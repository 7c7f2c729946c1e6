r"""Linear regression with Gaussian priors, from sums of products.

.. math:: y = X w + e, \qquad e \sim N(0, \sigma^2 I), \qquad w \sim N(0, P^{-1})

A method defines the columns X and computes their :class:`Moments`. The prior precision P is
diagonal. If P and the noise variance are known, :func:`solve` returns the posterior and its
evidence, with gradients. Otherwise, :func:`ridge` and :func:`relevance` choose both by maximum
evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, pinvh

from tvsysid.numerics import Array

Columns = NDArray[np.bool_] | NDArray[np.intp]

SMALLEST_RESIDUAL = 1e-12  # share of the output's power; a smaller residual is rounding error
JITTER = 1e-10  # share of the diagonal that is added to it if a system is numerically singular
TOLERANCE = 1e-7  # change of the log evidence per sample at which iterations stop
TINY = float(np.finfo(np.float64).tiny)


class Moments(NamedTuple):
    """Sums of products of columns X (sample, column) and an output y (sample,).

    ``gram`` is XᵀX, ``cross`` is Xᵀy, and ``square`` is yᵀy. ``number`` is the effective number of
    independent samples. :func:`solve` reads only the lower triangle of ``gram``.
    """

    gram: Array
    cross: Array
    square: float
    number: float

    @classmethod
    def of(cls, products: Array, number: float) -> Moments:
        """Return the moments from the products of the columns [X, y] with each other."""
        return cls(products[:-1, :-1], products[-1, :-1], float(products[-1, -1]), number)

    def take(self, columns: Columns) -> Moments:
        """Return the moments of some columns."""
        # Transposed twice, so that gram is in the column order that LAPACK needs.
        return self._replace(
            gram=self.gram.T[np.ix_(columns, columns)].T, cross=self.cross[columns]
        )

    def times(self, share: float) -> Moments:
        """Return the moments if only this share of the samples is independent."""
        gram, cross, square, number = self
        return Moments(share * gram, share * cross, share * square, share * number)

    def without(self, part: Moments) -> Moments:
        """Return the moments without the samples of ``part``."""
        gram, cross, square, number = part
        return Moments(
            self.gram - gram, self.cross - cross, self.square - square, self.number - number
        )


@attrs.frozen(eq=False)
class Posterior:
    r"""Posterior of the weights for a given prior and noise variance.

    Parameters
    ----------
    mean
        Posterior mean (column,).
    inverse_factor
        Inverse Cholesky factor W of the precision (column, column):
        :math:`W^T W = (X^T X + \sigma^2 P)^{-1}`.
    precision
        Prior precision (column,); 0 for a flat prior.
    noise_variance
        Variance of each sample's noise.
    penalized_residual
        Penalized sum of squared residuals, :math:`\|y - X m\|^2 + \sigma^2 m^T P m`.
    number
        Number of samples.
    """

    mean: Array
    inverse_factor: Array
    precision: Array
    noise_variance: float
    penalized_residual: float
    number: float

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance (column, column)."""
        return self.noise_variance * (self.inverse_factor.T @ self.inverse_factor)

    @property
    def determined(self) -> Array:
        """Return how much of each weight the data determine, from 0 (the prior alone) to 1."""
        variances = np.einsum("ij,ij->j", self.inverse_factor, self.inverse_factor)
        return 1 - self.noise_variance * self.precision * variances

    @property
    def effective(self) -> float:
        """Return the effective number of parameters."""
        return float(self.determined.sum())

    @property
    def residual(self) -> float:
        """Return the sum of squared residuals y - X m."""
        return self.penalized_residual - self.noise_variance * float(self.precision @ self.mean**2)

    @property
    def log_determinant(self) -> float:
        r"""Return :math:`\log|X^T X / \sigma^2 + P| - \log|P|`, flat priors left out of P."""
        prior = np.where(self.precision > 0, self.precision, 1.0)
        diagonal = self.inverse_factor.diagonal()
        return -float(np.log(diagonal**2 * prior * self.noise_variance).sum())

    @property
    def log_evidence(self) -> float:
        r"""Return the log marginal likelihood of y.

        .. math:: -\tfrac12 \left[(N - f) \log 2\pi + N \log \sigma^2
                  + \log\frac{|X^T X / \sigma^2 + P|}{|P|}
                  + \frac{\|y - X m\|^2}{\sigma^2} + m^T P m \right]

        The f weights with a flat prior are integrated out with unit density (restricted
        likelihood).
        """
        proper = self.number - np.count_nonzero(self.precision == 0)
        return -0.5 * (
            proper * math.log(2 * math.pi)
            + self.number * math.log(self.noise_variance)
            + self.log_determinant
            + self.penalized_residual / self.noise_variance
        )

    @property
    def variance_gradient(self) -> Array:
        """Return the derivatives of the log evidence with respect to the log prior variances."""
        slopes = 0.5 * (self.precision * self.mean**2 - self.determined)
        return np.where(self.precision > 0, slopes, 0.0)

    @property
    def noise_gradient(self) -> float:
        """Return the derivative of the log evidence with respect to the log noise variance."""
        return 0.5 * (self.residual / self.noise_variance - (self.number - self.effective))


def solve(moments: Moments, precision: Array, noise_variance: float = 1.0) -> Posterior:
    """Return the posterior of the weights under a prior ``precision`` (column,); 0 is flat.

    Examples
    --------
    >>> columns, output = np.array([[1.0], [1.0], [1.0]]), np.array([2.0, 3.0, 4.0])
    >>> moments = Moments(columns.T @ columns, columns.T @ output, output @ output, 3)
    >>> solve(moments, precision=np.zeros(1)).mean
    array([3.])
    """
    # Columns are not scaled first: their units do not affect the accuracy of a Cholesky factor.
    for jitter in (0.0, JITTER):  # the second allows numerically collinear columns
        system = np.array(moments.gram, order="F")
        diagonal = system.ravel(order="F")[:: len(system) + 1]
        diagonal += noise_variance * precision + jitter * diagonal
        factor, failed = lapack.dpotrf(system, lower=1, overwrite_a=1)
        if not failed:
            break
    else:
        raise np.linalg.LinAlgError("the posterior precision is not positive definite")
    mean = lapack.dpotrs(factor, moments.cross, lower=1)[0]
    inverse_factor = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
    penalized = moments.square - float(mean @ moments.cross)
    return Posterior(mean, inverse_factor, precision, noise_variance, penalized, moments.number)


class FittedWeights(NamedTuple):
    """Posterior of the weights, with the noise variance estimated from the data.

    ``effective`` is the effective number of parameters. ``log_evidence`` is NaN if the
    prior was not chosen by maximum evidence.
    """

    mean: Array
    covariance: Array
    noise_variance: float
    effective: float
    log_evidence: float = math.nan


def least_squares(moments: Moments) -> FittedWeights:
    """Fit without a prior. The weights have minimum norm where the columns are collinear."""
    gram, cross, square, number = moments
    scale = np.sqrt(_powers(gram) / number)
    scales = np.outer(scale, scale)
    inverse, rank = pinvh(gram / scales, return_rank=True)
    covariance = inverse / scales
    mean = covariance @ cross
    residual = square - 2 * float(mean @ cross) + float(mean @ gram @ mean)
    noise = max(residual, SMALLEST_RESIDUAL * square) / max(number - rank, 1)
    return FittedWeights(mean, covariance * noise, noise, float(rank))


def by_instruments(
    fit: FittedWeights,
    surplus: Array,
    residual: Callable[[Array], float],
    number: float,
) -> FittedWeights:
    r"""Turn weights of a regression on instruments Z into those of columns X, which contain noise.

    The ``fit`` is the regression of y on Z. It has the posterior mean m and covariance C for a
    noise variance s. The weights follow from them for any prior P:

    .. math:: (Z^T X + s P)\, \hat w = Z^T y \iff \hat w = M m, \qquad
              M = (1 + C\, Z^T (X - Z) / s)^{-1}

    Their covariance is :math:`\sigma^2 M C M^T / s`. Weights that the prior pruned stay 0.

    Parameters
    ----------
    surplus
        :math:`Z^T (X - Z)`, (column, column).
    residual
        Function that returns the sum of squares of y - X w.
    number
        Number of samples, for :math:`\sigma^2`.
    """
    gain = fit.covariance / fit.noise_variance
    transform = np.linalg.inv(np.eye(len(gain)) + gain @ surplus)
    mean = transform @ fit.mean
    noise = residual(mean) / max(number - fit.effective, 1.0)
    covariance = noise * (transform @ gain @ transform.T)
    return FittedWeights(mean, covariance, noise, fit.effective, fit.log_evidence)


def ridge(moments: Moments) -> FittedWeights:
    r"""Choose one prior precision for all weights by maximum evidence.

    .. math:: \gamma = \sum_k \frac{\beta s_k}{\alpha + \beta s_k}, \quad
              \alpha \leftarrow \frac{\gamma}{m^T m}, \quad
              \beta \leftarrow \frac{N - \gamma}{\|y - X m\|^2}

    This is MacKay's fixed point (Bishop 2006, section 3.5) for :math:`P = \alpha I` and
    :math:`\sigma^2 = 1 / \beta`, with s the eigenvalues of XᵀX. The columns must have one unit, or
    be scaled so that one prior suits them all.
    """
    gram, cross, square, number = moments
    values, vectors = np.linalg.eigh(gram)
    values, projections = np.maximum(values, 0.0), vectors.T @ cross
    floor, rounding = SMALLEST_RESIDUAL * square, len(values) * np.finfo(float).eps * values[-1]
    start = np.divide(projections, values, out=np.zeros(len(values)), where=values > rounding)
    alpha = len(values) / float(start @ start)
    beta = number / max(square - float(start @ projections), floor)
    evidence = -math.inf
    for _ in range(500):
        precision = alpha + beta * values
        mean = beta * projections / precision
        norm = float(mean @ mean)
        gamma = float(np.sum(beta * values / precision))
        residual = max(square - 2 * float(mean @ projections) + float(values @ mean**2), floor)
        before = evidence
        evidence = 0.5 * (
            len(values) * math.log(alpha)
            + number * math.log(beta / (2 * math.pi))
            - beta * residual
            - alpha * norm
            - float(np.sum(np.log(precision)))
        )
        # Iterations cost little here, so the tolerance is close to the rounding error.
        if abs(evidence - before) <= 1e-14 * abs(evidence):
            break
        alpha, beta = gamma / norm, max(number - gamma, 1.0) / residual
    root = vectors / np.sqrt(precision)
    return FittedWeights(vectors @ mean, root @ root.T, 1 / beta, gamma, evidence)


def relevance(moments: Moments) -> FittedWeights:
    r"""Choose a prior precision for each weight by maximum evidence. Most become zero.

    .. math:: \gamma_i = 1 - \alpha_i C_{ii}, \quad
              \alpha_i \leftarrow \frac{\gamma_i}{m_i^2}, \quad
              \sigma^2 \leftarrow \frac{\|y - X m\|^2}{N - \sum_i \gamma_i}

    This is the relevance vector machine: P is the diagonal matrix of :math:`\alpha`, C the
    posterior covariance (Tipping 2001, Journal of Machine Learning Research 1; Bishop 2006, section
    7.2). The iteration starts from least squares, so the result is deterministic. The units of the
    columns have no effect.
    """
    square, number = moments.square, moments.number
    powers = _powers(moments.gram)
    start = solve(moments, 1e-12 * powers)  # almost least squares; defined for collinear columns
    precision = 1 / np.maximum(start.mean**2, 1e-12 * square / powers)
    noise = max(start.residual, SMALLEST_RESIDUAL * square) / number
    active, evidence = np.arange(len(powers)), -math.inf
    for _ in range(1000):
        found = solve(moments.take(active), precision, noise)
        before, evidence = evidence, found.log_evidence
        determined = np.clip(found.determined, 1e-12, 1.0)
        effective = float(determined.sum())
        noise = max(found.residual, SMALLEST_RESIDUAL * square) / max(number - effective, 1.0)
        precision = determined / np.maximum(found.mean**2, TINY)
        # A prior 100 times narrower than the weight's standard error fixes the weight at zero.
        kept = precision < 1e4 * powers[active] / noise
        if abs(evidence - before) <= TOLERANCE * number or not kept.any():
            break
        active, precision = active[kept], precision[kept]
    mean, covariance = np.zeros(len(powers)), np.zeros_like(moments.gram)
    mean[active], covariance[np.ix_(active, active)] = found.mean, found.covariance
    return FittedWeights(mean, covariance, noise, effective, evidence)


PRIORS: dict[str, Callable[[Moments], FittedWeights]] = {
    "ard": relevance,
    "ridge": ridge,
    "none": least_squares,
}


def _powers(gram: Array) -> Array:
    """Return the sum of squares of each column; 1 for a column of zeros."""
    powers = np.diag(gram)
    return np.where(powers > 0, powers, 1.0)
