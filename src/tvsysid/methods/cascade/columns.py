"""Compute the columns of the regression: filtered angles, and a drive after delay and muscle."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.ndimage import correlate1d

from tvsysid.errors import InputError
from tvsysid.methods.cascade.pathways import history
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.decimation import TAPS, keep_every
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.second_order import response_readout
from tvsysid.signals import Ensemble

# Share of the Nyquist frequency up to which filters of few lags give derivatives to 0.3 %
BAND = 0.6
RECORDED_HALF_WIDTH = 8  # samples to either side of derivatives at the recorded rate
NEGLIGIBLE = 40.0  # time constants after which a muscle's response is over
MAX_LAG_S = 0.04  # of the intrinsic response, to either side
HIGHEST_DIFFERENCE = 8  # order of difference of the angle up to which the response is free
CHANGING = 2  # signals whose coefficients change: angle and velocity
MAX_WINDOW = 256  # samples of a realization whose noise counts as correlated
NEEDED_HISTORY_S = 0.45  # of the reflex's drive before a sample that is fitted
HISTORY_S = 1.0  # of the reflex's drive that is used where it was recorded
FOLDS = 3  # interleaved sets of realizations, each predicted from the others


def intrinsic_filters(lags: int, rate: float) -> Array:
    """Return filters (signal, lag) that give the angle, its derivatives and its differences.

    The derivatives are velocity and acceleration; the differences begin with order 3. Only the
    first filter passes a constant angle, so that the sum of a response is the first coefficient.
    The velocity of a ramp and the acceleration of a parabola are exact.
    """
    offsets = np.arange(-lags, lags + 1)
    filters = derivative_weights(lags, BAND).copy()
    filters[1] *= -rate / (filters[1] @ offsets)
    filters[2] *= 2 * rate**2 / (filters[2] @ offsets**2)
    step = max(1, lags // 4)
    first, second = np.zeros((2, 2 * step + 1))
    first[::step], second[::step] = (0.5, 0, -0.5), (1, -2, 1)
    impulse = np.eye(1, 2 * lags + 1, lags)[0]
    differences = [np.convolve(impulse, each, "same") for each in (first, second)]
    while len(differences) < min(HIGHEST_DIFFERENCE, 2 * lags):
        differences.append(np.convolve(differences[-2], second, "same"))
    return np.stack([*filters, *differences[2:]])


def deviations(values: Array) -> Array:
    """Subtract the mean over realizations from values (…, realization, time).

    A single realization loses its mean over time. NaN becomes 0.
    """
    axis = -1 if values.shape[-2] == 1 else -2
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis, keepdims=True), 1)
    mean = np.sum(values, axis, where=known, keepdims=True) / count
    return np.where(known, values - mean, 0.0)


def filtered(values: Array, filters: Array) -> Array:
    """Filter values (realization, time) by each of the filters (filter, lag), about each sample.

    They are wrong where a filter reaches beyond the samples.
    """
    return np.stack([correlate1d(values, weights) for weights in filters[:, ::-1]])


def unresolved(ensemble: Ensemble, lags: int) -> Array:
    """Return velocity and acceleration that the lags of the decimated angle miss.

    Their shape is (2, realization, context + time + context). They are derivatives of the angle as
    recorded, decimated as the torque was, less those of the decimated angle. With them, the model
    follows the torque of fast movements that decimation aliases to a slower one. They are zero
    where a filter reaches beyond the samples.
    """
    recorded, rate = ensemble.angle_as_recorded, ensemble.sampling_rate
    ratio = recorded.shape[-1]
    out = np.zeros((2, *ensemble.angle.shape))
    if ratio > 1:
        filters = derivative_weights(RECORDED_HALF_WIDTH, BAND)[1:]
        filters = filters * (rate * ratio) ** np.array([[1], [2]])
        angle = recorded.reshape(len(recorded), -1)
        fast = np.stack([keep_every(each, ratio) for each in filtered(angle, filters)])
        slow = filtered(ensemble.angle, intrinsic_filters(lags, rate)[1:3])
        reach = max(lags, -(-(RECORDED_HALF_WIDTH + TAPS // 2) // ratio))
        out[..., reach:-reach] = (fast - slow)[..., reach:-reach]
    return out


def muscle(shape: Array, samples: int, rate: float) -> Array:
    r"""Return the impulse response of delay and muscle at lags from 0 on, at most ``samples``.

    The muscle is :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`. The samples of the whole
    response sum to 1. A reflex's ``shape`` holds log frequency (rad/s), log damping, threshold
    (rad/s) and delay (s).
    """
    (frequency, damping), delay = np.exp(shape[:2]), float(shape[3])
    # Equal poles (critical damping) would divide zero by zero. They are kept apart.
    root = max(np.emath.sqrt(damping**2 - 1), 1e-4, key=abs)
    poles = frequency * (np.array([[root], [-root]]) - damping)
    last = int((delay - NEGLIGIBLE / poles.real.max()) * rate)
    late = np.maximum(np.arange(last) / rate - delay, 0.0)
    response = (np.subtract(*np.exp(poles * late)) / root).real
    return np.asarray((response / response.sum())[:samples])


@attrs.frozen(eq=False)
class Data:
    """Torque and intrinsic ``signals``, as deviations from their mean over realizations.

    The ``torque`` has shape (realization, time), the signals (signal, realization, time). ``rows``
    and ``times`` of an ensemble are fitted. ``functions`` (time, column) are the basis functions
    of each signal's coefficient, at all times of a realization. ``starts`` are the first columns of
    the signals. ``gain`` is the basis of the reflex's gain over a ``period`` in s. ``noise`` is the
    autocorrelation of the noise, from lag 0 on. It weights the samples. If the ``true_noise`` is
    another one, products of columns are those of the sandwich covariance of the coefficients.
    """

    torque: Array
    signals: Array
    functions: Array
    starts: list[int]
    gain: FourierSeries
    period: float
    rate: float
    rows: NDArray[np.int64]
    times: slice
    noise: Array = attrs.field(factory=lambda: np.ones(1))
    true_noise: Array | None = None

    @classmethod
    def of(cls, ensemble: Ensemble, harmonics: tuple[int, int, int]) -> Data:
        """Return the realizations and times with most samples whose past is recorded."""
        rate = ensemble.sampling_rate
        lags = round(MAX_LAG_S * rate)
        if lags < 1:
            raise InputError(f"JointCascade: it takes more than 12.5 Hz, got {rate:g} Hz")
        signals = filtered(ensemble.angle, intrinsic_filters(lags, rate))
        signals[1:3] += unresolved(ensemble, lags)
        edge = max(0, lags - ensemble.context)
        last = ensemble.samples - edge
        past = history(ensemble, ensemble.angle, round(NEEDED_HISTORY_S * rate))
        missing = np.isnan(past[:, : ensemble.samples]).sum(axis=1)
        known_from = np.maximum(missing, edge)  # first time of each realization that may be fitted
        sizes = np.sum(known_from <= known_from[:, None], axis=1) * (last - known_from)
        if not sizes.max() > 0:
            raise InputError(
                f"JointCascade: the reflex needs {NEEDED_HISTORY_S:g} s of record before a fitted "
                f"sample; realizations have {ensemble.duration:g} s with "
                f"{ensemble.context / rate:g} s of context; give longer ones"
            )
        times = slice(int(known_from[sizes.argmax()]), last)
        rows = np.flatnonzero(known_from <= times.start)
        counts = [*harmonics[:2], *[0] * (len(signals) - 2)]
        phase = ensemble.time / ensemble.duration
        return cls(
            torque=deviations(ensemble.torque[:, ensemble.core][rows, times]),
            signals=deviations(signals[..., ensemble.core][:, rows, times]),
            functions=np.concatenate([FourierSeries(count)(phase) for count in counts], axis=1),
            starts=np.cumsum([0, *(2 * count + 1 for count in counts[:-1])]).tolist(),
            gain=FourierSeries(harmonics[2] if any(counts) else 0),
            period=ensemble.duration,
            rate=rate,
            rows=rows,
            times=times,
        )

    @property
    def lags(self) -> Array:
        """Return the lags of the intrinsic response in s."""
        reach = round(MAX_LAG_S * self.rate)
        return np.arange(-reach, reach + 1) / self.rate

    @property
    def filters(self) -> Array:
        """Return the :func:`intrinsic_filters`."""
        return intrinsic_filters(len(self.lags) // 2, self.rate)

    @property
    def readout(self) -> Array:
        """Return weights (quantity, signal) that turn coefficients into the impedance.

        See :func:`tvsysid.numerics.second_order.response_readout`.
        """
        return np.asarray(response_readout(self.lags) @ self.filters.T)

    @property
    def folds(self) -> list[slice]:
        """Return the realizations of each fold."""
        return [slice(start, None, FOLDS) for start in range(min(FOLDS, len(self.torque)))]

    @property
    def number(self) -> float:
        """Return the number of samples that are independent of the means."""
        rows, times = self.torque.shape
        return float((rows - 1) * times if rows > 1 else times - 1)

    @property
    def intrinsic_count(self) -> int:
        """Return the number of intrinsic columns."""
        return int(self.functions.shape[1])

    @property
    def varies(self) -> bool:
        """Return whether any coefficient changes over time."""
        return self.intrinsic_count > len(self.signals)

    @cached_property
    def constant(self) -> Data:
        """Return the data with constant coefficients."""
        functions, starts = self.functions[:, self.starts], list(range(len(self.starts)))
        return attrs.evolve(self, functions=functions, starts=starts, gain=FourierSeries(0))

    @cached_property
    def windows(self) -> list[tuple[slice, Array]]:
        """Return intervals of time, and the weights (time, time) of the samples in each."""
        times = self.torque.shape[1]
        edges = np.linspace(0, times, -(-times // MAX_WINDOW) + 1).astype(int).tolist()
        windows = []
        for start, stop in pairwise(edges):
            weights = np.linalg.inv(_matrix(self.noise, stop - start))
            if self.true_noise is not None:
                weights = weights @ _matrix(self.true_noise, stop - start) @ weights
            windows.append((slice(start, stop), np.asarray(weights)))
        return windows

    def weighted(self, values: Array) -> Array:
        """Return values (…, time) times the weights."""
        return np.concatenate([values[..., at] @ weights for at, weights in self.windows], axis=-1)

    @property
    def changing(self) -> list[tuple[Array, Array]]:
        """Return angle and velocity (realization, time), and their functions (time, column)."""
        bases = np.split(self.functions[self.times], self.starts[1:], axis=1)
        return list(zip(self.signals, bases, strict=True))[:CHANGING]

    @cached_property
    def changing_products(self) -> list[Array]:
        r"""Return the products (column, column) of angle's and velocity's columns of each fold.

        .. math:: \sum_r (s_r F)^T W (s'_r F') = F^T (W \circ \sum_r s_r s_r'^T)\, F'
        """

        def product(rows: slice, one: Array, own: Array, other: Array, others: Array) -> Array:
            parts = (
                own[at].T @ (one[rows, at].T @ other[rows, at] * weights) @ others[at]
                for at, weights in self.windows
            )
            return np.asarray(np.sum(list(parts), axis=0))

        pairs = [[(*one, *other) for other in self.changing] for one in self.changing]
        return [
            np.block([[product(rows, *each) for each in line] for line in pairs])
            for rows in self.folds
        ]

    def products(self, further: Array) -> Array:
        """Return the products (fold, column, column) of intrinsic and further columns, and torque.

        The further columns have shape (column, realization, time).
        """
        columns = np.concatenate([self.signals[CHANGING:], further, self.torque[None]])
        weighted, products = self.weighted(columns), []
        for rows, first in zip(self.folds, self.changing_products, strict=True):
            sums = [
                np.einsum("crt,rt->ct", weighted[:, rows], signal[rows]) @ bases
                for signal, bases in self.changing
            ]
            cross = np.hstack(sums)
            rest = np.tensordot(columns[:, rows], weighted[:, rows], ((1, 2), (1, 2)))
            products.append(np.block([[first, cross.T], [cross, rest]]))
        return np.stack(products)

    def moments(self, further: Array) -> Moments:
        """Return the moments of intrinsic and further columns."""
        return Moments.of(self.products(further).sum(axis=0), self.number)

    def history(self, ensemble: Ensemble, drive: Array) -> Array:
        """Return the drive of a reflex with its history, less its mean over realizations.

        The ``drive`` has shape (realization, context + time + context), the result
        (realization, history + time). It is 0 where nothing was recorded.
        """
        samples = round(HISTORY_S * self.rate)
        known = history(ensemble, drive, samples)[self.rows]
        return deviations(known[:, self.times.start : samples + self.times.stop])

    def reflex(self, drive: Array, shape: Array, coefficients: Array) -> Array:
        """Return reflex torques (column, realization, time) of coefficients (coefficient, column).

        The ``drive`` is one with its :meth:`history`. The gain is that at the time of arrival.
        """
        rows, times = self.torque.shape
        response = muscle(shape, drive.shape[1] - times + 1, self.rate)
        steps = np.arange(self.times.start - len(response) + 1, self.times.stop)
        gain = self.gain((steps / self.rate + float(shape[3])) / self.period)
        arriving = drive[:, -len(steps) :] * (gain @ coefficients).T[:, None]
        lines = arriving.reshape(-1, len(steps))
        torque = convolve_lags(lines, np.broadcast_to(response, (times, len(response))))
        return torque.reshape(-1, rows, times)

    def torques(self, coefficients: Array, further: Array) -> tuple[Array, Array]:
        """Return intrinsic torque and that of further columns (realization, time), less means."""
        own, others = np.split(coefficients, [self.intrinsic_count])
        intrinsic = np.einsum("ts,srt->rt", self.over_time(own)[self.times], self.signals)
        return deviations(intrinsic), deviations(np.tensordot(others, further, 1))

    def residual(self, coefficients: Array, further: Array) -> Array:
        """Return the torque (realization, time) that coefficients leave."""
        return np.asarray(self.torque - np.sum(self.torques(coefficients, further), axis=0))

    def held_out(
        self, products: Array, further: Array, fitted: Callable[[Moments], Array]
    ) -> Array:
        """Return the residual torque (realization, time) of each fold, fitted to the other folds.

        ``products`` are those of the further columns. ``fitted`` returns coefficients from moments.
        The torque is NaN if there is a single fold.
        """
        left, total = np.full_like(self.torque, np.nan), products.sum(axis=0)
        if len(self.folds) > 1:
            for rows, own in zip(self.folds, products, strict=True):
                number = self.number * (1 - len(left[rows]) / len(left))
                coefficients = fitted(Moments.of(total - own, number))
                left[rows] = self.residual(coefficients, further)[rows]
        return left

    def features(self, weights: Array) -> Array:
        """Return rows (time, column) that give the weighted sum of the signals' coefficients."""
        return self.functions * np.repeat(weights, np.diff([*self.starts, self.intrinsic_count]))

    def over_time(self, coefficients: Array) -> Array:
        """Return the coefficient of each signal at all times (time, signal)."""
        return np.add.reduceat(self.functions * coefficients, self.starts, axis=1)

    def squares(self, values: Array) -> Array:
        """Return the weighted squares of values (realization, time), one for each realization."""
        return np.asarray(np.sum(values * self.weighted(values), axis=1))


def _matrix(correlation: Array, times: int) -> Array:
    return np.asarray(toeplitz(np.pad(correlation, (0, times))[:times]))
