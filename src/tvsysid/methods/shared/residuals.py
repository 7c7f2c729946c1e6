"""Estimate strength and colour of the noise from a fit's residual, and the standard errors."""

from __future__ import annotations

import numpy as np

from tvsysid.methods.base import missing_edge, padded
from tvsysid.methods.shared.estimates import standard_errors
from tvsysid.models import StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_filters
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, window_matrices
from tvsysid.numerics.noise import (
    angle_products,
    autocovariance,
    colour_factors,
    regressor_correlation,
    regressor_covariances,
    white_share,
)
from tvsysid.numerics.second_order import agreement_of_moments
from tvsysid.signals import Array, Ensemble

# Longest lag at which the noise's autocorrelation counts. It is multiplied by that of the angle,
# which is about 0 beyond.
MAX_NOISE_LAG_S = 0.25
MIN_RESIDUAL_SHARE = 0.1  # least share of the noise's variance that a fit leaves in the residual


def independent_realizations(ensemble: Ensemble) -> int:
    """Return the number of realizations with independent noise at each time.

    It is one less if the mean over realizations was subtracted. The fit is then a regression with
    an intercept at each time.
    """
    return max(1, len(ensemble) - ensemble.mean_subtracted)


def independent_share(ensemble: Ensemble, predicted: Array, band: tuple[float, float]) -> float:
    """Return the effective fraction of independent samples in a fit of stiffness.

    It is below 1 if the residual is not white. ``predicted`` is the torque (realization, time)
    of some model, ``band`` the fitted frequencies in Hz; see
    :func:`tvsysid.numerics.noise.white_share`.
    """
    known = np.isfinite(predicted).all(axis=0)
    angle, torque = (x[:, ensemble.core] for x in (ensemble.angle, ensemble.torque))
    return white_share(
        (torque - predicted)[:, known], angle[:, known], ensemble.sampling_rate, band
    )


def residual(ensemble: Ensemble, weights: Array) -> Array:
    """Return the residual torque (realization, time) of weights (time, lag) on lagged angles.

    The weights are an impulse response times the sample time, at the times whose lags lie within
    the context.
    """
    lags = weights.shape[1] // 2
    first = max(0, ensemble.context - lags)
    angle, torque = (x[:, first : x.shape[1] - first] for x in (ensemble.angle, ensemble.torque))
    fit = convolve_lags(angle, weights)
    return np.subtract(torque[:, lags : torque.shape[1] - lags], fit, out=fit)


def second_order_torque(ensemble: Ensemble, impedance: Array) -> Array:
    """Return the torque (realization, time) of stiffness, viscosity and inertia.

    ``impedance`` has shape (time, 3) or (realization, time, 3). The torque is NaN where the angle's
    derivatives are.
    """
    parts = map(np.multiply, np.moveaxis(impedance, -1, 0), ensemble.derivatives())
    return sum(parts)


def second_order_residual(ensemble: Ensemble, impedance: Array) -> tuple[Array, int]:
    """Return the residual torque (realization, time) of an impedance (time, 3), and its first time.

    It reaches from the first to the last time at which the impedance and the derivatives of the
    angle are known.
    """
    edge = missing_edge(HALF_WIDTH, ensemble)
    inner = impedance[edge : ensemble.samples - edge]
    filters = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
    residuals = residual(ensemble, np.nan_to_num(inner) @ filters)
    times = np.flatnonzero(np.isfinite(inner).all(axis=1))
    first, stop = (int(times[0]), times[-1] + 1) if times.size else (0, 0)
    return residuals[:, first:stop], edge + first


def noise_ratio(of_measured: Array, of_predicted: Array) -> float:
    """Return the residual power for the measured angle, divided by that for the predicted angle.

    The latter also holds the torque of the movement that noise causes.
    """
    return float(np.sum(of_measured**2) / np.sum(of_predicted**2))


def residual_agreement(ensemble: Ensemble, residuals: Array, first: int) -> float:
    """Return the share of the angle-dependent torque that a fit explains, in %.

    ``residuals`` (realization, time) of the torque begin at the time ``first``. The derivatives of
    the angle must be known at all their times. In closed loop, the ensemble must have the predicted
    angle: noise moves the measured angle, which is therefore correlated with the residual. See
    :func:`tvsysid.numerics.second_order.agreement_of_moments`.
    """
    if not residuals.size:
        return float("nan")
    start = ensemble.context + first
    stop = start + residuals.shape[1]
    angle = ensemble.angle[:, start - HALF_WIDTH : stop + HALF_WIDTH]
    cross = diagonal_moments(residuals, angle, 2 * HALF_WIDTH).mean(axis=0)
    products = diagonal_moments(angle, angle, 2 * HALF_WIDTH)
    moments = np.einsum("tjk->jk", window_matrices(products, products)) / residuals.shape[1]
    count = residuals.size
    fitted = np.linalg.norm(ensemble.torque[:, start:stop] - residuals) ** 2 / count
    unexplained = np.linalg.norm(residuals) ** 2 / count
    return agreement_of_moments(float(fitted), cross, moments, float(unexplained), count)


def noise_correlation(covariance: Array, absorbed: Array) -> Array:
    """Return the autocorrelation (lag,) of the noise from the autocovariance of a fit's residual.

    ``absorbed`` says by how much the fit lowers the autocovariance at each lag, as shares of the
    noise's variance.
    """
    if covariance[0] <= 0:
        return np.asarray(np.arange(len(absorbed)) == 0, dtype=np.float64)
    variance = covariance[0] / max(1 - absorbed[0], MIN_RESIDUAL_SHARE)
    return np.concatenate([[1.0], covariance[1:] / variance + absorbed[1:]])


def noise_colour(
    ensemble: Ensemble,
    residuals: Array,
    absorbed: Array | float,
    filters: Array,
    overlap: Array | float = 1.0,
) -> tuple[Array, Array]:
    """Return the noise's autocorrelation (lag,), and variance factors (regressor,).

    The factors multiply the variances that a fit has under white noise.

    Parameters
    ----------
    residuals
        Residuals (realization, time) of the fit.
    absorbed
        Share of the noise's power that the fit explains, one number or one for each lag. Here it is
        multiplied by the regressors' correlation at each lag, and corrected for a subtracted mean.
    filters
        Filters (regressor, tap) that give the regressors from lagged angles.
    overlap
        Autocorrelation of the window in a windowed fit, one number or one for each lag.
    """
    lags = colour_lags(ensemble)
    products = angle_products(ensemble.angle, filters.shape[1], lags)
    regressors = regressor_covariances(filters, products)
    share = absorbed * len(ensemble) / independent_realizations(ensemble)
    correlated = share * regressor_correlation(regressors)
    noise = noise_correlation(autocovariance(residuals, lags), correlated)
    return noise, colour_factors(regressors, noise * overlap)


def colour_lags(ensemble: Ensemble) -> int:
    """Return the number of lags of the noise's autocorrelation, at most a realization's samples."""
    return min(round(MAX_NOISE_LAG_S * ensemble.sampling_rate), int(ensemble.angle.shape[1]))


def posterior_errors(
    expansions: Array,
    covariance: Array,
    freedom: float,
    times: int,
    factors: Array | float = 1.0,
) -> dict[str, StandardError]:
    """Return standard errors from the posterior of coefficients.

    Parameters
    ----------
    expansions
        Matrices that give stiffness, viscosity and inertia over time from the coefficients, shape
        (3, time, coefficient).
    covariance
        Covariance (coefficient, coefficient) of the coefficients, or one for each of the three.
    freedom
        Degrees of freedom.
    times
        Number of times of a realization. Ends that the expansions lack are NaN.
    factors
        Factors of the variances, one or (quantity,).
    """
    covariances = np.broadcast_to(covariance, (3, *covariance.shape[-2:]))
    variances = np.einsum("qtj,qtj->tq", expansions @ covariances, expansions)
    values = np.sqrt(np.maximum(factors * variances, 0.0))
    arcs = list(map(arc_length, expansions, covariances))
    return standard_errors(padded(values, (times - len(values)) // 2), freedom, arcs)
