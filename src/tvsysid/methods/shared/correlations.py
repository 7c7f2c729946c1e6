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
from tvsysid.methods.shared.instrument import reference_around
from tvsysid.methods.shared.residuals import independent_realizations, noise_correlation, residual
from tvsysid.methods.shared.two_stage import UNIDENTIFIABLE, LaggedReference
from tvsysid.models import Diagnostics, StandardError
from tvsysid.numerics.instrument import lag_samples
from tvsysid.numerics.moments import (
    diagonal_moments,
    lagged_moments,
    sliding_sum,
    time_chunks,
)
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.pseudoinverse import Solution, full, truncated
from tvsysid.numerics.second_order import agreement, second_order_readout
from tvsysid.signals import Array, Ensemble

Solver = Callable[[Array, Array, Array, Array], Solution]


class Windows(NamedTuple):
    """Least squares in a window about each time whose ``lags`` lie within the context.

    There are ``realizations`` realizations. The windows reach ``half`` samples to either side, of
    which ``margin`` may lie beyond the realization. ``weights`` (time, lag) and ``rank`` describe
    the solution. These have shape (time,): the number of ``samples`` in the window, the number of
    ``independent`` ones, the ``noise`` variance, its degrees of ``freedom``, and three powers of
    the torque. A second-order fit explains ``fitted``, lagged angles explain ``beyond`` more, and
    noise would make them explain ``chance`` more. ``readout`` (time, 3, lag) gives stiffness,
    viscosity and inertia from the correlations. The ``impedance`` has shape (time, 3). With
    instruments, ``on_instruments`` (time, 3, lag) gives it from their correlations with the torque.
    """

    realizations: int
    lags: int
    half: int
    margin: int
    weights: Array
    rank: Array
    samples: Array
    independent: Array
    noise: Array
    freedom: Array
    fitted: Array
    beyond: Array
    chance: Array
    readout: Array
    impedance: Array
    on_instruments: Array

    def noise_correlation(self, ensemble: Ensemble) -> Array:
        """Return the autocorrelation of the noise, from the residual of the windows.

        It reaches to twice the lags plus four times ``half``.
        """
        reach = 2 * (self.lags + 2 * self.half)
        # So many lagged angles share hardly anything with those of the next sample: the fit takes
        # variance only.
        taken = np.zeros(reach + 1)
        taken[0] = np.mean(self.rank / self.independent)
        return noise_correlation(autocovariance(residual(ensemble, self.weights), reach), taken)


def solve_windows(
    ensemble: Ensemble,
    lags: int,
    half: int,
    solve: Solver = truncated,
    instruments: LaggedReference | None = None,
) -> Windows:
    r"""Solve :math:`\varphi(t) = \Phi(t) w(t)` at each time.

    The correlations are means over realizations and a window of time. The window reaches ``half``
    samples to either side, and is cut short where the context ends. ``solve`` gives the solution
    from :math:`\Phi`, :math:`\varphi`, the torque's variance and the number of samples averaged.
    The noise is the residual of all directions of the lagged angles. The residual of the truncated
    solution would be too small, because the same noise chose its directions. With ``instruments``
    the correlations are theirs (:class:`LaggedReference`), truncated at a threshold.
    """
    angle, torque, margin = _within_reach(ensemble, lags, half)
    times, realizations = angle.shape[1] - 2 * lags, independent_realizations(ensemble)
    parts = []
    for chunk in time_chunks(times - 2 * margin, 2 * lags + 1):
        begin, end = max(0, chunk.start + margin - half), min(times, chunk.stop + margin + half)
        within = slice(begin, end + 2 * lags)
        centres = slice(chunk.start + margin - begin, chunk.stop + margin - begin)
        signals = angle[:, within], torque[:, within]
        summed = (np.ones(end - begin), *lagged_moments(*signals, lags))
        samples, *sums = (sliding_sum(moments, half, half)[centres] for moments in summed)
        phi_uu, phi_uy, square, mean = (
            total / samples.reshape(-1, *[1] * (total.ndim - 1)) for total in sums
        )
        count, independent = samples * len(ensemble), samples * realizations
        projection = np.empty((len(count), 2 * lags + 1, 0))
        if instruments is not None:
            phi_uu, phi_uy, projection = instruments.projected(begin, end, half, centres)
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
        chance = noise * np.maximum(solution.usable - 3, 0) / count
        impedance = (readout @ phi_uy[..., None])[..., 0]
        of_noise = noise, freedom, fitted, solution.explained - fitted, chance
        of_readout = readout, impedance, readout @ projection
        parts.append((*solution[:2], count, independent, *of_noise, *of_readout))
    arrays = (np.concatenate(values) for values in zip(*parts, strict=True))
    return Windows(realizations, lags, half, margin, *arrays)


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
    correlation = toeplitz(noise[: 2 * half + 1])
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
    missing, noise = missing_edge(windows.lags, ensemble), windows.noise_correlation(ensemble)
    if errors is None:
        angle, _, _ = _within_reach(ensemble, windows.lags, windows.half)
        products = diagonal_moments(angle, angle, 2 * (windows.lags + windows.half))
        errors = partial(window_errors, windows, products, noise, missing, enough, reason)
    # With few samples for so many lags the noise, and so chance, is hardly known.
    chance = np.where(windows.samples < 2 * (2 * windows.lags + 1), np.nan, windows.chance)
    details = {
        "second_order_agreement": agreement(windows.fitted, windows.beyond, chance),
        "second_order_agreement_error": _agreement_error(windows, chance, noise),
    }
    rank = padded(windows.rank.astype(float), missing)
    diagnostics = Diagnostics(float(windows.rank.mean()), rank, details=details)
    return impulse_response_model(ensemble, windows.weights, windows.impedance, diagnostics, errors)


def _agreement_error(windows: Windows, chance: Array, noise: Array) -> float:
    r"""Return the standard error of the second-order agreement in per cent.

    The joint is taken to be of second order. By noise alone, m directions of lagged angles explain
    some torque beyond the second-order fit. At one time, the variance of its power is
    :math:`2 c^2 (1 / m + 1 / \nu)`, with c its mean and :math:`\nu` the noise's degrees of
    freedom. At times d samples apart, the powers are correlated as far as the times share lagged
    angles, and by the squared correlation of their noise.
    """
    known = np.isfinite(windows.fitted) & np.isfinite(windows.beyond) & (chance > 0)
    if not known.any():
        return float("nan")
    # noiseless times are not among them
    directions = chance[known] / windows.noise[known] * windows.samples[known]
    variance = np.sum(2 * chance[known] ** 2 * (1 / directions + 1 / windows.freedom[known]))
    span = 2 * (windows.lags + windows.half) + 1
    window = np.bartlett(4 * windows.half + 3)[1:-1]
    smooth = np.convolve(np.r_[noise[:0:-1], noise], window, mode="valid")[-span:]
    shared = (smooth / smooth[0]) ** 2 * (1 - np.arange(span) / span)
    total = float(np.sum((windows.fitted + windows.beyond)[known]))
    error = np.sqrt(variance * (2 * shared.sum() - 1))
    return float(100 * error / total) if total > 0 else float("nan")


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


def lagged_reference(ensemble: Ensemble, reference: str, lags: int, half: int) -> LaggedReference:
    """Return the lags of a reference as far as windows and lags reach.

    See :meth:`LaggedReference.projected`.
    """
    angle, torque, margin = _within_reach(ensemble, lags, half)
    late = max(lags, lag_samples(ensemble.sampling_rate)[1])
    first = ensemble.context + missing_edge(lags, ensemble) - margin - lags
    whole = reference_around(ensemble, reference, late, 0)
    return LaggedReference(
        whole[:, first + lags : first + late + angle.shape[1]], angle, torque, lags
    )


def _within_reach(ensemble: Ensemble, lags: int, half: int) -> tuple[Array, Array, int]:
    """Return angle and torque as far as lags and window reach, and the margin of the window.

    The margin is the number of samples beyond the realization that a window may use.
    """
    missing = missing_edge(lags, ensemble)
    # Beyond the realization, the window may use the context that the lags leave.
    margin = min(half, max(0, ensemble.context - lags))
    first = ensemble.context + missing - margin - lags
    reach = slice(first, ensemble.angle.shape[1] - first)
    return ensemble.angle[:, reach], ensemble.torque[:, reach], margin
