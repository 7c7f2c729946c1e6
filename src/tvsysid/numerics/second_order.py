"""Stiffness, viscosity and inertia from correlations or an impulse response."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tvsysid.numerics import Array
from tvsysid.numerics.differentiation import derivative_filters

# share of the largest eigenvalue below which directions of lagged angles are rounding
ROUNDING = 1e-9
# determinant below which a matrix with a diagonal of ones counts as singular
SINGULAR = 1e-9
RESPONSE_BAND = (0.5, 15.0)  # Hz, in which a response is fitted


class MomentFit(NamedTuple):
    """Impedance (time, 3) by least squares, and the matrix ``readout`` (time, 3, lag).

    The readout times the correlations of lagged angles with the torque is an impedance, too.
    """

    impedance: Array
    readout: Array


def second_order_readout(
    phi_uu: Array, phi_uy: Array, area: Array, sampling_rate: float
) -> MomentFit:
    r"""Fit stiffness, viscosity and inertia to the correlations of each time.

    Weights :math:`w = \Phi^{-1} \varphi` have a covariance in proportion to :math:`\Phi^{-1}`. The
    fit, weighted by its inverse, minimises

    .. math:: (w - D^T p)^T\, \Phi\, (w - D^T p), \qquad p = (D \Phi D^T)^{-1} D\, \varphi

    over :math:`p = (k, b, I)`, where the rows of D are the filters that give angle, velocity and
    acceleration from lagged angles (:mod:`tvsysid.numerics.differentiation`). Directions without
    power of the input do not count, so no truncation is needed. The readout gives the viscosity and
    inertia of this fit. Its stiffness is the area under the impulse response.

    ``phi_uu`` (time, lag, lag) and ``phi_uy`` (time, lag) are mean correlations of lagged angles
    with each other and with the torque. ``area`` (time, lag) times ``phi_uy`` is the area.
    """
    derivative = derivative_filters(phi_uy.shape[1] // 2, sampling_rate)
    fit, inverted = second_order_fit(derivative @ phi_uu @ derivative.T, phi_uy @ derivative.T)
    readout = np.concatenate([area[:, None], (inverted @ derivative)[:, 1:]], axis=1)
    return MomentFit(fit, readout)


def response_readout(lags: Array) -> Array:
    """Return weights (quantity, lag) that turn a response into stiffness, viscosity and inertia.

    The lags are in s. The weights are a least-squares fit to the frequency response from 0.5 to
    15 Hz.
    """
    omega = 2 * np.pi * np.linspace(*RESPONSE_BAND, 60)
    joint = np.stack([np.ones_like(omega), 1j * omega, -(omega**2)], axis=1)
    response = np.exp(-1j * np.outer(omega, lags))
    joint, response = (np.concatenate([each.real, each.imag]) for each in (joint, response))
    return np.linalg.pinv(joint) @ response


def second_order_fit(moments: Array, cross: Array) -> tuple[Array, Array]:
    """Return stiffness, viscosity and inertia (time, 3) by least squares, and inverse moments.

    The ``moments`` (time, 3, 3) are those of angle, velocity and acceleration, ``cross`` (time, 3)
    those with the torque. Both results are NaN where not determined.
    """
    inverse = _inverses(moments)
    return (inverse @ cross[..., None])[..., 0], inverse


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

    The response is taken as the same at all times. The error of a fit that smooths a change of
    stiffness averages out over time, and does not count. ``fitted`` and ``left`` are mean squares
    of the fit and of its residual. ``cross`` (lag,) and ``moments`` (lag, lag) are mean products of
    lagged angles with the residual and with each other, over so many ``samples``.
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
