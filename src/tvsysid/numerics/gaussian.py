r"""Linear regression with a known Gaussian prior, from sufficient statistics.

The noise variance is estimated.

.. math:: y = X w + T f + e, \qquad \min_{w, f} \|e\|^2 / \sigma^2 + w^T P w + q f^T f

``precision`` is the diagonal of P, 0 for a column without prior; ``weak`` is q, the prior
precision of each nuisance term. The cost is the negative log of a posterior density without the
usual halves: y holds the parts of complex numbers, whose variance :math:`\sigma^2`, ``noise``,
is twice that of a number of y.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from tvsysid.numerics import Array

# relative change of the noise variance from which on another step, some 1e-4 of it, needs no new
# factors
STANDS = 1e-4
ITERATIONS = 30  # noise variances tried at most


class Statistics(NamedTuple):
    """What is needed of the data: products of X, y and T, the nuisance terms, which are orthogonal.

    ``gram`` XᵀX, of which only the lower triangle counts, Fortran-ordered; ``cross`` Xᵀy;
    ``square`` yᵀy; ``number``, the length of y, or what it is worth; ``mixed`` XᵀT; ``shared``
    Tᵀy; ``powers``, the diagonal of TᵀT.
    """

    gram: Array
    cross: Array
    square: float
    number: float
    mixed: Array
    shared: Array
    powers: Array


class Fit(NamedTuple):
    """Posterior ``mean`` of the weights; ``effective``, the parameters that the data determine.

    Their ``covariance`` takes about as long as the fit, and is worked out when it is asked for.
    """

    mean: Array
    noise_variance: float
    effective: float
    iterations: int
    inverse_factor: Array
    scale: Array

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance (column, column).

        It follows from the inverse Cholesky factor of the precision of the scaled columns.
        """
        lower = lapack.dlauum(self.inverse_factor, lower=1)[0]
        lower += np.tril(lower, -1).T
        lower *= np.outer(0.5 * self.noise_variance * self.scale, self.scale)
        return np.asarray(lower)


def fit(statistics: Statistics, precision: Array, weak: float) -> Fit:
    r"""Weights and the noise variance that they leave.

    .. math:: S = T^T T + \sigma^2 q, \qquad
              (X^T X + \sigma^2 P - X^T T S^{-1} T^T X)\, \hat w
              = X^T y - X^T T S^{-1} T^T y, \qquad
              \sigma^2 = \frac{2 \|\hat e\|^2}{N - N_{eff}}

    a fixed point, found by secants in the logarithm of the noise variance.
    """
    scaled, scale = _scaled(statistics)
    precision, floor = precision * scale**2, _floor(statistics)
    noise, slope, before = max(0.02 * statistics.square / statistics.number, floor), -1.0, None
    for iteration in range(1, ITERATIONS + 1):
        solution = _solve(scaled, precision, weak, noise)
        freedom = max(statistics.number - solution.effective, 1.0)
        wanted = max(2 * max(solution.residual, 0.0) / freedom, floor)
        place, gap = math.log(noise), math.log(wanted / noise)
        if abs(gap) <= STANDS:
            break
        if before is not None and place != before[0]:
            slope = (gap - before[1]) / (place - before[0])
        # Where the secant is no help, the plain step.
        step = -gap / slope if slope < -0.1 else gap
        before = place, gap
        noise = max(math.exp(place + min(max(step, -7.0), 7.0)), floor)
    return Fit(
        solution.mean * scale, noise, solution.effective, iteration, solution.inverse_factor, scale
    )


class InstrumentalFit(NamedTuple):
    r"""As :class:`Fit`.

    The ``covariance`` is :math:`\tfrac12\sigma^2 A^{-1} (Z^T Z + \sigma^2 P) A^{-T}`.
    """

    mean: Array
    noise_variance: float
    effective: float
    iterations: int
    covariance: Array


def instrumental(both: Statistics, precision: Array, weak: float) -> InstrumentalFit:
    r"""Estimate weights of regressors X that noise moves, too, by instruments Z.

    The instruments take the place of X in the left factor:

    .. math:: A\, \hat w = Z^T y - Z^T T S^{-1} T^T y, \qquad
              A = Z^T X - Z^T T S^{-1} T^T X + \sigma^2 P

    with S as in :func:`fit`, and the noise variance of the residual y - X w. The columns of
    ``both`` are those of X, then as many of Z.
    """
    count, (both, scale) = len(precision), _scaled(both)
    of_x, of_z = scale[:count], scale[count:]
    gram = np.tril(both.gram) + np.tril(both.gram, -1).T
    noise, system = max(0.02 * both.square / both.number, _floor(both)), precision * of_x * of_z
    for iteration in range(1, ITERATIONS + 1):
        shrink = 1 / (both.powers + noise * weak)
        left = (
            gram[count:] - (both.mixed[count:] * shrink) @ both.mixed.T
        )  # of Z with X and Z, less the nuisance
        inverse = np.linalg.inv(left[:, :count] + np.diag(noise * system))
        mean = inverse @ (both.cross[count:] - both.mixed[count:] @ (shrink * both.shared))
        unshared = both.shared - mean @ both.mixed[:count]
        residual = (
            both.square
            - 2 * float(mean @ both.cross[:count])
            + float(mean @ gram[:count, :count] @ mean)
        )
        residual += float(np.sum(shrink * unshared**2 * (both.powers * shrink - 2)))
        effective = (
            count - noise * float(system @ np.diag(inverse)) + float(np.sum(both.powers * shrink))
        )
        before, noise = noise, max(2 * residual / max(both.number - effective, 1.0), _floor(both))
        if abs(noise / before - 1) <= STANDS:
            break
    spread = left[:, count:] + np.diag(noise * precision * of_z**2)
    covariance = 0.5 * noise * np.outer(of_x, of_x) * (inverse @ spread @ inverse.T)
    return InstrumentalFit(mean * of_x, noise, effective, iteration, covariance)


class LogDensity(NamedTuple):
    """Log density of the data, and its derivatives.

    ``by_variances`` (column,) are those by the log prior variances, ``by_noise`` is that by the
    log noise variance.
    """

    value: float
    by_variances: Array
    by_noise: float


def log_evidence(statistics: Statistics, precision: Array, weak: float, noise: float) -> LogDensity:
    r"""Log marginal likelihood of the data for given prior and noise variances.

    .. math:: y \sim N\left(F b,\ \tfrac12 D\right), \qquad
              D = \sigma^2 I + Z W Z^T + T T^T / q

    with Z the columns that have a prior, W their prior variances, and F the f columns that have
    none, whose weights b are integrated out with unit density (restricted likelihood). With Q,
    :math:`D^{-1}` projected on what they leave,

    .. math:: \log p = -\tfrac{N - f}{2} \log\pi - \tfrac12 \log|D|
              - \tfrac12 \log|F^T D^{-1} F| - y^T Q y

    Where the derivative by the noise vanishes, :func:`fit` stands still.
    """
    scaled, scale = _scaled(statistics)
    scaled_precision = precision * scale**2
    solution = _solve(scaled, scaled_precision, weak, noise)
    fixed = precision == 0
    terms = len(statistics.powers)
    determinant = (
        (statistics.number - len(precision) - terms) * math.log(noise)
        - float(np.sum(np.log(precision[~fixed])))
        - terms * math.log(weak)
        + float(np.sum(np.log(statistics.powers + noise * weak)))
        - 2 * float(np.sum(np.log(np.diag(solution.inverse_factor))))
        - 2 * float(np.sum(np.log(scale)))
    )
    shrink = 1 / (statistics.powers + noise * weak)
    right = scaled.cross - scaled.mixed @ (shrink * statistics.shared)
    quadratic = (
        statistics.square
        - float(np.sum(shrink * statistics.shared**2))
        - float(right @ solution.mean)
    )
    left = statistics.number - int(fixed.sum())
    known = 1 - noise * scaled_precision * solution.variances
    return LogDensity(
        -0.5 * (left * math.log(math.pi) + determinant) - quadratic / noise,
        np.where(fixed, 0.0, scaled_precision * solution.mean**2 - 0.5 * known),
        solution.residual / noise - 0.5 * (statistics.number - solution.effective),
    )


def unit_information(statistics: Statistics, noise: float) -> float:
    r"""Return the log density of a unit-information prior of columns F at its mean.

    The mean is the estimate from the data.

    A restricted likelihood, in which the weights of F have unit density, is measured in their
    units, and cannot be compared with one of other columns. Under a prior that tells as much of b
    as one of the N numbers does under white noise of the variance :math:`\sigma_0^2`, one for all
    models that are compared, it can:

    .. math:: b \sim N\left(\hat b,\ N J^{-1}\right), \qquad J = \frac{2}{\sigma_0^2} F^T F, \qquad
              \log\pi(\hat b) = \tfrac12 \log|F^T F| - \tfrac f2 \log(\pi N \sigma_0^2)

    As it is nearly flat where the likelihood is not small, the likelihood under it is the
    restricted one times this density, to about f / (2 N) where columns with a prior cannot take
    the place of F. What it costs to fit a constant is then half log N, as in Schwarz's criterion
    (Kass & Wasserman 1995). There are no nuisance terms.
    """
    gram = np.tril(statistics.gram) + np.tril(statistics.gram, -1).T
    power = math.log(math.pi * statistics.number * noise)
    return 0.5 * (float(np.linalg.slogdet(gram)[1]) - len(gram) * power)


def of_columns(statistics: Statistics, chosen: NDArray[np.bool_]) -> Statistics:
    """Statistics of some of the columns of X."""
    return statistics._replace(
        gram=np.asfortranarray(statistics.gram[np.ix_(chosen, chosen)]),
        cross=statistics.cross[chosen],
        mixed=statistics.mixed[chosen],
    )


def of_share(statistics: Statistics, share: float) -> Statistics:
    """What a share of the numbers would tell, alike: for numbers that are not independent.

    Without nuisance terms.
    """
    gram, cross, square, number, *nuisance = statistics
    return Statistics(share * gram, share * cross, share * square, share * number, *nuisance)


def without_nuisance(statistics: Statistics, weak: float, noise: float) -> Statistics:
    r"""Return statistics without the nuisance terms, for noise variances near :math:`\sigma_0^2`.

    The terms are eliminated once for all these variances. Their prior variance is taken to be
    :math:`\sigma^2 / (q \sigma_0^2)`, so that what they leave of the data does not depend on the
    noise variance. That is little, as a rule: what the terms can explain is then lost whatever the
    noise. The log evidence is less than that of the whole by the log of a constant.
    """
    gram, cross, square, number, mixed, shared, powers = statistics
    shrink = 1 / (powers + noise * weak)
    gram = blas.dsyrk(-1.0, mixed * np.sqrt(shrink), beta=1.0, c=gram, lower=1)
    square -= float(np.sum(shrink * shared**2))
    cross = cross - mixed @ (shrink * shared)
    return Statistics(
        gram, cross, square, number, np.zeros((len(cross), 0)), np.zeros(0), np.zeros(0)
    )


class _Solution(NamedTuple):
    """Weights; the inverse of the system's Cholesky factor, and its columns' squares.

    What is left, and determined.
    """

    mean: Array
    inverse_factor: Array
    variances: Array
    residual: float
    effective: float


def _scaled(statistics: Statistics) -> tuple[Statistics, Array]:
    """Statistics of columns of unit length, and what each was multiplied by."""
    diagonal = np.diag(statistics.gram)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = statistics._replace(
        gram=statistics.gram
        * np.outer(scale, scale).T,  # Fortran-ordered, as BLAS takes it without a copy
        cross=statistics.cross * scale,
        mixed=statistics.mixed * scale[:, None],
    )
    return scaled, scale


def _floor(statistics: Statistics) -> float:
    return 2e-14 * statistics.square / statistics.number


def _solve(statistics: Statistics, precision: Array, weak: float, noise: float) -> _Solution:
    gram, cross, square, _, mixed, shared, powers = statistics
    shrink = 1 / (powers + noise * weak)
    explained = mixed * np.sqrt(shrink)
    right = cross - mixed @ (shrink * shared)
    system = (
        blas.dsyrk(-1.0, explained, beta=1.0, c=gram, lower=1)
        if len(powers)
        else gram.copy(order="F")
    )
    system.ravel(order="A")[:: len(system) + 1] += noise * precision
    factor, failed = lapack.dpotrf(system, lower=1)
    if failed:  # columns without power, or alike to rounding
        factor, _ = lapack.dpotrf(system + 1e-11 * np.eye(len(system)), lower=1)
    mean = lapack.dpotrs(factor, right, lower=1)[0]
    inverse_factor = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
    variances = np.einsum("ij,ij->j", inverse_factor, inverse_factor)
    effective = len(mean) - noise * float(precision @ variances)
    left = shared - mean @ mixed
    terms = shrink * left
    # The quadratic form in the Gram matrix, by what the system does to the mean.
    quadratic = (
        float(mean @ right)
        - noise * float(precision @ mean**2)
        + float(np.sum((mean @ explained) ** 2))
    )
    residual = (
        square
        - 2 * float(mean @ cross)
        + quadratic
        + float(np.sum(terms * (powers * terms - 2 * left)))
    )
    spread = float(np.sum(shrink))
    if len(powers):
        spread += float(np.sum(blas.dtrmm(1.0, inverse_factor, mixed * shrink, lower=1) ** 2))
    return _Solution(
        mean, inverse_factor, variances, residual, effective + len(powers) - noise * weak * spread
    )
