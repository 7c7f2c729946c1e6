"""Stiffness, viscosity and inertia from what was identified; arrays only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tvsysid.numerics import Array
from tvsysid.numerics.differentiation import derivative_weights

# share of the largest eigenvalue below which directions of lagged angles are rounding
ROUNDING = 1e-9
# determinant of a matrix with a diagonal of ones below which it has no inverse
SINGULAR = 1e-9
RESPONSE_BAND = (0.5, 15.0)  # Hz, in which a response is fitted


def second_order_readout(
    phi_uu: Array, phi_uy: Array, inverse: Array, sampling_rate: float
) -> tuple[Array, float]:
    r"""Return the matrix that gives stiffness, viscosity and inertia from correlations.

    Stiffness is the area under the impulse response; the others follow from a second-order fit.

    Weights :math:`w = \Phi^{-1} \varphi` have a covariance in proportion to :math:`\Phi^{-1}`. The
    fit, weighted by its inverse, minimises

    .. math:: (w - D^T p)^T\, \Phi\, (w - D^T p), \qquad p = (D \Phi D^T)^{-1} D\, \varphi

    over :math:`p = (k, b, I)`, where the rows of D are the filters that give angle, velocity and
    acceleration from lagged angles (:mod:`tvsysid.numerics.differentiation`). So the fit counts
    where the input has power, and its three numbers need no truncation.

    ``phi_uu`` (lag, lag) and ``phi_uy`` (lag,) are mean correlations of lagged angles, and with the
    torque. The area follows by ``inverse``, a pseudo-inverse of the former. The matrix (3, lag)
    multiplies ``phi_uy``. Return also the output's power that the fit explains.
    """
    derivative = derivative_filters(len(phi_uy) // 2, sampling_rate)
    moments = derivative @ phi_uu @ derivative.T
    cross = derivative @ phi_uy
    (found,), (inverted,) = second_order_fit(moments[None], cross[None])
    matrix = np.concatenate([inverse.sum(axis=1)[None], (inverted @ derivative)[1:]])
    return matrix, float(found @ cross)


def response_readout(lags: Array) -> Array:
    """Return weights (quantity, lag) that turn a response into stiffness, viscosity and inertia.

    The lags are in s. The weights are a least-squares fit to the frequency response from 0.5 to
    15 Hz.
    """
    omega = 2 * np.pi * np.linspace(*RESPONSE_BAND, 60)
    joint = np.stack([np.ones_like(omega), 1j * omega, -(omega**2)], axis=1)
    response = np.exp(-1j * np.outer(omega, lags))
    joint, response = (np.concatenate([each.real, each.imag]) for each in (joint, response))
    return np.asarray(np.linalg.pinv(joint) @ response)


class MomentFit(NamedTuple):
    """Least-squares ``impedance`` (time, 3), and ``inverse`` of the regressors' moments."""

    impedance: Array
    inverse: Array


def second_order_fit(moments: Array, cross: Array) -> MomentFit:
    """Stiffness, viscosity and inertia by least squares on angle, velocity and acceleration.

    From the three's second ``moments`` (time, 3, 3) and those with the torque (time, 3); NaN
    where not determined.
    """
    inverse = _inverses(moments)
    return MomentFit((inverse @ cross[..., None])[..., 0], inverse)


def derivative_filters(lags: int, sampling_rate: float) -> Array:
    """Return filters (3, 2 lags + 1) for a signal and its first two derivatives."""
    return np.asarray(derivative_weights(lags) * sampling_rate ** np.arange(3.0)[:, None])


def agreement(fitted: float, beyond: float, chance: float) -> float:
    r"""Return the share of the linearly dependent output that a second-order fit explains, in %.

    .. math:: 100\,\% \left(1 - \frac{e - c}{f + e}\right)

    with f the output's power that is ``fitted``, e the power that lagged inputs explain ``beyond``
    the fit, and c the part of e that is expected by ``chance``. At most 100 %; NaN without power.
    If the joint is of second order, e is due to chance only.
    """
    total = fitted + beyond
    return 100 * min(1.0, 1 - (beyond - chance) / total) if total > 0 else float("nan")


def agreement_of_moments(
    fitted: float, cross: Array, moments: Array, left: float, samples: int
) -> float:
    """Return the agreement of a second-order fit with the mean response to lagged angles, in %.

    The response is taken as the same at all times. A residual of smoothing a change of stiffness
    has no mean response, and does not count. ``fitted`` and ``left`` are mean squares of the fit
    and of its residual. ``cross`` (lag,) and ``moments`` (lag, lag) are mean products of lagged
    angles with the residual and with each other, over so many ``samples``.
    """
    values, vectors = np.linalg.eigh(moments)
    kept = np.abs(values) > ROUNDING * np.abs(values).max()
    answer = float(np.sum((cross @ vectors)[kept] ** 2 / values[kept]))
    return agreement(fitted, answer, len(cross) * left / samples)


def _inverses(matrices: Array) -> Array:
    """Return inverses of matrices, shape (time, 3, 3); NaN where there is none."""
    power = np.abs(np.diagonal(matrices, axis1=1, axis2=2))
    scale = np.sqrt(np.where(power > 0, power, np.inf))  # what has no power is not determined
    scales = scale[:, :, None] * scale[:, None, :]
    scaled = matrices / scales
    determined = np.abs(np.linalg.det(scaled)) > SINGULAR
    scaled[~determined] = np.eye(matrices.shape[1])
    return np.where(determined[:, None, None], np.linalg.inv(scaled) / scales, np.nan)
