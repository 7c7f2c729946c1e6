"""Estimate an impulse response at each time from correlations in a window about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import toeplitz

from tvsysid.methods.base import missing_edge, padded
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.methods.shared.estimates import Errors, impedance_estimates, standard_errors
from tvsysid.methods.shared.residuals import (
    independent_realizations,
    noise_correlation,
    noise_ratio,
    residual,
    residual_agreement,
    second_order_residual,
)
from tvsysid.models import Diagnostics, StandardError
from tvsysid.numerics.moments import lagged_moments, sliding_sum, time_chunks, window_moments
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.pseudoinverse import Solution, truncated
from tvsysid.numerics.second_order import second_order_readout
from tvsysid.signals import Array, Ensemble

Solver = Callable[[Array, Array, Array, Array], Solution]


class Windows(NamedTuple):
    """Least squares in a window about each time whose lags lie within the context.

    ``weights`` (time, lag) and ``rank`` describe the solution. These have shape (time,): the number
    of ``samples`` in the window, the number of ``independent`` ones, the ``noise`` variance and its
    degrees of ``freedom``. ``fit`` (time, 3) is a second-order fit. ``readout`` (time, 3, lag)
    times the correlations with the torque gives the area under the response as stiffness, and the
    fit's viscosity and inertia.
    """

    weights: Array
    rank: Array
    samples: Array
    independent: Array
    noise: Array
    freedom: Array
    readout: Array
    fit: Array


def solve_windows(ensemble: Ensemble, lags: int, half: int, solve: Solver = truncated) -> Windows:
    r"""Solve :math:`\varphi(t) = \Phi(t) w(t)` at each time.

    The correlations are means over realizations and a window of time. The window reaches ``half``
    samples to either side, and is cut short where the context ends. ``solve`` gives the solution
    from :math:`\Phi`, :math:`\varphi`, the torque's variance and the number of samples averaged.
    The noise is the residual of the solution without truncation. With truncation, it would be too
    small for the rank, because the same noise decides which directions are kept.
    """
    realizations = independent_realizations(ensemble)
    parts = []
    for samples, phi_uu, phi_uy, square, mean in window_means(ensemble, lags, half):
        count = samples * len(ensemble)
        independent = samples * realizations
        variance = (square - mean**2) * count / np.maximum(count - 1, 1)
        solution = solve(phi_uu, phi_uy, variance, count)
        fit, readout = second_order_readout(phi_uu, phi_uy, solution.area, ensemble.sampling_rate)
        freedom = independent - solution.usable
        unexplained = count * np.maximum(square - solution.explained, 0.0)
        noise = np.where(freedom > 0, unexplained / np.maximum(freedom, 1), np.nan)
        rank = solution.rank
        parts.append((solution.weights, rank, count, independent, noise, freedom, readout, fit))
    return Windows(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def window_means(ensemble: Ensemble, lags: int, half: int) -> Iterator[tuple[Array, ...]]:
    """Yield means over realizations and a window about each time, for chunks of time.

    The first array is the number of samples in the window. The others are the means of
    :func:`tvsysid.numerics.moments.lagged_moments`.
    """
    angle, torque, margin = _within_reach(ensemble, lags, half)
    times = angle.shape[1] - 2 * (lags + margin)
    # Indices count from sample ``lags`` of the angle, the first with all lags. The first time has
    # the index ``margin``.
    length = times + 2 * margin
    for chunk in time_chunks(times, 2 * lags + 1):
        begin = max(0, chunk.start + margin - half)
        end = min(length, chunk.stop + margin + half)
        within = slice(begin, end + 2 * lags)
        centres = slice(chunk.start + margin - begin, chunk.stop + margin - begin)
        summed = np.ones(end - begin), *lagged_moments(angle[:, within], torque[:, within], lags)
        samples, *sums = (sliding_sum(each, half, half)[centres] for each in summed)
        means = (total / samples.reshape(-1, *[1] * (total.ndim - 1)) for total in sums)
        yield samples, *means


def _within_reach(ensemble: Ensemble, lags: int, half: int) -> tuple[Array, Array, int]:
    """Return angle and torque as far as lags and windows reach.

    Return also the margin: the number of context samples at either end that windows may use. The
    lags need the rest.
    """
    margin = min(half, max(0, ensemble.context - lags))
    first = ensemble.context + missing_edge(lags, ensemble) - margin - lags
    reach = slice(first, ensemble.angle.shape[1] - first)
    return ensemble.angle[:, reach], ensemble.torque[:, reach], margin


def window_model(
    ensemble: Ensemble, instrument: Ensemble, windows: Windows, half: int, needed: int
) -> ImpulseResponseModel:
    """Return the model of ``windows``, which were solved for the ensemble ``instrument``.

    ``instrument`` has the angle that the reference predicts, if there is one. There is a band where
    a window has at least ``needed`` independent samples.
    """
    lags = windows.weights.shape[1] // 2
    missing = missing_edge(lags, ensemble)
    residuals, first = second_order_residual(instrument, padded(windows.fit, missing))
    details = {"second_order_agreement": residual_agreement(instrument, residuals, first)}
    rank = padded(windows.rank.astype(float), missing)
    diagnostics = Diagnostics(float(windows.rank.mean()), rank, details=details)
    enough = windows.independent >= needed
    reason = ""
    if not enough.any():
        reason = (
            f"{windows.independent.max():.0f} independent samples are too few for {2 * lags + 1} "
            f"lags, where {needed} are needed to estimate the noise; record more, or shorten "
            "max_lag"
        )

    def errors() -> dict[str, StandardError]:
        ratio = noise_ratio(*(residual(each, windows.weights) for each in (ensemble, instrument)))
        variances = ratio * coloured_variances(instrument, windows, half)
        variances[~enough] = np.nan
        values, freedom = (padded(each, missing) for each in (np.sqrt(variances), windows.freedom))
        return standard_errors(values, freedom[:, None], absent=reason)

    return impulse_response_model(instrument, windows.weights, windows.fit, diagnostics, errors)


def coloured_variances(ensemble: Ensemble, windows: Windows, half: int) -> Array:
    r"""Return the variances (time, 3) of the impedance if neighbouring noise is correlated.

    With :math:`z_r(i) = a^T x_r(i)`, the readout a of a quantity applied to the lagged angles,

    .. math:: \mathrm{var} = \frac{\sigma^2(t)}{L^2}
              \sum_r \sum_{i, j \in W(t)} z_r(i)\, \rho(i - j)\, z_r(j)

    with the autocorrelation :math:`\rho` of the residual at all times.
    """
    lags = windows.weights.shape[1] // 2
    # A fit lowers the autocovariance of the residual most at lag 0. That at other lags is hardly
    # lower and is not corrected.
    width = 2 * half + 1
    absorbed = np.zeros(width)
    absorbed[0] = np.mean(windows.rank / windows.independent)
    covariance = autocovariance(residual(ensemble, windows.weights), 2 * half)
    root = np.linalg.cholesky(toeplitz(noise_correlation(covariance, absorbed)))
    angle, _, margin = _within_reach(ensemble, lags, half)
    times = len(windows.fit)
    cut = half - margin  # samples by which the first and the last window are cut short
    sums = []
    # Windows near the ends are cut short, each to another length. The others have one length.
    edges = [time for time in range(times + 1) if not cut < time < times - cut]
    for start, stop in pairwise(edges):
        begin = max(0, start - cut)
        end = min(start - cut + width, times + 2 * margin)
        u = sliding_window_view(angle, end - begin, axis=1)[
            :, begin : begin + stop - start + 2 * lags
        ]
        mixed = np.tensordot(root[: end - begin], u, (0, 2)).reshape(-1, u.shape[1])
        moments = len(mixed) * window_moments(mixed, mixed, lags, lags)
        readout = windows.readout[start:stop, :, ::-1]  # like the moments, in order of time
        sums.append(np.sum(readout @ moments * readout, axis=2))
    variances = np.concatenate(sums) * (windows.noise / windows.samples**2)[:, None]
    return np.maximum(variances, 0.0)


def impulse_response_model(
    ensemble: Ensemble,
    weights: Array,
    impedance: Array,
    diagnostics: Diagnostics,
    errors: Errors,
) -> ImpulseResponseModel:
    """Return the model of weights (time, lag) at the times whose lags lie within the context.

    The model is NaN at the other times. Stiffness is the area under the response; viscosity and
    inertia are those of the ``impedance`` (time, 3).
    """
    lags = weights.shape[1] // 2
    missing = missing_edge(lags, ensemble)
    rate = ensemble.sampling_rate
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
