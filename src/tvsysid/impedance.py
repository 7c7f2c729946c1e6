"""Stiffness, viscosity and inertia from what was identified; arrays only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Impedance(NamedTuple):
    """Stiffness in N·m/rad, viscosity in N·m·s/rad and inertia in kg·m², each of shape (time,)."""

    stiffness: Array
    viscosity: Array
    inertia: Array


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


def second_order_fit(frequencies: Array, response: ComplexArray, weights: Array) -> Impedance:
    r"""Weighted fit of :math:`k + j\omega b - \omega^2 I` to a frequency response at each time.

    Real and imaginary parts separate: k and I follow from the real part, b from the imaginary one.

    Parameters
    ----------
    frequencies
        In Hz, shape (frequency,).
    response
        In N·m/rad, shape (time, frequency).
    weights
        Reciprocal variances up to a factor, shape (time, frequency).

    Returns
    -------
    Impedance
        Shapes (time,); NaN where the weights do not determine the fit.
    """
    square = (2 * np.pi * frequencies) ** 2
    moments = [np.sum(weights * square**power, axis=1) for power in range(3)]
    real = [np.sum(weights * response.real * square**power, axis=1) for power in range(2)]
    imaginary = np.sum(weights * response.imag * np.sqrt(square), axis=1)
    determinant = moments[0] * moments[2] - moments[1] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        stiffness = (real[0] * moments[2] - real[1] * moments[1]) / determinant
        inertia = (real[0] * moments[1] - real[1] * moments[0]) / determinant
        viscosity = imaginary / moments[1]
    fits = [np.where(np.isfinite(values), values, np.nan) for values in (stiffness, viscosity, inertia)]
    return Impedance(*fits)
