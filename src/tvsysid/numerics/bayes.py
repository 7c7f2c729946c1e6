"""Bayesian linear regression from sufficient statistics, priors chosen by maximum evidence.

``gram`` is :math:`G = X^T X`, ``cross`` :math:`c = X^T y`, ``square`` :math:`y^T y`, ``samples``
the length N of y.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from tvsysid.numerics import Array


class Posterior(NamedTuple):
    """What is known of the coefficients after the data.

    ``effective`` is the number of parameters that the data determine, ``log_evidence`` NaN
    without a prior.
    """

    mean: Array
    covariance: Array
    noise_variance: float
    effective: float
    log_evidence: float
    iterations: int
    converged: bool


Regression = Callable[[Array, Array, float, int], Posterior]

SMALLEST_RESIDUAL = 1e-12  # share of the output's power below which a residual is rounding
# change of the log evidence for each sample at which iterations stop; the same whatever the units
# are
TOLERANCE = 1e-7


def least_squares(gram: Array, cross: Array, square: float, samples: int) -> Posterior:
    r"""Ordinary least squares: :math:`\hat w = G^{-1} c`, of minimum norm where G is singular."""
    scale = _column_scale(gram, samples)
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    inverse = _reciprocal(values)
    covariance = (vectors * inverse) @ vectors.T / np.outer(scale, scale)
    mean = covariance @ cross
    rank = int(np.count_nonzero(inverse))
    noise = _residual(gram, cross, square, mean) / max(samples - rank, 1)
    return Posterior(mean, covariance * noise, noise, float(rank), math.nan, 1, True)


def ridge(gram: Array, cross: Array, square: float, samples: int) -> Posterior:
    r"""One precision for all coefficients, by evidence maximisation (MacKay's fixed point.

    Bishop 2006, section 3.5).

    .. math:: w \sim N(0, \alpha^{-1} I), \quad y \sim N(Xw, \beta^{-1} I), \quad
              \gamma = \sum_k \frac{\beta s_k}{\alpha + \beta s_k}, \quad
              \alpha \leftarrow \frac{\gamma}{m^T m}, \quad
              \beta \leftarrow \frac{N - \gamma}{\|y - Xm\|^2}

    with s the eigenvalues of G, found once. The coefficients must be of one unit, or the columns
    scaled so that one prior suits them all.
    """
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    projections = vectors.T @ cross
    start = projections * _reciprocal(values)
    alpha = len(values) / max(float(start @ start), np.finfo(float).tiny)
    beta = samples / max(
        square - float(start @ projections), SMALLEST_RESIDUAL * square, np.finfo(float).tiny
    )
    evidence = -math.inf
    for iteration in range(1, 501):
        precision = alpha + beta * values
        mean = beta * projections / precision
        norm = max(float(mean @ mean), np.finfo(float).tiny)
        gamma = float(np.sum(beta * values / precision))
        residual = square - 2 * float(mean @ projections) + float(mean @ (values * mean))
        residual = max(residual, SMALLEST_RESIDUAL * square)
        before = evidence
        evidence = 0.5 * (
            len(values) * math.log(alpha)
            + samples * math.log(beta / (2 * math.pi))
            - beta * residual
            - alpha * norm
            - float(np.sum(np.log(precision)))
        )
        # An iteration costs next to nothing here, so it goes on until the last digits stand.
        if converged := abs(evidence - before) <= 1e-14 * abs(evidence):
            break
        alpha, beta = gamma / norm, max(samples - gamma, 1.0) / residual
    covariance = (vectors / precision) @ vectors.T
    return Posterior(vectors @ mean, covariance, 1 / beta, gamma, evidence, iteration, converged)


def relevance(gram: Array, cross: Array, square: float, samples: int) -> Posterior:
    r"""Estimate coefficients by the relevance vector machine: one prior precision for each.

    Coefficients that explain nothing are pruned.

    .. math:: w_i \sim N(0, \alpha_i^{-1}), \quad
              \Sigma = (\beta G + \mathrm{diag}\,\alpha)^{-1}, \quad
              m = \beta \Sigma c, \quad \gamma_i = 1 - \alpha_i \Sigma_{ii}, \quad
              \alpha_i \leftarrow \frac{\gamma_i}{m_i^2}, \quad
              \beta \leftarrow \frac{N - \sum_i \gamma_i}{\|y - Xm\|^2}

    (Tipping 2001, Journal of Machine Learning Research 1; Bishop 2006, section 7.2). Starts from
    the least-squares solution, so that it is deterministic and needs few iterations. Scaling a
    column scales its coefficient and changes nothing else.
    """
    scale = _column_scale(gram, samples)
    unit = math.sqrt(square / samples) or 1.0  # the output's RMS
    gram = gram / np.outer(scale, scale)
    cross = cross / (scale * unit)
    square /= unit**2
    start = _solve(gram, cross)
    alpha = 1 / np.maximum(start**2, 1e-12)
    beta = samples / _residual(gram, cross, square, start)
    active = np.arange(len(cross))
    evidence = -math.inf
    for iteration in range(1, 1001):
        sub, right = gram[np.ix_(active, active)], cross[active]
        sigma, log_determinant = _inverse(beta * sub + np.diag(alpha))
        mean = beta * (sigma @ right)
        residual = _residual(sub, right, square, mean)
        before = evidence
        evidence = 0.5 * (
            float(np.sum(np.log(alpha)))
            + samples * math.log(beta / (2 * math.pi * unit**2))
            - beta * residual
            - float(alpha @ mean**2)
            - log_determinant
        )
        gamma = np.clip(1 - alpha * np.diag(sigma), 1e-12, 1.0)
        if converged := abs(evidence - before) <= TOLERANCE * samples:
            break
        alpha = gamma / np.maximum(mean**2, np.finfo(float).tiny)
        beta = max(samples - float(gamma.sum()), 1.0) / residual
        # A coefficient whose prior is this much narrower than the noise on it stays zero.
        keep = alpha < 1e4 * beta * samples
        active, alpha = active[keep], alpha[keep]
        if not len(active):
            mean, sigma, gamma, residual = np.zeros(0), np.zeros((0, 0)), np.zeros(0), square
            converged = True
            break
    everywhere = np.ix_(active, active)
    weights, covariance = np.zeros(len(cross)), np.zeros_like(gram)
    weights[active] = mean
    covariance[everywhere] = sigma
    return Posterior(
        weights * unit / scale,
        covariance * unit**2 / np.outer(scale, scale),
        unit**2 * residual / max(samples - float(gamma.sum()), 1.0),
        float(gamma.sum()),
        evidence,
        iteration,
        converged,
    )


PRIORS: dict[str, Regression] = {"ard": relevance, "ridge": ridge, "none": least_squares}


def _column_scale(gram: Array, samples: int) -> Array:
    """RMS of each column of X; 1 for a column of zeros."""
    power = np.diag(gram) / samples
    return np.sqrt(np.where(power > 0, power, 1.0))


def _reciprocal(values: Array) -> Array:
    """1 / eigenvalue, they being in rising order; 0 where that is rounding."""
    floor = len(values) * np.finfo(float).eps * values[-1]
    return np.where(values > floor, 1 / np.where(values > floor, values, 1.0), 0.0)


def _residual(gram: Array, cross: Array, square: float, mean: Array) -> float:
    """Squared length of y - X m, no less than rounding."""
    return max(
        square - 2 * float(mean @ cross) + float(mean @ gram @ mean), SMALLEST_RESIDUAL * square
    )


def _solve(gram: Array, cross: Array) -> Array:
    """Solution of G w = c, of minimum norm where G is singular to rounding."""
    factor, failed = lapack.dpotrf(gram, lower=1)
    diagonal = np.diag(factor)
    if not failed and diagonal.min() > 1e-7 * diagonal.max():
        return np.asarray(lapack.dpotrs(factor, cross, lower=1)[0])
    values, vectors = np.linalg.eigh(gram)
    inverse = _reciprocal(values)
    return np.asarray(vectors @ (inverse * (vectors.T @ cross)))


def _inverse(matrix: Array) -> tuple[Array, float]:
    """Inverse and log determinant of a symmetric positive definite matrix."""
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if failed:  # only by rounding: a little more prior precision mends it
        factor, failed = lapack.dpotrf(matrix + 1e-10 * np.diag(np.diag(matrix)), lower=1)
        if failed:
            raise np.linalg.LinAlgError("posterior precision is not positive definite")
    inverse = lapack.dpotri(factor, lower=1)[0]
    lower = np.tril(inverse)
    return lower + np.tril(lower, -1).T, 2 * float(np.sum(np.log(np.diag(factor))))
