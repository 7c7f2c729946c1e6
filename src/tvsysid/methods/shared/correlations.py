"""Estimate an impulse response at each time from the correlations at each time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.methods.base import missing_edge
from tvsysid.methods.shared.instrument import reference_around
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.numerics.instrument import lag_samples
from tvsysid.numerics.moments import lagged_moments, sliding_sum, time_chunks
from tvsysid.numerics.pseudoinverse import Solution, full, truncated
from tvsysid.numerics.second_order import (
    agreement_of_moments,
    derivative_filters,
    second_order_fit,
    second_order_readout,
)
from tvsysid.signals import Array, Ensemble

# share of the largest eigenvalue below which lags of the reference are collinear
COLLINEAR = 1e-3
# share of the largest eigenvalue below which directions of the lagged angles are not identifiable
UNIDENTIFIABLE = 1e-2

Solver = Callable[[Array, Array, Array, Array], Solution]


class Lagged(NamedTuple):
    """Angle, torque and reference as far as windows about each time and ``lags`` reach.

    The windows reach ``half`` samples to either side, of which ``margin`` may lie beyond the
    realization: the context that the lags leave. A reference begins earlier than the angle, by as
    many samples as it has more lags.
    """

    angle: Array
    torque: Array
    reference: Array | None
    lags: int
    half: int
    margin: int

    @classmethod
    def of(cls, ensemble: Ensemble, lags: int, half: int, reference: str | None) -> Lagged:
        """Take what windows and lags reach; the reference's lags go back 0.3 s."""
        margin = min(half, max(0, ensemble.context - lags))
        first = ensemble.context + missing_edge(lags, ensemble) - margin
        reach = slice(first - lags, ensemble.angle.shape[1] - first + lags)
        angle, torque = ensemble.angle[:, reach], ensemble.torque[:, reach]
        earlier = None
        if reference is not None:
            late = max(lags, lag_samples(ensemble.sampling_rate)[1])
            whole = reference_around(ensemble, reference, late, 0)
            earlier = whole[:, first : first + late - lags + angle.shape[1]]
        return cls(angle, torque, earlier, lags, half, margin)

    @property
    def times(self) -> int:
        """Return the number of times with a window."""
        return int(self.angle.shape[1]) - 2 * (self.lags + self.margin)

    @property
    def u(self) -> Array:
        """Return the lagged angles, shape (realization, sample, lag)."""
        return sliding_window_view(self.angle, 2 * self.lags + 1, axis=1)[..., ::-1]

    @property
    def z(self) -> Array:
        """Return the lags of the reference, or the lagged angles, (realization, sample, lag)."""
        if self.reference is None:
            return self.u
        length = self.reference.shape[1] - self.angle.shape[1] + 2 * self.lags + 1
        return sliding_window_view(self.reference, length, axis=1)[..., ::-1]

    @property
    def y(self) -> Array:
        """Return the torque, shape (realization, sample)."""
        return self.torque[:, self.lags : self.torque.shape[1] - self.lags]

    def window(self, time: int) -> slice:
        """Return the samples of the window about a time. It is cut short where context ends."""
        centre = time + self.margin
        return slice(max(0, centre - self.half), centre + self.half + 1)

    def projected(self, times: slice) -> tuple[Array, Array, Array]:
        r"""Return correlations by instruments, and projections on these (time, lag, lag).

        .. math:: \Phi = \Phi_{zu}^T \Phi_{zz}^+ \Phi_{zu}, \qquad
                  \varphi = \Phi_{zu}^T \Phi_{zz}^+ \varphi_{zy}

        Two-stage least squares puts them in the place of the correlations of lagged angles.
        """
        found, signals = [], (self.z, self.u)
        for window in map(self.window, range(times.start, times.stop)):
            y = self.y[:, window].ravel()
            z, u = (each[:, window].reshape(len(y), -1) for each in signals)
            values, vectors = np.linalg.eigh(z.T @ z / len(y))
            kept = values > COLLINEAR * values[-1]
            whitened = vectors[:, kept] / np.sqrt(values[kept])
            of_u = (z @ whitened).T @ u / len(y)
            projection = of_u.T @ whitened.T
            found.append((of_u.T @ of_u, projection @ (y @ z) / len(y), projection))
        phi_uu, phi_uy, projections = (np.array(each) for each in zip(*found, strict=True))
        return phi_uu, phi_uy, projections


class Windows(NamedTuple):
    """Least squares in a window about each time whose lags lie within the context.

    ``agreement`` (per cent) is how much of the torque that depends on the angle a second-order fit
    explains. ``weights`` (time, lag) and ``rank`` describe the solution. These have shape (time,):
    the number of ``samples`` in the window, the number of ``independent`` ones, the ``noise``
    variance and its degrees of ``freedom``. ``readout`` (time, 3, lag) gives stiffness, viscosity
    and inertia from the correlations. The ``impedance`` has shape (time, 3). With instruments,
    ``on_instruments`` (time, 3, lag) gives it from their correlations with the torque.
    """

    lagged: Lagged
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
    reference: str | None = None,
) -> Windows:
    r"""Solve :math:`\varphi(t) = \Phi(t) w(t)` at each time.

    The correlations are means over realizations and a window of time. The window reaches ``half``
    samples to either side, and is cut short where the context ends. ``solve`` gives the solution
    from :math:`\Phi`, :math:`\varphi`, the torque's variance and the number of samples averaged.
    The noise is the residual of all directions of the lagged angles. The residual of the truncated
    solution would be too small, because the same noise chose its directions. With a ``reference``
    the correlations are those of two-stage least squares, truncated at a threshold.
    """
    lagged = Lagged.of(ensemble, lags, half, reference)
    angle, torque, margin, times = lagged.angle, lagged.torque, lagged.margin, lagged.times
    realizations, last = independent_realizations(ensemble), times + 2 * margin
    derivative = derivative_filters(lags, ensemble.sampling_rate)
    parts, moments = [], np.zeros((2 * lags + 1, 2 * lags + 1))
    for chunk in time_chunks(times, 2 * lags + 1):
        begin, end = max(0, chunk.start + margin - half), min(last, chunk.stop + margin + half)
        within = slice(begin, end + 2 * lags)
        centres = slice(chunk.start + margin - begin, chunk.stop + margin - begin)
        summed = np.ones(end - begin), *lagged_moments(angle[:, within], torque[:, within], lags)
        samples, *sums = (sliding_sum(each, half, half)[centres] for each in summed)
        phi_uu, phi_uy, square, mean = (
            total / samples.reshape(-1, *[1] * (total.ndim - 1)) for total in sums
        )
        count, independent = samples * len(ensemble), samples * realizations
        projection = np.empty((len(count), 2 * lags + 1, 0))
        if reference is not None:
            phi_uu, phi_uy, projection = lagged.projected(chunk)
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
    agreement = agreement_of_moments(fitted, beyond, moments / times, left, times * len(ensemble))
    return Windows(lagged, agreement, *arrays[3:])
