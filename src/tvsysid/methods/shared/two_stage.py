"""Estimate impulse responses in closed loop by two-stage least squares within windows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tvsysid.methods.base import padded
from tvsysid.methods.shared.estimates import standard_errors
from tvsysid.models import StandardError
from tvsysid.numerics import Array
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, sliding_sum, window_moments

if TYPE_CHECKING:
    from tvsysid.methods.shared.correlations import Windows

# share of the largest eigenvalue below which lags of the reference are collinear
COLLINEAR = 1e-3
# share of the largest eigenvalue below which directions of the lagged angles are not identifiable
UNIDENTIFIABLE = 1e-2


class LaggedReference(NamedTuple):
    r"""Lags of a reference as instruments for lagged angles, ``lags`` to either side.

    ``angle`` and ``torque`` (realization, time) as far as windows and lags reach; ``reference``
    with as many more samples before them as it has more lags than the angle.

    .. math:: \Phi = \Phi_{zu}^T \Phi_{zz}^+ \Phi_{zu}, \qquad
              \varphi = \Phi_{zu}^T \Phi_{zz}^+ \varphi_{zy}

    take the place of the correlations of lagged angles, sums over a window being taken before.
    """

    reference: Array
    angle: Array
    torque: Array
    lags: int

    @property
    def more(self) -> int:
        """Return how many more lags the reference has than the angle."""
        return int(self.reference.shape[1] - self.angle.shape[1])

    def projected(
        self, begin: int, end: int, half: int, centres: slice
    ) -> tuple[Array, Array, Array]:
        """Return the correlations of windows, and the projection (time, lag, lag) on instruments.

        The windows lie about ``centres`` among the times from ``begin`` to ``end``.
        """
        lags, more = self.lags, self.more
        z = self.reference[:, begin : end + 2 * lags + more]
        u = np.pad(self.angle[:, begin : end + 2 * lags], ((0, 0), (more, 0)))
        y = self.torque[:, begin + lags : end + lags]
        samples = sliding_sum(np.ones(end - begin), half, half)[centres]
        moments = (
            window_moments(z, z, lags + more, lags)[:, ::-1, ::-1],
            window_moments(z, u, lags + more, lags)[:, ::-1, : more - 1 if more else None : -1],
            diagonal_moments(y, z, 2 * lags + more)[:, ::-1, None],
        )
        of_z, with_u, with_y = (
            sliding_sum(each, half, half)[centres] / samples[:, None, None] for each in moments
        )
        values, vectors = np.linalg.eigh(of_z)
        kept = values > COLLINEAR * values[:, -1:]
        whitened = vectors * np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)[:, None]
        of_u = whitened.transpose(0, 2, 1) @ with_u
        projection = of_u.transpose(0, 2, 1) @ whitened.transpose(0, 2, 1)
        return of_u.transpose(0, 2, 1) @ of_u, (projection @ with_y)[..., 0], projection

    def standard_errors(self, windows: Windows, times: int) -> dict[str, StandardError]:
        r"""Return the standard errors of the impedance: the sandwich of the realizations' scores.

        .. math:: V = \frac{R}{R - 1} \sum_r s_r s_r^T, \qquad
                  s_r = \frac1L \sum_{i \in W} (G z_r(i))\, e_r(i)

        with G the matrix that gives the impedance from the instruments' correlations with the
        torque, and e the residual torque, corrected for the degrees of freedom. The noise may be
        of any kind. ``times`` is the number of times of a realization.
        """
        count, cut, length = len(windows.weights), windows.half - windows.margin, 2 * self.lags + 1
        angle, torque, reference = (
            np.pad(each, ((0, 0), (cut, cut))) for each in (self.angle, self.torque, self.reference)
        )
        scores = np.zeros((3, len(angle), count))
        for first in range(2 * windows.half + 1):  # sample of each window
            stop = first + count + length - 1
            left = torque[:, first + self.lags : stop - self.lags]
            left = left - convolve_lags(angle[:, first:stop], windows.weights)
            place = np.arange(first - cut, first - cut + count)
            # Where the context ends, a window is cut short.
            left[:, (place < 0) | (place > self.angle.shape[1] - length)] = 0.0
            late = reference[:, first : stop + self.more]
            for quantity in range(3):
                weights = windows.on_instruments[:, quantity]
                scores[quantity] += left * convolve_lags(late, weights)
        independent = windows.realizations
        share = len(self.angle) / (independent - 1) if independent > 1 else np.nan
        untaken = np.maximum(1 - windows.rank / windows.independent, 0.1)
        values = np.sqrt(share * np.sum(scores**2, axis=1) / untaken) / windows.samples
        padding = (times - count) // 2
        return standard_errors(padded(values.T, padding), max(1.0, independent - 1.0))
