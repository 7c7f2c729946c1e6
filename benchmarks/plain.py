"""Implement the five methods from the equations: plain, slow, independent of the package.

Each time (or each sample of each realization) gets its regressor from the data themselves; nothing
is shared between times, and nothing of the package is used. Its fast methods are checked and timed
against these.

Signals are of shape (realization, context + time + context) unless said otherwise; equations are
those of van de Ruit et al. 2021.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

EXTERNAL_TERMS = 5
"""Half-cosines over the record that make up the external term of the kernel regression."""


class Impedance(NamedTuple):
    """Stiffness in N·m/rad, viscosity in N·m·s/rad and inertia in kg·m², each of shape (time,)."""

    stiffness: Array
    viscosity: Array
    inertia: Array


class KernelFit(NamedTuple):
    """Stiffness, viscosity and inertia at each sample of the record, and the noise variance."""

    stiffness: Array
    viscosity: Array
    inertia: Array
    noise_variance: float


def eirf(angle: Array, torque: Array, context: int, lags: int, *, rate: float) -> Array:
    """Estimate the ensemble impulse response (equations 4 to 6), truncated by description length.

    Parameters
    ----------
    angle, torque
        Input and output.
    context
        Samples on either side of a realization.
    lags
        Lags to either side.
    rate
        Sampling rate in Hz.

    Returns
    -------
    Array
        Impulse response, shape (time, lag), lags from -lags to lags; NaN where these reach beyond
        the data.
    """
    return sds(angle, torque, context, lags, half=0, rate=rate)


def sds(angle: Array, torque: Array, context: int, lags: int, *, half: int, rate: float) -> Array:
    """Impulse response from short data segments (equation 7), solved as in :func:`eirf`.

    Parameters
    ----------
    angle, torque, context, lags, rate
        As for :func:`eirf`.
    half
        Samples pooled on either side of each time; fewer where the lags of a sample reach beyond
        the data.

    Returns
    -------
    Array
        As of :func:`eirf`.
    """
    available = range(lags, angle.shape[1] - lags)
    response = np.full((angle.shape[1] - 2 * context, 2 * lags + 1), np.nan)
    for time in range(len(response)):
        centre = context + time
        if centre not in available:
            continue
        pooled = [i for i in range(centre - half, centre + half + 1) if i in available]
        regressor = np.concatenate([_lagged(angle, i, lags) for i in pooled])
        output = np.concatenate([torque[:, i] for i in pooled])
        response[time] = _truncated(regressor, output) * rate
    return response


def esm(angle: Array, torque: Array, context: int, length: int) -> ComplexArray:
    """Estimate the frequency response from short segments of all realizations (equations 10-12).

    Parameters
    ----------
    angle, torque, context
        As for :func:`eirf`.
    length
        Samples of a segment: from length // 2 before each time on.

    Returns
    -------
    ComplexArray
        Shape (time, frequency); NaN where a segment reaches beyond the data.
    """
    # Its peak is on the segment's time; of the two zeros at the ends, only an even segment has the
    # first.
    window = np.hanning(length + 2)[1:-1] if length % 2 else np.hanning(length + 1)[:-1]
    response = np.full((angle.shape[1] - 2 * context, length // 2 + 1), np.nan + 0j)
    for time in range(len(response)):
        first = context + time - length // 2
        if first < 0 or first + length > angle.shape[1]:
            continue
        u = np.fft.rfft(angle[:, first : first + length] * window, axis=1)
        y = np.fft.rfft(torque[:, first : first + length] * window, axis=1)
        cross = np.mean(y * u.conj() / length, axis=0)
        auto = np.mean(u * u.conj() / length, axis=0)
        response[time] = cross / auto
    return response


def birf_irf(
    angle: Array, torque: Array, context: int, lags: int, *, basis_values: Array, rate: float
) -> Array:
    """Estimate the impulse response by basis functions of time and least squares (equations 8, 9).

    Parameters
    ----------
    angle, torque, context, lags, rate
        As for :func:`eirf`.
    basis_values
        Basis functions over a realization, shape (time, function).

    Returns
    -------
    Array
        As of :func:`eirf`.
    """
    samples, functions = basis_values.shape
    rows, outputs, known = [], [], []
    for time in range(samples):
        centre = context + time
        if centre < lags or centre + lags >= angle.shape[1]:
            continue
        rows.append(np.kron(_lagged(angle, centre, lags), basis_values[time]))
        outputs.append(torque[:, centre])
        known.append(time)
    regressor, output = np.concatenate(rows), np.concatenate(outputs)
    weights = np.linalg.lstsq(regressor, output, rcond=None)[0].reshape(2 * lags + 1, functions)
    response = np.full((samples, 2 * lags + 1), np.nan)
    response[known] = basis_values[known] @ weights.T * rate
    return response


def birf_parametric(
    angle: Array, velocity: Array, acceleration: Array, torque: Array, basis_values: Array
) -> Impedance:
    """Estimate stiffness and viscosity by basis functions, and a constant inertia, on all samples.

    Parameters
    ----------
    angle, velocity, acceleration, torque
        Shape (realization, time), without context.
    basis_values
        Shape (time, function).

    Returns
    -------
    Impedance
        Over a realization.
    """
    count = basis_values.shape[1]
    regressor = np.concatenate(
        [
            np.column_stack([basis_values * u[:, None], basis_values * v[:, None], a])
            for u, v, a in zip(angle, velocity, acceleration, strict=True)
        ]
    )
    weights = np.linalg.lstsq(regressor, torque.ravel(), rcond=None)[0]
    return Impedance(
        basis_values @ weights[:count],
        basis_values @ weights[count : 2 * count],
        np.full(len(basis_values), weights[-1]),
    )


def kbr_dense(
    angle: Array,
    velocity: Array,
    acceleration: Array,
    torque: Array,
    *,
    rate: float,
    period: float,
    l1: float,
    l2: float,
    gamma: float,
    band: tuple[float, float],
    noise_variance: float | None = None,
) -> KernelFit:
    r"""Estimate by kernel regression of one continuous record, with the dense kernel.

    Equations 13 to 17, Na = 0, Nb = 2.

    .. math:: \min \sum_k |E(k)|^2 / \sigma^2 + \sum_m \tilde b_m^T K^{-1} \tilde b_m

    over constants and weights of half-cosines (the external term) without prior, and the varying
    parts :math:`\tilde b_m`. Solved in the space of the data, so that K is never inverted.

    Parameters
    ----------
    angle, velocity, acceleration, torque
        Shape (time,), in rad and s.
    rate
        Sampling rate in Hz.
    period, l1, l2, gamma
        Of the kernel; infinite l2 makes it strictly periodic. gamma counts angles in degrees.
    band
        Lowest and highest frequency in Hz of the equation error.
    noise_variance
        Variance of E, the complex Fourier coefficient of the noise over the root of the number of
        samples; None estimates it from the residual until it stands.

    Returns
    -------
    KernelFit
        Over the record.
    """
    count = len(torque)
    spacing = rate / count
    frequency = np.arange(count // 2 + 1) * spacing
    inside = (frequency >= band[0] - 1e-9 * spacing) & (frequency <= band[1] + 1e-9 * spacing)
    signals = np.stack([angle, velocity, acceleration])

    apart = np.subtract.outer(np.arange(count), np.arange(count)) / rate
    kernel = np.exp(-(np.sin(np.pi * apart / period) ** 2) / l1) * np.exp(-((apart / l2) ** 2))
    kernel *= gamma * np.degrees(1.0) ** 2
    place = (np.arange(count) + 0.5) / count
    external = np.cos(np.pi * np.outer(np.arange(EXTERNAL_TERMS), place))

    in_time = kernel * (signals.T @ signals)
    covariance = _fourier(_fourier(in_time, inside).T, inside)
    fixed, output = _fourier(signals, inside).T, _fourier(torque, inside)
    # Combinations of the half-cosines that have power in the band.
    _, power, terms = np.linalg.svd(_fourier(external, inside), full_matrices=False)
    fixed = np.column_stack([fixed, terms[power > 1e-6 * power[0]].T])
    if noise_variance is None:
        noise_variance = _noise_variance(covariance, fixed, output)
    constants, dual = _generalised_least_squares(covariance, fixed, output, noise_variance)
    varying = (signals * _transposed_fourier(dual, inside, count)) @ kernel
    stiffness, viscosity, inertia = varying + constants[:3, None]
    return KernelFit(stiffness, viscosity, inertia, noise_variance)


def join(signal: Array, context: int, edge: int = 0) -> Array:
    """Return the record that realizations without gaps were cut from.

    It has ``edge`` samples of context at both ends.
    """
    stop = signal.shape[1] - context
    head, tail = signal[0, context - edge : context], signal[-1, stop : stop + edge]
    return np.concatenate([head, signal[:, context:stop].ravel(), tail])


def _lagged(angle: Array, time: int, lags: int) -> Array:
    """Return the regressor of all realizations at one sample, shape (realization, lag).

    Lags run from -lags to lags.
    """
    return np.stack([angle[:, time - lag] for lag in range(-lags, lags + 1)], axis=1)


def _truncated(regressor: Array, output: Array) -> Array:
    """Estimate weights from correlations, truncated at the least description length.

    Singular values are taken from the largest on.
    """
    length = len(output)
    correlation, cross = regressor.T @ regressor / length, regressor.T @ output / length
    left, values, right = np.linalg.svd(correlation)
    rank = int(np.sum(values > len(values) * np.finfo(float).eps * values[0]))
    projections = (left.T @ cross)[:rank]
    explained = projections**2 / values[:rank]
    orders = np.arange(1, rank + 1)
    variance = np.sum((output - output.mean()) ** 2) / (length - 1)
    cost = (1 + orders * np.log(length) / length) * (variance - np.cumsum(explained))
    best = int(np.argmin(cost)) + 1
    return right[:best].T @ (projections[:best] / values[:best])


def _fourier(x: Array, inside: NDArray[np.bool_]) -> Array:
    """Return real, then imaginary parts of the unitary Fourier transform inside the band.

    The transform is along the last axis.
    """
    transform = np.fft.rfft(x, norm="ortho")[..., inside]
    return np.concatenate([transform.real, transform.imag], axis=-1)


def _transposed_fourier(parts: Array, inside: NDArray[np.bool_], count: int) -> Array:
    """Transpose of :func:`_fourier`, times a vector."""
    phase = 2 * np.pi / count * np.outer(np.arange(count), np.flatnonzero(inside))
    real, imaginary = np.split(parts, 2)
    return (np.cos(phase) @ real - np.sin(phase) @ imaginary) / np.sqrt(count)


def _generalised_least_squares(
    covariance: Array, fixed: Array, output: Array, noise_variance: float
) -> tuple[Array, Array]:
    """Weights of the fixed regressors.

    The inverse covariance times what they leave of the output.
    """
    factor = cho_factor(covariance + noise_variance * np.eye(len(output)), lower=True)
    weighted = cho_solve(factor, fixed)
    constants = np.linalg.solve(fixed.T @ weighted, weighted.T @ output)
    return constants, cho_solve(factor, output - fixed @ constants)


def _noise_variance(covariance: Array, fixed: Array, output: Array) -> float:
    """Estimate the noise variance from the residual and the effective number of parameters.

    The estimate is a fixed point.

    The residual is M y and the effective number of parameters the trace of I - M, with M = s
    (V^-1 - V^-1 X (X^T V^-1 X)^-1 X^T V^-1), V the covariance with noise of variance s. The
    noise variance is that of real and imaginary part together.
    """
    rows = len(output)
    noise = 1e-3 * float(output @ output) / (rows / 2)
    for _ in range(30):
        inverse = np.linalg.inv(covariance + noise * np.eye(rows))
        weighted = inverse @ fixed
        remainder = noise * (inverse - weighted @ np.linalg.solve(fixed.T @ weighted, weighted.T))
        residual, effective = remainder @ output, rows - float(np.trace(remainder))
        before, noise = noise, 2 * float(residual @ residual) / (rows - effective)
        if abs(noise - before) <= 1e-6 * noise:
            break
    return noise
