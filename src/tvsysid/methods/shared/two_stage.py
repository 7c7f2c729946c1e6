"""Estimate impulse responses in closed loop by two-stage least squares within windows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.methods.base import missing_edge, padded
from tvsysid.methods.shared.estimates import standard_errors
from tvsysid.methods.shared.instrument import reference_around
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.models import StandardError
from tvsysid.numerics.instrument import lag_samples
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    from tvsysid.methods.shared.correlations import Windows

# share of the largest eigenvalue below which lags of the reference are collinear
COLLINEAR = 1e-3
# share of the largest eigenvalue below which directions of the lagged angles are not identifiable
UNIDENTIFIABLE = 1e-2


class TwoStage(NamedTuple):
    r"""Lags of a reference z as instruments for lagged angles u, and the torque y.

    z and u have shape (realization, sample, lag), y (realization, sample). The window about a time
    reaches ``half`` samples to either side, of which ``margin`` may lie beyond the realization.

    .. math:: \Phi = \Phi_{zu}^T \Phi_{zz}^+ \Phi_{zu}, \qquad
              \varphi = \Phi_{zu}^T \Phi_{zz}^+ \varphi_{zy}

    take the place of the correlations of lagged angles.
    """

    z: Array
    u: Array
    y: Array
    half: int
    margin: int

    @classmethod
    def of(cls, ensemble: Ensemble, reference: str, lags: int, half: int) -> TwoStage:
        """Take the lags of a reference as far as windows and lags reach, into the past or 0.3 s."""
        angle, torque, margin = within_reach(ensemble, lags, half)
        late = max(lags, lag_samples(ensemble.sampling_rate)[1])
        whole = reference_around(ensemble, reference, late, 0)
        first = ensemble.context + missing_edge(lags, ensemble) - margin
        whole = whole[:, first : first + late - lags + angle.shape[1]]
        z = sliding_window_view(whole, lags + late + 1, axis=1)[..., ::-1]
        u = sliding_window_view(angle, 2 * lags + 1, axis=1)[..., ::-1]
        return cls(z, u, torque[:, lags : torque.shape[1] - lags], half, margin)

    def windows(self, times: range) -> Iterator[tuple[Array, Array, Array]]:
        """Yield the parts of z, u and y in the windows about some times."""
        for time in times:
            centre = time + self.margin
            window = slice(max(0, centre - self.half), centre + self.half + 1)
            yield self.z[:, window], self.u[:, window], self.y[:, window]

    def projected(self, chunk: slice) -> tuple[Array, Array, Array]:
        """Return the correlations of windows, and the projections (time, lag, lag)."""
        found = []
        for z, u, y in self.windows(range(chunk.start, chunk.stop)):
            flat = z.reshape(y.size, -1)
            values, vectors = np.linalg.eigh(flat.T @ flat / y.size)
            kept = values > COLLINEAR * values[-1]
            whitened = vectors[:, kept] / np.sqrt(values[kept])
            of_u = (flat @ whitened).T @ u.reshape(y.size, -1) / y.size
            projection = of_u.T @ whitened.T
            found.append((of_u.T @ of_u, projection @ (y.ravel() @ flat) / y.size, projection))
        phi_uu, phi_uy, projections = (np.array(each) for each in zip(*found, strict=True))
        return phi_uu, phi_uy, projections

    def standard_errors(self, ensemble: Ensemble, windows: Windows) -> dict[str, StandardError]:
        r"""Return the standard errors of the impedance: the sandwich of the realizations' scores.

        .. math:: V = \frac{R}{R - 1} \sum_r s_r s_r^T, \qquad
                  s_r = \frac1L \sum_{i \in W} (G z_r(i))\, e_r(i)

        with G the matrix that gives the impedance from the instruments' correlations with the
        torque, and e the residual torque, corrected for the degrees of freedom. The noise may be
        of any kind.
        """
        squares = np.empty(windows.impedance.shape)
        for time, (z, u, y) in enumerate(self.windows(range(len(squares)))):
            left = y - u @ windows.weights[time]
            effects = z @ windows.on_instruments[time].T
            scores = np.einsum("rwq,rw->rq", effects, left) / y.size
            squares[time] = np.sum(scores**2, axis=0)
        independent = independent_realizations(ensemble)
        share = len(ensemble) / (independent - 1) if independent > 1 else np.nan
        untaken = np.maximum(1 - windows.rank / windows.independent, 0.1)
        values = np.sqrt(share * squares / untaken[:, None])
        padding = (ensemble.samples - len(values)) // 2
        return standard_errors(padded(values, padding), max(1.0, independent - 1.0))


def within_reach(ensemble: Ensemble, lags: int, half: int) -> tuple[Array, Array, int]:
    """Return angle and torque as far as lags and window reach, and the margin of the window.

    The margin is the number of samples beyond the realization that a window may use: the context
    that the lags leave.
    """
    margin = min(half, max(0, ensemble.context - lags))
    first = ensemble.context + missing_edge(lags, ensemble) - margin - lags
    reach = slice(first, ensemble.angle.shape[1] - first)
    return ensemble.angle[:, reach], ensemble.torque[:, reach], margin
