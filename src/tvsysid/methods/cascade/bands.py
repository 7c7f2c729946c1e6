"""Compute the covariance of the coefficients under coloured noise, and their standard errors."""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.methods.cascade.problem import Solution
from tvsysid.models import StandardError
from tvsysid.numerics import Array
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.gaussian import solve
from tvsysid.numerics.noise import autocorrelation


class OneSignError(StandardError):
    """Standard error of an estimate of one sign. Its band has the same sign."""

    def limits(
        self, values: Array, level: float, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        """See :meth:`tvsysid.Estimate.band`."""
        lower, upper = super().limits(values, level, simultaneous)
        return (
            (lower, np.minimum(upper, 0.0))
            if np.nanmin(values) < 0
            else (np.maximum(lower, 0.0), upper)
        )


class Covariance(NamedTuple):
    """Covariance of the columns' coefficients, followed by the free numbers of the shape.

    ``freedom`` is the number of degrees of freedom of the noise variance.
    """

    matrix: Array
    freedom: float

    def error(self, features: Array, known: Array, start: int, one_sign: bool) -> StandardError:
        """Return the standard error of weighted sums of the coefficients from ``start`` on.

        ``features`` (time, coefficient) are the weights. ``known`` is 1, or NaN where the error is.
        """
        columns = slice(start, start + features.shape[1])
        covariance = self.matrix[columns, columns]
        variance = np.einsum("tj,tj->t", features @ covariance, features)
        kind = OneSignError if one_sign else StandardError
        return kind(
            np.sqrt(np.maximum(variance, 0.0)) * known,
            np.array(self.freedom),
            arc_length(features, covariance),
        )


def covariance_of(found: Solution) -> Covariance:
    r"""Return the sandwich covariance of a solution's coefficients.

    .. math:: H^{-1} \left(\Phi^T Q \Sigma Q \Phi + \sigma^4 P^{-1}\right) H^{-1}, \qquad
              H = \Phi^T Q \Phi + \sigma^2 P^{-1}

    The derivatives by the shape are among the columns. P is the prior's covariance, Q the weights
    of the samples, and :math:`\Sigma` the noise's autocovariance within a realization, from what
    is left.
    """
    data, left, precision = found.problem.data, found.left, found.precision()
    freedom = max(1.0, data.number - found.ridge.posterior.effective - len(found.problem.free))
    inverse = solve(found.moments_with_slopes(data, found.moments), precision).covariance
    true = data.weighted(data.noise, autocorrelation(left, 0.0))
    moments = attrs.evolve(found.problem, data=true).moments(found.shape)
    coloured = found.moments_with_slopes(true, moments).gram
    matrix = (
        float(np.sum(left**2)) / freedom * inverse @ coloured @ inverse
        + found.ridge.noise_variance * (inverse * precision) @ inverse
    )
    return Covariance(matrix, freedom)
