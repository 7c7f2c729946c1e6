"""Compute the columns of the regression: filtered angles, and a drive after delay and muscle."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from itertools import pairwise

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.ndimage import convolve1d

from tvsysid.errors import InputError
from tvsysid.methods.pathways import Stretch, driven, history
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.decimation import decimation_weights
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.gaussian import FittedWeights, Moments, Posterior, least_squares
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.second_order import response_readout
from tvsysid.signals import Ensemble

# Share of the Nyquist frequency up to which filters of few lags give derivatives to 0.3 %
BAND = 0.6
RECORDED_HALF_WIDTH = 8  # samples to either side of derivatives at the recorded rate
MAX_LAG_S = 0.04  # of the intrinsic response, to either side
HIGHEST_DIFFERENCE = 8  # order of difference of the angle up to which the response is free
CHANGING = 2  # signals whose coefficients change: angle and velocity
GAIN_SHARE = 0.4  # of the number of harmonics of stiffness, for those of the reflex gain
MAX_WINDOW = 256  # samples of a realization whose noise counts as correlated
NEEDED_HISTORY_S = 0.45  # of the reflex's drive before a sample that is fitted
HISTORY_S = 1.0  # of the reflex's drive that is used where it was recorded
FOLDS = 3  # interleaved sets of realizations, each predicted from the others

# A reflex's shape is log frequency (rad/s), log damping, threshold (rad/s) and delay (s).
SHAPE_NAMES = ("frequency", "damping", "threshold", "delay")
THRESHOLD, DELAY = 2, 3
IS_LOG = np.arange(4) < THRESHOLD
# Mean and standard deviation of the prior, bounds, and step of numerical derivatives. The delay,
# from velocity to torque, is known.
MEAN, SPREAD, LOWEST, HIGHEST, STEP = np.array(
    [
        (math.log(16), 0.6, math.log(3), math.log(60), 1e-3),
        (math.log(0.8), 0.5, math.log(0.2), math.log(3), 1e-3),
        (0.0, 0.3, 0.0, 2.0, 0.02),
        (0.04, 1.0, 0.0, math.inf, 1e-3),
    ]
).T


def intrinsic_filters(rate: float) -> tuple[Array, Array]:
    """Return lags in s, and filters (signal, lag) of the angle, its derivatives and differences.

    The derivatives are velocity and acceleration; the differences begin with order 3. Only the
    first filter passes a constant angle, so that the sum of a response is the first coefficient.
    The velocity of a ramp and the acceleration of a parabola are exact.
    """
    lags = max(1, round(MAX_LAG_S * rate))
    offsets = np.arange(-lags, lags + 1)
    filters = derivative_weights(lags, BAND).copy()
    filters[1] *= -rate / (filters[1] @ offsets)
    filters[2] *= 2 * rate**2 / (filters[2] @ offsets**2)
    step = max(1, lags // 4)
    differences = np.zeros((min(HIGHEST_DIFFERENCE, 2 * lags) - 2, len(offsets)))
    for order, difference in enumerate(differences, 3):
        # Coefficients of (z - 1)^order, times z + 1 if that makes it symmetric about a sample
        weights = np.poly([1] * order + [-1] * (order % 2))
        reach = step * (len(weights) // 2)
        difference[lags - reach : lags + reach + 1 : step] = weights
    return offsets / rate, np.concatenate([filters, differences])


def deviations(values: Array) -> Array:
    """Subtract the mean over realizations from values (…, realization, time).

    A single realization loses its mean over time. NaN becomes 0.
    """
    axis = -1 if values.shape[-2] == 1 else -2
    left = values - np.expand_dims(mean_known(values, axis), axis)
    left[np.isnan(left)] = 0.0
    return left


def intrinsic_signals(ensemble: Ensemble) -> Array:
    """Return the angle, its derivatives and its differences.

    The shape is (signal, realization, context + time + context). They are NaN where their filters
    reach beyond the samples. Velocity and acceleration are those of the angle as recorded,
    decimated as the torque was. With them, the model follows the torque of fast movements that
    decimation aliases to a slower one.
    """
    recorded, rate = ensemble.angle_as_recorded, ensemble.sampling_rate
    signals = np.stack(
        [
            convolve1d(ensemble.angle, each, mode="constant", cval=np.nan)
            for each in intrinsic_filters(rate)[1]
        ]
    )
    ratio = recorded.shape[-1]
    if ratio > 1:
        filters = derivative_weights(RECORDED_HALF_WIDTH, BAND)[1:]
        filters = filters * (rate * ratio) ** np.array([[1], [2]])
        # Derivative and low-pass are one filter, computed only at the samples that are kept.
        filters = np.stack([np.convolve(each[::-1], decimation_weights(ratio)) for each in filters])
        half = filters.shape[1] // 2
        line = recorded.reshape(len(recorded), -1)
        line = np.pad(line, ((0, 0), (half, half)), constant_values=np.nan)
        windows = sliding_window_view(line, filters.shape[1], axis=1)[:, ::ratio]
        fast = np.einsum("rtk,fk->frt", windows, filters)
        signals[1:3] = np.where(np.isnan(fast), signals[1:3], fast)
    return signals


def muscle(shape: Array, samples: int, rate: float) -> Array:
    r"""Return the impulse response of delay and muscle at lags from 0 on. Its samples sum to 1.

    The muscle is :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`.
    """
    frequency, damping = np.exp(shape[:2])
    # Equal poles (critical damping) would divide zero by zero. They are kept apart.
    root = max(np.emath.sqrt(damping**2 - 1), 1e-4, key=abs)
    late = np.maximum(np.arange(samples) / rate - shape[DELAY], 0.0) * frequency
    response = np.exp(-damping * late) * (np.sinh(root * late) / root).real
    return response / response.sum()


@attrs.frozen(eq=False)
class Data:
    """Torque and intrinsic ``signals``, as deviations from their mean over realizations.

    The ``torque`` has shape (realization, time), the signals (signal, realization, time). ``rows``
    and ``times`` of an ensemble are fitted. Coefficients of angle and velocity are Fourier series
    of the realization, with this number of ``harmonics``. ``noise`` is the
    autocorrelation of the noise, from lag 0 on. It weights the samples. If the ``true_noise`` is
    another one, products of columns are those of the sandwich covariance of the coefficients.
    """

    ensemble: Ensemble
    harmonics: int
    torque: Array
    signals: Array
    rows: NDArray[np.int64]
    times: slice
    noise: Array = attrs.field(factory=lambda: np.ones(1))
    true_noise: Array | None = None

    @classmethod
    def of(cls, ensemble: Ensemble, harmonics: int) -> Data:
        """Choose the realizations and times that have a recorded past and most samples."""
        rate = ensemble.sampling_rate
        signals = intrinsic_signals(ensemble)
        edge = max(0, len(intrinsic_filters(rate)[0]) // 2 - ensemble.context)
        last = ensemble.samples - edge
        past = history(ensemble, ensemble.angle, round(NEEDED_HISTORY_S * rate))
        missing = np.isnan(past[:, : ensemble.samples]).sum(axis=1)
        known_from = np.maximum(missing, edge)  # first time of each realization that may be fitted
        sizes = np.sum(known_from <= known_from[:, None], axis=1) * (last - known_from)
        if not sizes.max() > 0:
            raise InputError(
                f"the reflex needs {NEEDED_HISTORY_S:g} s of record before a fitted "
                f"sample; realizations have {ensemble.duration:g} s with "
                f"{ensemble.context / rate:g} s of context; give longer ones"
            )
        times = slice(int(known_from[sizes.argmax()]), last)
        rows = np.flatnonzero(known_from <= times.start)
        return cls(
            ensemble=ensemble,
            harmonics=harmonics,
            torque=deviations(ensemble.torque[:, ensemble.core][rows, times]),
            signals=deviations(signals[..., ensemble.core][:, rows, times]),
            rows=rows,
            times=times,
        )

    @property
    def readout(self) -> Array:
        """Return weights (quantity, signal) that turn coefficients into the impedance.

        See :func:`tvsysid.numerics.second_order.response_readout`.
        """
        lags, filters = intrinsic_filters(self.ensemble.sampling_rate)
        return response_readout(lags) @ filters.T

    @property
    def folds(self) -> list[slice]:
        """Return the realizations of each fold."""
        return [slice(start, None, FOLDS) for start in range(min(FOLDS, len(self.torque)))]

    @property
    def number(self) -> float:
        """Return the number of samples that are independent of the means."""
        rows, times = self.torque.shape
        return float((rows - 1) * times if rows > 1 else times - 1)

    @cached_property
    def basis(self) -> Array:
        """Return the basis functions (time, function) of angle's and velocity's coefficients."""
        return FourierSeries(self.harmonics)(self.ensemble.time / self.ensemble.duration)

    @cached_property
    def functions(self) -> Array:
        """Return the basis functions (time, column) of all intrinsic coefficients."""
        return np.hstack([self.basis[:, :size] for size in self.sizes])

    @property
    def sizes(self) -> list[int]:
        """Return the number of columns of each signal."""
        return [2 * self.harmonics + 1] * CHANGING + [1] * (len(self.signals) - CHANGING)

    @property
    def intrinsic_count(self) -> int:
        """Return the number of intrinsic columns."""
        return sum(self.sizes)

    @property
    def gain(self) -> FourierSeries:
        """Return the basis of the reflex gain over a realization."""
        return FourierSeries(round(GAIN_SHARE * self.harmonics))

    @cached_property
    def constant(self) -> Data:
        """Return the data with constant coefficients."""
        return attrs.evolve(self, harmonics=0)

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
        """Return values (…, time) times the weights, which are 1 where the noise is white."""
        if len(self.noise) == 1 and self.true_noise is None:
            return values
        return np.concatenate([values[..., at] @ weights for at, weights in self.windows], axis=-1)

    @cached_property
    def changing_products(self) -> Array:
        r"""Return the products (fold, column, column) of angle's and velocity's columns.

        With signals s and basis functions F, they are

        .. math:: \sum_r (s_r F)^T W (s'_r F) = F^T (W \circ \sum_r s_r s_r'^T)\, F
        """
        basis, size = self.basis[self.times], sum(self.sizes[:CHANGING])
        products = []
        for rows in self.folds:
            parts = []
            for at, weights in self.windows:
                signals = self.signals[:CHANGING, rows, at]
                moments = signals.swapaxes(1, 2)[:, None] @ signals * weights
                parts.append(basis[at].T @ moments @ basis[at])
            products.append(np.sum(parts, axis=0).swapaxes(1, 2).reshape(size, size))
        return np.stack(products)

    def products(self, further: Array) -> Array:
        """Return the products (fold, column, column) of intrinsic and further columns, and torque.

        The further columns have shape (column, realization, time).
        """
        columns = np.concatenate([self.signals[CHANGING:], further, self.torque[None]])
        weighted, products = self.weighted(columns), []
        for rows, first in zip(self.folds, self.changing_products, strict=True):
            sums = np.einsum("crt,srt->cst", weighted[:, rows], self.signals[:CHANGING, rows])
            cross = (sums @ self.basis[self.times]).reshape(len(columns), -1)
            rest = np.tensordot(columns[:, rows], weighted[:, rows], ((1, 2), (1, 2)))
            products.append(np.block([[first, cross.T], [cross, rest]]))
        return np.stack(products)

    def moments(self, further: Array) -> Moments:
        """Return the moments of intrinsic and further columns."""
        return Moments.of(self.products(further).sum(axis=0), self.number)

    def reflex(self, drive: Stretch, shape: Array, coefficients: Array) -> Array:
        """Return reflex torques (column, realization, time) of coefficients (coefficient, column).

        The threshold of the ``shape`` replaces that of the drive. The gain is that at the time of
        arrival.
        """
        rate = self.ensemble.sampling_rate
        before = round(HISTORY_S * rate)
        drive = attrs.evolve(drive, threshold=float(shape[THRESHOLD]))
        past = driven(self.ensemble, drive, before)[self.rows]
        steps = np.arange(self.times.start - before, self.times.stop)
        gain = self.gain((steps / rate + shape[DELAY]) / self.ensemble.duration) @ coefficients
        arriving = deviations(past[:, steps + before]) * gain.T[:, None]
        response = np.broadcast_to(
            muscle(shape, before + 1, rate), (self.torque.shape[1], before + 1)
        )
        torque = convolve_lags(arriving.reshape(-1, len(steps)), response)
        return torque.reshape(-1, *self.torque.shape)

    def residual(self, coefficients: Array, further: Array, rows: slice = slice(None)) -> Array:
        """Return the torque (realization, time) that coefficients leave of some realizations."""
        own, others = np.split(coefficients, [self.intrinsic_count])
        over_time = self.over_time(own)[self.times].T.copy()  # einsum is slower across time
        intrinsic = np.einsum("st,srt->rt", over_time, self.signals[:, rows])
        left = self.torque[rows] - intrinsic - np.tensordot(others, further[:, rows], 1)
        # The mean over several realizations is zero
        return left if len(self.torque) > 1 else deviations(left)

    def held_out(
        self,
        products: Array,
        further: Array,
        fit: Callable[[Moments], Posterior | FittedWeights] = least_squares,
    ) -> Array:
        """Return the residual torque (realization, time) of each fold, fitted to the other folds.

        ``products`` are those of the further columns. The torque is NaN if there is a single fold.
        """
        left, total = np.full_like(self.torque, np.nan), products.sum(axis=0)
        if len(self.folds) > 1:
            for rows, own in zip(self.folds, products, strict=True):
                mean = fit(Moments.of(total - own, self.number)).mean
                left[rows] = self.residual(mean, further, rows)
        return left

    def features(self, weights: Array) -> Array:
        """Return rows (time, column) that give the weighted sum of the signals' coefficients."""
        return self.functions * np.repeat(weights, self.sizes)

    def over_time(self, coefficients: Array) -> Array:
        """Return the coefficient of each signal at all times (time, signal)."""
        is_own = np.repeat(np.eye(len(self.signals)), self.sizes, axis=0)
        return (self.functions * coefficients) @ is_own

    def squares(self, values: Array) -> Array:
        """Return the weighted squares of values (realization, time), one for each realization."""
        return np.sum(values * self.weighted(values), axis=1)


def _matrix(correlation: Array, times: int) -> Array:
    return toeplitz(np.pad(correlation, (0, times))[:times])
