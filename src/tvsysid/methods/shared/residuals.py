"""What a method leaves unexplained: how strong the noise is and what colour it has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.impedance import agreement
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.noise import (
    autocovariance,
    colour_factors,
    cross_covariance,
    regressor_correlation,
    regressor_covariances,
    white_share,
)
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]

LONGEST_COLOUR = 0.25
"""Seconds up to which the noise's autocorrelation is taken into account; the angle's own hardly reaches further."""


def independent_realizations(ensemble: Ensemble) -> int:
    """How many realizations' worth of noise an ensemble holds at each time.

    One less than there are realizations where the mean over them was subtracted: what is fitted then is a regression
    with an intercept at each time.
    """
    return len(ensemble) - ensemble.mean_subtracted


def independent_share(ensemble: Ensemble, predicted: Array, band: tuple[float, float]) -> float:
    """How many independent samples a sample is worth for stiffness, at most 1: what is left unexplained is not white.

    ``predicted`` is the torque (realization, time) by some model, ``band`` the frequencies in Hz that are fitted; see
    :func:`tvsysid.numerics.noise.white_share`.
    """
    known = np.isfinite(predicted).all(axis=0)
    angle, left = (
        x[:, known] for x in (ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core] - predicted)
    )
    return white_share(left, angle, ensemble.sampling_rate, band)


def counted(ensemble: Ensemble) -> str:
    """How many realizations there are and what they are worth, in words."""
    count, independent = len(ensemble), independent_realizations(ensemble)
    said = f"{count} realization{'s' * (count > 1)}"
    return said if independent == count else f"{said}, worth {independent} with their mean subtracted,"


class Colour(NamedTuple):
    """Autocorrelation of the ``noise`` (lag,), and covariances of the ``regressors`` (lag, regressor, regressor)."""

    noise: Array
    regressors: Array

    def factors(self) -> Array:
        """Variances of the fit of these regressors, as multiples of those under white noise."""
        return colour_factors(self.regressors, self.noise)


def residual(ensemble: Ensemble, weights: Array, lags: int) -> Array:
    """Torque that weights on lagged angles leave, at the times whose lags lie within the context.

    Parameters
    ----------
    ensemble
        Realizations.
    weights
        Impulse response times the sample time at those times, shape (time, 2 lags + 1).
    lags
        To either side.

    Returns
    -------
    Array
        In N·m, shape (realization, time).
    """
    first = max(0, ensemble.context - lags)
    angle, torque = (x[:, first : x.shape[1] - first] for x in (ensemble.angle, ensemble.torque))
    left: Array = torque[:, lags : torque.shape[1] - lags] - convolve_lags(angle, weights)
    return left


def colour(ensemble: Ensemble, left: Array, taken: Array | float, filters: Array) -> Colour:
    """Colour of the noise, and of the regressors that it is fitted with.

    Parameters
    ----------
    ensemble
        That was identified from.
    left
        Residual, shape (realization, time).
    taken
        Share of the noise's power that the fit took, were its regressors the same at all lags; for each lag from 0
        on, shape (lag,), or one for all. Of the noise with its mean over realizations, if that was subtracted.
    filters
        That give the regressors from lagged angles, shape (regressor, lag).
    """
    regressors = regressor_covariances(filters, ensemble.angle, round(LONGEST_COLOUR * ensemble.sampling_rate))
    share = taken * len(ensemble) / independent_realizations(ensemble)
    return Colour(correlation(left, np.asarray(share * regressor_correlation(regressors))), regressors)


def correlation(left: Array, taken: Array) -> Array:
    """Autocorrelation of the noise from what a fit left of it.

    Parameters
    ----------
    left
        Residual, shape (realization, time).
    taken
        By how much the fit lowers the autocovariance at each lag, as shares of the noise's variance, shape (lag,).

    Returns
    -------
    Array
        Shape (lag,); 1 at lag 0.
    """
    covariance = autocovariance(left, len(taken) - 1)
    if covariance[0] <= 0:
        return np.asarray(np.arange(len(taken)) == 0, dtype=np.float64)
    variance = covariance[0] / max(1 - taken[0], LEAST_LEFT)
    return np.asarray(np.concatenate([[1.0], covariance[1:] / variance + taken[1:]]))


def agreement_of(fit: Array, left: Array, angle: Array, around: Array, lags: int) -> float:
    """Agreement of a fit (realization, time) and what it ``left`` of the torque; see :func:`second_order_agreement`.

    ``angle`` is that at the same times, ``around`` the same or more of it, from which its own correlation is taken.
    """
    return second_order_agreement(
        float(np.mean(fit**2)),
        cross_covariance(angle, left, lags),
        toeplitz(autocovariance(around, 2 * lags)),
        float(np.mean(left**2)),
        left.size,
    )


def second_order_agreement(fitted: float, cross: Array, moments: Array, left: float, samples: int) -> float:
    """Share of the torque that angles explain which a second-order fit explains; the rest answers to lagged angles.

    The response to lagged angles is the same at all times: what a fit leaves because it smooths a change of stiffness
    has no mean response, and does not count.

    Parameters
    ----------
    fitted
        Mean square of the fit.
    cross
        Mean products of lagged angles and what the fit leaves, shape (lag,).
    moments
        Mean products of lagged angles, shape (lag, lag).
    left
        Mean square of what the fit leaves.
    samples
        How many there are, realizations times times.

    Returns
    -------
    float
        In per cent; see :func:`tvsysid.impedance.agreement`.
    """
    answer = float(cross @ np.linalg.pinv(moments, rcond=ROUNDING, hermitian=True) @ cross)
    chance = len(cross) * left / samples
    return agreement(*(np.array([value]) for value in (fitted, answer, chance)))


ROUNDING = 1e-9
"""Share of the largest eigenvalue below which directions of lagged angles are rounding."""
LEAST_LEFT = 0.1
"""Share of the noise that a residual is taken to hold at least."""
