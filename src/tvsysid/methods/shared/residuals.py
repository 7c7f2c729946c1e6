"""What a fit leaves unexplained: how strong the noise is, what colour it has, and the standard errors that follow."""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np
from scipy.linalg import toeplitz

from tvsysid.methods.base import padded
from tvsysid.models import IMPEDANCE, StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.noise import (
    angle_products,
    autocovariance,
    colour_factors,
    cross_covariance,
    power_in_band,
    regressor_correlation,
    regressor_covariances,
    white_share,
)
from tvsysid.numerics.second_order import agreement_of_moments
from tvsysid.signals import Array, Ensemble

# seconds up to which the noise's autocorrelation counts; the angle's own hardly reaches further
LONGEST_COLOUR = 0.25
LEAST_LEFT = 0.1  # share of the noise that a residual is taken to hold at least
# share of white noise's power in a band below which an autocorrelation is too coarse to tell it
LEAST_POWER = 1e-3


def independent_realizations(ensemble: Ensemble) -> int:
    """How many realizations' worth of noise an ensemble holds at each time.

    One less where the mean over them was subtracted: what is fitted then is a regression with an
    intercept at each time.
    """
    return max(1, len(ensemble) - ensemble.mean_subtracted)


def counted(ensemble: Ensemble) -> str:
    """How many realizations there are and what they are worth, in words."""
    count, independent = len(ensemble), independent_realizations(ensemble)
    words = f"{count} realization{'s' * (count > 1)}"
    return (
        words
        if independent == count
        else f"{words} ({independent} independent, as their mean is subtracted)"
    )


def independent_share(ensemble: Ensemble, predicted: Array, band: tuple[float, float]) -> float:
    """How many independent samples a sample is worth for stiffness: what is left unexplained is not white.

    ``predicted`` is the torque (realization, time) by some model, ``band`` the frequencies in Hz
    that are fitted; see
    :func:`tvsysid.numerics.noise.white_share`.
    """
    known = np.isfinite(predicted).all(axis=0)
    angle, torque = (x[:, ensemble.core] for x in (ensemble.angle, ensemble.torque))
    return white_share(
        (torque - predicted)[:, known], angle[:, known], ensemble.sampling_rate, band
    )


def residual(ensemble: Ensemble, weights: Array) -> Array:
    """Torque (realization, time) that weights on lagged angles, shape (time, lag), leave.

    The weights are an impulse response times the sample time, at the times whose lags lie within
    the context.
    """
    lags = weights.shape[1] // 2
    first = max(0, ensemble.context - lags)
    angle, torque = (x[:, first : x.shape[1] - first] for x in (ensemble.angle, ensemble.torque))
    fit = convolve_lags(angle, weights)
    return np.subtract(torque[:, lags : torque.shape[1] - lags], fit, out=fit)


def noise_correlation(covariance: Array, taken: Array) -> Array:
    """Autocorrelation of the noise from the autocovariance of what a fit left of it, shape (lag,).

    ``taken`` says by how much the fit lowers the autocovariance at each lag, as shares of the
    noise's variance.
    """
    if covariance[0] <= 0:
        return np.asarray(np.arange(len(taken)) == 0, dtype=np.float64)
    variance = covariance[0] / max(1 - taken[0], LEAST_LEFT)
    return np.asarray(np.concatenate([[1.0], covariance[1:] / variance + taken[1:]]))


class Colour(NamedTuple):
    """What the noise's colour makes of the variances of a fit, worked out from small statistics when asked.

    ``covariance`` (lag,) of the residual; ``taken``, the share of the noise's power that the fit
    took, were its regressors the same at all lags, (lag,) or one for all; ``filters``
    (regressor, tap) that give the regressors from lagged angles; the angle's ``products`` along
    the diagonals.
    """

    covariance: Array
    taken: Array | float
    filters: Array
    products: Array

    @classmethod
    def of(
        cls, ensemble: Ensemble, left: Array, taken: Array | float, filters: Array, products: Array
    ) -> Colour:
        """Colour of a residual (realization, time), and of an angle with these :func:`colour_products`.

        ``taken`` is the share of noise whose mean over realizations, if it was subtracted, is
        not missing.
        """
        lags = colour_lags(ensemble)
        share = taken * len(ensemble) / independent_realizations(ensemble)
        return cls(autocovariance(left, lags), share, filters, products)

    def noise_and_factors(self, seen: Array | float = 1.0) -> tuple[Array, Array]:
        """Autocorrelation of the noise (lag,), and variances of the fit as multiples of those under white noise.

        ``seen`` is the share of the products of noise at each lag that the fit sees.
        """
        regressors = regressor_covariances(self.filters, self.products)
        noise = noise_correlation(
            self.covariance, np.asarray(self.taken * regressor_correlation(regressors))
        )
        return noise, colour_factors(regressors, noise * seen)


def colour_lags(ensemble: Ensemble) -> int:
    """Samples over which the noise's autocorrelation counts: no more than a realization has."""
    return min(round(LONGEST_COLOUR * ensemble.sampling_rate), int(ensemble.angle.shape[1]))


def colour_products(ensemble: Ensemble, width: int = 2 * HALF_WIDTH + 1) -> Array:
    """Moments of the angle along the diagonals as far as so wide filters and the noise's colour need them."""
    return angle_products(ensemble.angle, width, colour_lags(ensemble))


def angle_covariance(ensemble: Ensemble, products: Array, lags: int) -> Array:
    """Autocovariance of the angle (lag,), from its :func:`colour_products` where they reach."""
    samples = ensemble.angle.shape[1]
    if lags < products.shape[1] and len(products) == samples:
        return np.asarray(products[:, : lags + 1].sum(axis=0) / samples)
    return autocovariance(ensemble.angle, lags)


def agreement_of(fit: Array, left: Array, angle: Array, covariance: Array) -> float:
    """Agreement of a fit that ``left`` something of the torque, both (realization, time).

    ``angle`` is that at the same times, ``covariance`` (2 lags + 1,) its autocovariance; see
    :func:`tvsysid.numerics.second_order.agreement_of_moments`.
    """
    cross = cross_covariance(angle, left, len(covariance) // 2)
    return agreement_of_moments(
        _mean_square(fit), cross, toeplitz(covariance), _mean_square(left), left.size
    )


def _mean_square(x: Array) -> float:
    return float(np.einsum("rt,rt->", x, x)) / x.size


@attrs.frozen(eq=False)
class PosteriorErrors:
    """Standard errors of known functions of time from the posterior of their coefficients, and from the noise's colour.

    The posterior takes the noise as white; ``colour`` is None if it is. ``expansions`` are
    functions of time (time, function) of stiffness, viscosity and inertia, as far as the model
    has them, ``covariances`` those of their coefficients, ``band`` the edges in cycles per
    sample of the band that was fitted. The noise is so much ``stronger`` than the posterior
    knows. Of the ``times`` of a realization so many at either end are ``missing``.
    """

    expansions: tuple[Array, ...]
    covariances: tuple[Array, ...]
    colour: Colour | None
    band: tuple[float, float]
    stronger: float
    freedom: float
    times: int
    missing: int

    def standard_errors(self) -> dict[str, StandardError]:
        """By quantity, with the arcs of simultaneous bands."""
        if self.colour is None:
            factors = np.full(len(self.expansions), self.stronger)
        else:
            noise, factors = self.colour.noise_and_factors()
            factors *= self.stronger / max(power_in_band(noise, *self.band), LEAST_POWER)
        errors = {
            name: StandardError.none(
                self.times, f"the model has no {name} (order {len(factors) - 1})"
            )
            for name in IMPEDANCE[len(factors) :]
        }
        parts = zip(IMPEDANCE, factors, self.expansions, self.covariances, strict=False)
        for name, factor, expansion, covariance in parts:
            variance = factor * np.einsum(
                "tj,jk,tk->t", expansion, covariance, expansion, optimize=True
            )
            values = padded(np.sqrt(np.maximum(variance, 0.0)), (self.times - len(expansion)) // 2)
            values[: self.missing] = values[self.times - self.missing :] = np.nan
            errors[name] = StandardError(
                values, np.array(self.freedom), arc_length(expansion, covariance)
            )
        return errors
