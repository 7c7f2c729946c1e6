"""Models of impulse responses that were estimated in windows, and their standard errors."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.methods.base import missing_edge, padded
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.methods.shared.correlations import Windows
from tvsysid.methods.shared.estimates import Errors, impedance_estimates, standard_errors
from tvsysid.methods.shared.residuals import independent_realizations, noise_correlation, residual
from tvsysid.models import Diagnostics, StandardError
from tvsysid.numerics.noise import autocovariance
from tvsysid.signals import Array, Ensemble


def coloured_variances(windows: Windows, noise: Array) -> Array:
    r"""Return the variances (time, 3) of the impedance if neighbouring noise is correlated.

    With :math:`z_r(i) = a^T x_r(i)`, the readout a of a quantity applied to the lagged angles,

    .. math:: \mathrm{var} = \frac{\sigma^2(t)}{L^2}
              \sum_r \sum_{i, j \in W(t)} z_r(i)\, \rho(i - j)\, z_r(j)

    with the autocorrelation :math:`\rho` of the residual at all times, ``noise`` (distance,).
    """
    u, correlation = windows.lagged.u, toeplitz(noise)
    sums = np.empty(windows.impedance.shape)
    for time, readout in enumerate(windows.readout):
        z = u[:, windows.lagged.window(time)] @ readout.T
        mixed = correlation[: z.shape[1], : z.shape[1]] @ z
        sums[time] = np.einsum("rwq,rwq->q", z, mixed)
    return np.asarray(sums * (windows.noise / windows.samples**2)[:, None])


def window_errors(
    windows: Windows, noise: Array, missing: int, enough: NDArray[np.bool_], reason: str
) -> dict[str, StandardError]:
    """Return the standard errors of windows, at the times at which there is ``enough`` data.

    They follow from the autocorrelation of the ``noise`` (distance,). ``missing`` times at either
    end have no window. ``reason`` says what is too little.
    """
    if not enough.any():
        unknown = np.full((len(enough) + 2 * missing, 3), np.nan)
        return standard_errors(unknown, np.inf, absent=reason)
    values = np.sqrt(np.where(enough[:, None], coloured_variances(windows, noise), np.nan))
    return standard_errors(padded(values, missing), padded(windows.freedom, missing)[:, None])


def two_stage_errors(windows: Windows, independent: int, missing: int) -> dict[str, StandardError]:
    r"""Return the standard errors of windows by a reference: the sandwich of realizations' scores.

    .. math:: V = \frac{R}{R - 1} \sum_r s_r s_r^T, \qquad
              s_r = \frac1L \sum_{i \in W} (G z_r(i))\, e_r(i)

    with G the matrix that gives the impedance from the instruments' correlations with the torque,
    and e the residual torque, corrected for the degrees of freedom. The noise may be of any kind.
    """
    z, u, y = windows.lagged.z, windows.lagged.u, windows.lagged.y
    squares = np.empty(windows.impedance.shape)
    for time in range(len(squares)):
        at = windows.lagged.window(time)
        left = y[:, at] - u[:, at] @ windows.weights[time]
        effects = z[:, at] @ windows.on_instruments[time].T
        squares[time] = np.sum(np.einsum("rwq,rw->rq", effects, left) ** 2, axis=0)
    share = len(y) / (independent - 1) if independent > 1 else np.nan
    untaken = np.maximum(1 - windows.rank / windows.independent, 0.1)
    values = np.sqrt(share * squares / untaken[:, None]) / windows.samples[:, None]
    return standard_errors(padded(values, missing), max(1.0, independent - 1.0))


def window_model(
    ensemble: Ensemble, windows: Windows, enough: NDArray[np.bool_], reason: str
) -> ImpulseResponseModel:
    """Return the model of windows, with bands where there is ``enough`` data, or a reference."""
    missing, half = missing_edge(windows.lagged.lags, ensemble), windows.lagged.half
    if windows.lagged.reference is not None:
        errors = partial(two_stage_errors, windows, independent_realizations(ensemble), missing)
    else:
        # So many lagged angles share hardly anything with those of the next sample: the fit takes
        # variance only.
        taken = np.zeros(2 * half + 1)
        taken[0] = np.mean(windows.rank / windows.independent)
        covariance = autocovariance(residual(ensemble, windows.weights), 2 * half)
        noise = noise_correlation(covariance, taken)
        errors = partial(window_errors, windows, noise, missing, enough, reason)
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
