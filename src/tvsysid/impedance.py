"""Stiffness, viscosity and inertia from what was identified; arrays only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.numerics.moments import lagged_moments, time_chunks

Array = NDArray[np.float64]


def static_stiffness(impulse_response: Array, sample_time: float) -> Array:
    r"""Area under the impulse response: :math:`k(t) = \Delta t \sum_\tau h(t, \tau)` (equation 20).

    Parameters
    ----------
    impulse_response
        In N·m/rad per second, shape (time, lag).
    sample_time
        In s.

    Returns
    -------
    Array
        In N·m/rad, shape (time,).
    """
    return np.asarray(impulse_response.sum(axis=1) * sample_time)


class Readout(NamedTuple):
    """What stiffness, viscosity and inertia are of the correlations at each time.

    ``matrix`` (time, 3, lag): times the correlations of input and output it gives the three; ``fitted`` (time,): the
    output's power that the second-order fit explains.
    """

    matrix: Array
    fitted: Array


def second_order_readout(phi_uu: Array, phi_uy: Array, inverse: Array, sampling_rate: float) -> Readout:
    r"""Stiffness as the area under an impulse response, viscosity and inertia from a second-order fit to it.

    Weights :math:`w = \Phi^{-1} \varphi` have a covariance in proportion to :math:`\Phi^{-1}`. The fit, weighted by
    its inverse, minimises

    .. math:: (w - D^T p)^T\, \Phi\, (w - D^T p), \qquad p = (D \Phi D^T)^{-1} D\, \varphi

    over :math:`p = (k, b, I)`, where the rows of D are the filters that give angle, velocity and acceleration from
    lagged angles (:mod:`tvsysid.numerics.differentiation`). So it lies in the band in which the input has power, and
    needs no truncation: three numbers are determined where an impulse response is not.

    Parameters
    ----------
    phi_uu, phi_uy
        Correlations as of :func:`tvsysid.numerics.moments.lagged_moments`, shapes (time, lag, lag) and (time, lag).
    inverse
        Pseudo-inverse of ``phi_uu``, truncated or not, shape (time, lag, lag), by which the area follows.
    sampling_rate
        In Hz.

    Returns
    -------
    Readout
        NaN where the input does not tell the three apart.
    """
    derivative = derivative_filters(phi_uu.shape[1] // 2, sampling_rate)
    filtered = phi_uu @ derivative.T
    inverted = _inverses(derivative @ filtered)
    fit = inverted @ derivative
    cross = phi_uy @ derivative.T
    found = (inverted @ cross[..., None])[..., 0]
    matrix = np.concatenate([inverse.sum(axis=2)[:, None], fit[:, 1:]], axis=1)
    return Readout(matrix, np.einsum("tm,tm->t", found, cross))


class MomentFit(NamedTuple):
    """Least-squares ``impedance`` (time, 3) and the ``inverse`` of the regressors' moments (time, 3, 3)."""

    impedance: Array
    inverse: Array


def second_order_fit(moments: Array, cross: Array) -> MomentFit:
    r"""Stiffness, viscosity and inertia by least squares on angle, velocity and acceleration.

    Parameters
    ----------
    moments
        Second moments of angle, velocity and acceleration, shape (time, 3, 3).
    cross
        Their moments with the torque, shape (time, 3).

    Returns
    -------
    MomentFit
        NaN where the moments do not determine the three.
    """
    inverse = _inverses(moments)
    return MomentFit((inverse @ cross[..., None])[..., 0], inverse)


class DerivativeMoments(NamedTuple):
    """Second moments over realizations of angle, velocity and acceleration at each time, and of the torque.

    ``regressors`` (time, 3, 3) of the three with each other, ``cross`` (time, 3) with the torque, ``square`` (time,) of
    the torque; those of the lagged angles that the three are made of: ``mixed`` (time, lag, 3) with the three,
    ``answers`` (time, lag) with the torque, and ``lagged`` (lag, lag) with each other, averaged over time.
    """

    regressors: Array
    cross: Array
    square: Array
    mixed: Array
    answers: Array
    lagged: Array

    def second_order_agreement(self, impedance: Array, realizations: int) -> float:
        """Agreement of an impedance (time, 3) with the moments; see :func:`agreement_of_moments`."""
        explained = float(np.sum(self.cross * impedance))
        fitted = float(np.einsum("tm,tmk,tk->", impedance, self.regressors, impedance))
        times = len(impedance)
        return agreement_of_moments(
            fitted / times,
            np.mean(self.answers - (self.mixed @ impedance[..., None])[..., 0], axis=0),
            self.lagged,
            (float(self.square.sum()) - 2 * explained + fitted) / times,
            realizations * times,
        )


def derivative_moments(angle: Array, torque: Array, sampling_rate: float) -> DerivativeMoments:
    """Moments of angle, velocity and acceleration, which are sums of lagged angles; no derivative is formed.

    Parameters
    ----------
    angle, torque
        Shape (realization, time); the moments are those of the times :data:`HALF_WIDTH` from both ends.
    sampling_rate
        In Hz.
    """
    filters = derivative_filters(HALF_WIDTH, sampling_rate)
    parts, lagged = [], np.zeros((filters.shape[1],) * 2)
    for chunk in time_chunks(angle.shape[1] - 2 * HALF_WIDTH, filters.shape[1]):
        within = slice(chunk.start, chunk.stop + 2 * HALF_WIDTH)
        phi_uu, phi_uy, square, _ = lagged_moments(angle[:, within], torque[:, within], HALF_WIDTH)
        parts.append((phi_uu @ filters.T, phi_uy, square))
        lagged += phi_uu.sum(axis=0)
    mixed, answers, square = (np.concatenate(values) for values in zip(*parts, strict=True))
    return DerivativeMoments(filters @ mixed, answers @ filters.T, square, mixed, answers, lagged / len(square))


def derivative_filters(lags: int, sampling_rate: float) -> Array:
    """Filters that give a signal and its first and second derivative from so many lags to either side.

    Shape (3, 2 lags + 1), in the units of 1 per second to the power 0, 1 and 2.
    """
    return np.asarray(derivative_weights(lags) * sampling_rate ** np.arange(3.0)[:, None])


def agreement(fitted: Array, beyond: Array, chance: Array) -> float:
    r"""Share of the output that answers to the input which a second-order fit explains.

    .. math:: 100\,\% \left(1 - \frac{\sum_t (e(t) - c(t))}{\sum_t (f(t) + e(t))}\right)

    no more than 100 %. On a joint that is of second order lagged inputs explain more than the fit by chance only.

    Parameters
    ----------
    fitted, beyond
        Power of the output that the fit explains, f, and that lagged inputs explain of the rest, e, shape (time,).
    chance
        What noise alone makes of the second, c, shape (time,).

    Returns
    -------
    float
        In per cent; NaN where nothing can be said.
    """
    known = np.isfinite(fitted) & np.isfinite(beyond) & np.isfinite(chance)
    total = float(np.sum((fitted + beyond)[known]))
    if total <= 0:
        return float("nan")
    return 100 * min(1.0, 1 - float(np.sum((beyond - chance)[known])) / total)


def agreement_of_moments(fitted: float, cross: Array, moments: Array, left: float, samples: int) -> float:
    """Agreement of a second-order fit with the torque's mean response to lagged angles.

    The response is taken as the same at all times: what a fit leaves because it smooths a change of stiffness has no
    mean response, and does not count.

    Parameters
    ----------
    fitted, left
        Mean squares of the fit, and of what it leaves of the torque.
    cross
        Mean products of lagged angles and what the fit leaves, shape (lag,).
    moments
        Mean products of lagged angles, shape (lag, lag).
    samples
        How many there are, realizations times times.

    Returns
    -------
    float
        In per cent; see :func:`agreement`.
    """
    answer = float(cross @ np.linalg.pinv(moments, rcond=ROUNDING, hermitian=True) @ cross)
    chance = len(cross) * left / samples
    return agreement(*(np.array([value]) for value in (fitted, answer, chance)))


def _inverses(matrices: Array) -> Array:
    """Inverses of symmetric matrices, shape (time, 3, 3); NaN where there is none."""
    power = np.diagonal(matrices, axis1=1, axis2=2)
    scale = np.sqrt(np.where(power > 0, power, np.inf))  # what has no power is not determined
    scales = scale[:, :, None] * scale[:, None, :]
    scaled = matrices / scales
    determined = np.linalg.det(scaled) > SINGULAR
    scaled[~determined] = np.eye(matrices.shape[1])
    return np.where(determined[:, None, None], np.linalg.inv(scaled) / scales, np.nan)


ROUNDING = 1e-9
"""Share of the largest eigenvalue below which directions of lagged angles are rounding."""
SINGULAR = 1e-9
"""Determinant of three regressors' correlation matrix below which they cannot be told apart."""
