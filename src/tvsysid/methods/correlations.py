"""From correlations at each time to an impulse response at each time: what the impulse-response methods share."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.impedance import agreement, second_order_readout, static_stiffness
from tvsysid.methods.base import missing_edge, padded
from tvsysid.methods.residuals import correlation, residual
from tvsysid.models import Diagnostics, ImpulseResponseModel, Spread
from tvsysid.numerics.moments import lagged_moments, sliding_sum, time_chunks, window_moments
from tvsysid.numerics.pseudoinverse import Solution
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]
Solver = Callable[[slice, Array, Array, Array, Array], Solution]


class Windows(NamedTuple):
    """Least squares in a window about each time.

    ``weights`` (time, lag) and ``rank`` (time,) of the solution; ``samples`` that it was found from, ``noise``
    variance, the power of the torque that a second-order fit ``fitted`` and what it explains ``beyond``, all (time,);
    ``readout`` (time, 3, lag) by which stiffness, viscosity and inertia follow from the correlations, the ``impedance``
    itself and its ``white`` variances, were the noise white, both (time, 3).
    """

    weights: Array
    rank: Array
    samples: Array
    noise: Array
    fitted: Array
    beyond: Array
    readout: Array
    impedance: Array
    white: Array


def solve_windows(ensemble: Ensemble, lags: int, half: int, solve: Solver) -> Windows:
    r"""Solve :math:`\varphi(t) = \Phi(t) w(t)`, the correlations being means over realizations and a window of time.

    Parameters
    ----------
    ensemble
        Realizations.
    lags
        Lags to either side, in samples.
    half
        Samples of the window before and after its centre; it is cut short where the context ends.
    solve
        From times, :math:`\Phi`, :math:`\varphi`, the torque's variance and the number of samples averaged to the
        solution.

    Returns
    -------
    Windows
        For each time whose lags lie within the context.
    """
    angle, torque, margin = _within_reach(ensemble, lags, half)
    times = angle.shape[1] - 2 * lags
    rate = ensemble.sampling_rate

    parts = []
    for chunk in time_chunks(times - 2 * margin, 2 * lags + 1):
        begin, end = max(0, chunk.start + margin - half), min(times, chunk.stop + margin + half)
        within = slice(begin, end + 2 * lags)
        centres = slice(chunk.start + margin - begin, chunk.stop + margin - begin)
        sums = [
            sliding_sum(moments, half, half)[centres]
            for moments in (np.ones(end - begin), *lagged_moments(angle[:, within], torque[:, within], lags))
        ]
        samples = sums[0]
        phi_uu, phi_uy, square, mean = (total / samples.reshape(-1, *[1] * (total.ndim - 1)) for total in sums[1:])
        count = samples * len(ensemble)
        variance = (square - mean**2) * count / np.maximum(count - 1, 1)
        weights, rank, inverse = solve(chunk, phi_uu, phi_uy, variance, count)
        readout, fitted, beyond = second_order_readout(phi_uu, phi_uy, inverse, rate)
        left = np.maximum(square - np.einsum("tl,tl->t", weights, phi_uy), 0.0)
        noise = np.where(count > rank, left * count / np.maximum(count - rank, 1), np.nan)
        impedance = (readout @ phi_uy[..., None])[..., 0]
        white = (noise / count)[:, None] * np.einsum("tmk,tmk->tm", readout @ phi_uu, readout)
        parts.append((weights, rank, count, noise, fitted, beyond, readout, impedance, white))
    return Windows(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def coloured_variances(ensemble: Ensemble, lags: int, half: int, windows: Windows) -> Array:
    r"""Variances of stiffness, viscosity and inertia when the noise of neighbouring samples is correlated.

    With :math:`z_r(i) = a^T x_r(i)`, the readout a of a quantity applied to the lagged angles,

    .. math:: \mathrm{var} = \frac{\sigma^2(t)}{L^2} \sum_r \sum_{i, j \in W(t)} z_r(i)\, \rho(i - j)\, z_r(j)

    which follows from the angle's second moments; the autocorrelation :math:`\rho` is that of the residual at all
    times.

    Returns
    -------
    Array
        Shape (time, 3).
    """
    angle, _, margin = _within_reach(ensemble, lags, half)
    left = residual(ensemble, windows.weights, lags)
    # So many lagged angles share hardly anything with those of the next sample: the fit takes variance only.
    noise = correlation(left, np.eye(2 * half + 1)[0] * float(np.mean(windows.rank / windows.samples)))
    values, vectors = np.linalg.eigh(toeplitz(noise))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T  # root.T @ root is the noise's correlation matrix
    # A window that is cut short has no angles there: zeros drop out of the sums.
    u = np.pad(angle, ((0, 0), (half - margin, half - margin)))
    times, length = angle.shape[1] - 2 * lags, 2 * (lags + half) + 1
    offsets = np.arange(-half, half + 1)
    out = np.empty((len(windows.weights), 3))
    for chunk in time_chunks(len(out), length):
        near = u[:, chunk.start : chunk.stop + length - 1]
        moments = window_moments(near, near, lags + half, lags + half)
        place = np.arange(chunk.start, chunk.stop)[:, None] + margin + offsets
        inside = (place >= 0) & (place < times)
        for quantity in range(3):
            # Row o holds the readout's weights on the angles about the window's sample o.
            rows = np.zeros((chunk.stop - chunk.start, len(offsets), length))
            by_time, by_row, by_column = rows.strides
            band = as_strided(rows, (len(rows), len(offsets), 2 * lags + 1), (by_time, by_row + by_column, by_column))
            band[:] = windows.readout[chunk, quantity, None, ::-1]
            rows[~inside] = 0.0
            mixed = root @ rows
            total = np.einsum("tok,tok->t", mixed @ moments, mixed)
            out[chunk, quantity] = total / inside.sum(axis=1)
    return np.asarray(out * (windows.noise / windows.samples)[:, None])


def window_spread(ensemble: Ensemble, lags: int, windows: Windows, variances: Array) -> Spread:
    """Random error from variances (time, 3) at the times whose lags lie within the context."""
    missing = missing_edge(lags, ensemble)
    freedom = np.broadcast_to((windows.samples - windows.rank)[:, None], variances.shape)
    return Spread(padded(np.sqrt(variances), missing).T, padded(freedom, missing).T)


def window_diagnostics(ensemble: Ensemble, windows: Windows, lags: int) -> Diagnostics:
    """Diagnostics of a solution that has a rank at each time whose lags lie within the context."""
    rank = padded(windows.rank.astype(float), missing_edge(lags, ensemble))
    chance = windows.noise * np.maximum(windows.rank - 3, 0) / windows.samples
    # With few samples for so many lags the noise, and so chance, comes out too small.
    chance[windows.samples < 2 * (2 * lags + 1)] = np.nan
    details = {"second_order_agreement": agreement(windows.fitted, windows.beyond, chance)}
    return Diagnostics(float(windows.rank.mean()), rank, details=details)


def impulse_response_model(
    method: str,
    ensemble: Ensemble,
    weights: Array,
    impedance: Array,
    lags: int,
    diagnostics: Diagnostics,
    spread: Spread | Callable[[], Spread],
) -> ImpulseResponseModel:
    """Model from weights (time, lag) at the times whose lags lie within the context; NaN at the others.

    Stiffness is the area under the response; viscosity and inertia are those of the ``impedance`` (time, 3).
    """
    missing = missing_edge(lags, ensemble)
    response = padded(weights * ensemble.sampling_rate, missing)
    return ImpulseResponseModel(
        method=method,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        stiffness=static_stiffness(response, 1 / ensemble.sampling_rate),
        viscosity=padded(impedance[:, 1], missing),
        inertia=padded(impedance[:, 2], missing),
        impulse_response=response,
        lags=np.arange(-lags, lags + 1) / ensemble.sampling_rate,
        diagnostics=diagnostics,
        spread=spread,
    )


def _within_reach(ensemble: Ensemble, lags: int, half: int) -> tuple[Array, Array, int]:
    """Angle and torque as far as lags and window reach, and the samples beyond the realization that a window has."""
    missing = missing_edge(lags, ensemble)
    # Beyond the realization, the window may use the context that the lags leave.
    margin = min(half, max(0, ensemble.context - lags))
    first = ensemble.context + missing - margin - lags
    reach = slice(first, ensemble.angle.shape[1] - first)
    return ensemble.angle[:, reach], ensemble.torque[:, reach], margin
