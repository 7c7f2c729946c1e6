"""Estimate an impulse response at each time from the correlations at each time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.methods.base import missing_edge, padded
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.methods.shared.estimates import Errors, impedance_estimates, standard_errors
from tvsysid.methods.shared.residuals import independent_realizations, noise_correlation, residual
from tvsysid.methods.shared.two_stage import UNIDENTIFIABLE, TwoStage, within_reach
from tvsysid.models import Diagnostics, StandardError
from tvsysid.numerics.moments import diagonal_moments, lagged_moments, sliding_sum, time_chunks
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.pseudoinverse import Solution, full, truncated
from tvsysid.numerics.second_order import (
    agreement_of_moments,
    derivative_filters,
    second_order_fit,
    second_order_readout,
)
from tvsysid.signals import Array, Ensemble

Solver = Callable[[Array, Array, Array, Array], Solution]


class Windows(NamedTuple):
    """Least squares in a window about each time whose ``lags`` lie within the context.

    There are ``realizations`` independent realizations. The windows reach ``half`` samples to
    either side, of which ``margin`` may lie beyond the realization. ``weights`` (time, lag) and
    ``rank`` describe the solution. These have shape (time,): the number of ``samples`` in the
    window, the number of ``independent`` ones, the ``noise`` variance and its degrees of
    ``freedom``. ``readout`` (time, 3, lag) gives stiffness, viscosity and inertia from the
    correlations. The ``impedance`` has shape (time, 3). With instruments, ``on_instruments``
    (time, 3, lag) gives it from their correlations with the torque. ``agreement`` (per cent) is how
    much of the torque that depends on the angle a second-order fit explains.
    """

    realizations: int
    lags: int
    half: int
    margin: int
    agreement: float
    weights: Array
    rank: Array
    samples: Array
    independent: Array
    noise: Array
    freedom: Array
    readout: Array
    impedance: Array
    on_instruments: Array


def solve_windows(
    ensemble: Ensemble,
    lags: int,
    half: int,
    solve: Solver = truncated,
    instruments: TwoStage | None = None,
) -> Windows:
    r"""Solve :math:`\varphi(t) = \Phi(t) w(t)` at each time.

    The correlations are means over realizations and a window of time. The window reaches ``half``
    samples to either side, and is cut short where the context ends. ``solve`` gives the solution
    from :math:`\Phi`, :math:`\varphi`, the torque's variance and the number of samples averaged.
    The noise is the residual of all directions of the lagged angles. The residual of the truncated
    solution would be too small, because the same noise chose its directions. With ``instruments``
    the correlations are theirs (:class:`TwoStage`), truncated at a threshold.
    """
    angle, torque, margin = within_reach(ensemble, lags, half)
    times, realizations = angle.shape[1] - 2 * lags, independent_realizations(ensemble)
    derivative = derivative_filters(lags, ensemble.sampling_rate)
    parts, moments = [], np.zeros((2 * lags + 1, 2 * lags + 1))
    for chunk in time_chunks(times - 2 * margin, 2 * lags + 1):
        begin, end = max(0, chunk.start + margin - half), min(times, chunk.stop + margin + half)
        within = slice(begin, end + 2 * lags)
        centres = slice(chunk.start + margin - begin, chunk.stop + margin - begin)
        summed = np.ones(end - begin), *lagged_moments(angle[:, within], torque[:, within], lags)
        samples, *sums = (sliding_sum(each, half, half)[centres] for each in summed)
        phi_uu, phi_uy, square, mean = (
            total / samples.reshape(-1, *[1] * (total.ndim - 1)) for total in sums
        )
        count, independent = samples * len(ensemble), samples * realizations
        projection = np.empty((len(count), 2 * lags + 1, 0))
        if instruments is not None:
            phi_uu, phi_uy, projection = instruments.projected(chunk)
            solution = full(phi_uu, phi_uy, UNIDENTIFIABLE)
        else:
            variance = (square - mean**2) * count / np.maximum(count - 1, 1)
            solution = solve(phi_uu, phi_uy, variance, count)
        readout, fitted = second_order_readout(
            phi_uu, phi_uy, solution.inverse, ensemble.sampling_rate
        )
        freedom = independent - solution.usable
        left = np.maximum(square - solution.explained, 0.0)
        noise = np.where(freedom > 0, left * count / np.maximum(freedom, 1), np.nan)
        impedance = (readout @ phi_uy[..., None])[..., 0]
        # what a second-order fit leaves of the torque, and of its correlations
        fit = second_order_fit(derivative @ phi_uu @ derivative.T, phi_uy @ derivative.T).impedance
        beyond = phi_uy - (phi_uu @ (fit @ derivative)[..., None])[..., 0]
        moments += phi_uu.sum(axis=0)
        second_order = fitted, square - fitted, beyond
        of_noise = count, independent, noise, freedom
        of_readout = readout, impedance, readout @ projection
        parts.append((*second_order, *solution[:2], *of_noise, *of_readout))
    arrays = [np.concatenate(values) for values in zip(*parts, strict=True)]
    known = np.isfinite(arrays[0])
    fitted, left, beyond = (each[known].sum(axis=0) / max(known.sum(), 1) for each in arrays[:3])
    count = times - 2 * margin
    agreement = agreement_of_moments(fitted, beyond, moments / count, left, count * len(ensemble))
    return Windows(realizations, lags, half, margin, agreement, *arrays[3:])


def coloured_variances(windows: Windows, products: Array, noise: Array) -> Array:
    r"""Return the variances (time, 3) of the impedance if neighbouring noise is correlated.

    With :math:`z_r(i) = a^T x_r(i)`, the readout a of a quantity applied to the lagged angles,

    .. math:: \mathrm{var} = \frac{\sigma^2(t)}{L^2}
              \sum_r \sum_{i, j \in W(t)} z_r(i)\, \rho(i - j)\, z_r(j)

    with the autocorrelation :math:`\rho` of the residual at all times, ``noise`` (distance,). The
    ``products`` are those of the angle along the diagonals.
    """
    half, margin, length = windows.half, windows.margin, 2 * windows.lags + 1
    last = len(products) - length  # the latest centre of lagged angles
    correlation = toeplitz(noise)
    out = np.empty((len(windows.weights), 3))
    for time, readout in enumerate(windows.readout[:, :, ::-1]):
        # Where the context ends, a window is cut short.
        begin, end = max(0, time + margin - half), min(last, time + margin + half) + 1
        count = end - begin
        index = np.arange(count + length - 1)
        moments = products[
            begin + np.minimum.outer(index, index), np.abs(np.subtract.outer(index, index))
        ]
        # z at each sample of the window, as weights of the angles about the window
        weights = np.zeros((3, count, len(index)))
        for sample in range(count):
            weights[:, sample, sample : sample + length] = readout
        mixed = weights @ moments @ weights.transpose(0, 2, 1)
        out[time] = np.sum(mixed * correlation[:count, :count], axis=(1, 2)) / count
    return np.asarray(out * (windows.noise / windows.samples)[:, None])


def window_errors(
    windows: Windows,
    products: Array,
    noise: Array,
    missing: int,
    enough: NDArray[np.bool_],
    reason: str,
) -> dict[str, StandardError]:
    """Return the standard errors of windows, at the times at which there is ``enough`` data.

    They follow from the angle's ``products`` along the diagonals (sample, distance) and from the
    autocorrelation of the ``noise`` (distance,). ``missing`` times at either end have no window.
    ``reason`` says what is too little.
    """
    if not enough.any():
        unknown = np.full((len(enough) + 2 * missing, 3), np.nan)
        return standard_errors(unknown, np.inf, absent=reason)
    variances = coloured_variances(windows, products, noise)
    # A negative one is rounding: there is hardly any motion within the lags.
    known = enough[:, None] & (variances >= 0)
    values = np.sqrt(np.where(known, variances, np.nan))
    return standard_errors(padded(values, missing), padded(windows.freedom, missing)[:, None])


def window_model(
    ensemble: Ensemble,
    windows: Windows,
    enough: NDArray[np.bool_],
    reason: str,
    errors: Errors | None = None,
) -> ImpulseResponseModel:
    """Return the model of windows. Its errors are the :func:`window_errors` if none are given."""
    missing, half, lags = missing_edge(windows.lags, ensemble), windows.half, windows.lags
    if errors is None:
        angle, _, _ = within_reach(ensemble, lags, half)
        products = diagonal_moments(angle, angle, 2 * (lags + half))
        # So many lagged angles share hardly anything with those of the next sample: the fit takes
        # variance only.
        taken = np.zeros(2 * half + 1)
        taken[0] = np.mean(windows.rank / windows.independent)
        covariance = autocovariance(residual(ensemble, windows.weights), 2 * half)
        noise = noise_correlation(covariance, taken)
        errors = partial(window_errors, windows, products, noise, missing, enough, reason)
    rank = padded(windows.rank.astype(float), missing)
    details = {"second_order_agreement": windows.agreement}
    diagnostics = Diagnostics(float(windows.rank.mean()), rank, details=details)
    return impulse_response_model(ensemble, windows.weights, windows.impedance, diagnostics, errors)


def impulse_response_model(
    ensemble: Ensemble, weights: Array, impedance: Array, diagnostics: Diagnostics, errors: Errors
) -> ImpulseResponseModel:
    """Return the model of weights (time, lag) at the times whose lags lie within the context.

    The model is NaN at the other times. Stiffness is the area under the response; viscosity and
    inertia are those of the ``impedance`` (time, 3).
    """
    lags = weights.shape[1] // 2
    missing, rate = missing_edge(lags, ensemble), ensemble.sampling_rate
    response = padded(weights * rate, missing)
    over_time = padded(impedance, missing)
    area = response.sum(axis=1) / rate  # equation 20
    over_time = np.column_stack([area, over_time[:, 1:]])
    return ImpulseResponseModel(
        sampling_rate=rate,
        time=ensemble.time,
        estimates=impedance_estimates(over_time, errors),
        impulse_response=response,
        lags=np.arange(-lags, lags + 1) / rate,
        diagnostics=diagnostics,
    )
