"""From correlations at each time to an impulse response at each time: what the impulse-response methods share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tvsysid.impedance import static_stiffness
from tvsysid.methods.base import missing_edge, padded
from tvsysid.models import Diagnostics, ImpulseResponseModel
from tvsysid.numerics.moments import lagged_moments, sliding_sum, time_chunks
from tvsysid.numerics.pseudoinverse import Solution
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]
Solver = Callable[[Array, Array, Array, Array], Solution]


def solve_windows(ensemble: Ensemble, lags: int, half: int, solve: Solver) -> Solution:
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
        From :math:`\Phi`, :math:`\varphi`, the torque's variance and the number of samples averaged to the solution.

    Returns
    -------
    Solution
        For each time whose lags lie within the context.
    """
    missing = missing_edge(lags, ensemble)
    # Beyond the realization, the window may use the context that the lags leave.
    margin = min(half, max(0, ensemble.context - lags))
    first = ensemble.context + missing - margin - lags
    reach = slice(first, ensemble.angle.shape[1] - first)
    angle, torque = ensemble.angle[:, reach], ensemble.torque[:, reach]
    times = angle.shape[1] - 2 * lags

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
        parts.append(solve(phi_uu, phi_uy, variance, count))
    return Solution(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def rank_diagnostics(ensemble: Ensemble, solution: Solution, lags: int) -> Diagnostics:
    """Diagnostics of a solution that has a rank at each time whose lags lie within the context."""
    rank = padded(solution.rank.astype(float), missing_edge(lags, ensemble))
    return Diagnostics(float(solution.rank.mean()), rank)


def impulse_response_model(
    method: str, ensemble: Ensemble, weights: Array, lags: int, diagnostics: Diagnostics
) -> ImpulseResponseModel:
    """Model from weights (time, lag) at the times whose lags lie within the context; NaN at the others."""
    response = padded(weights * ensemble.sampling_rate, missing_edge(lags, ensemble))
    unknown = np.full(ensemble.samples, np.nan)
    return ImpulseResponseModel(
        method=method,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        stiffness=static_stiffness(response, 1 / ensemble.sampling_rate),
        viscosity=unknown,
        inertia=unknown,
        impulse_response=response,
        lags=np.arange(-lags, lags + 1) / ensemble.sampling_rate,
        diagnostics=diagnostics,
    )
