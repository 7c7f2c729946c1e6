"""What is regressed: lagged angles times functions of time, and a rectified velocity behind delay and muscle."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from tvsysid.methods.cascade.evidence import Moments
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.decimation import TAPS
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.moments import row_blocks
from tvsysid.numerics.stretch import decimated

BAND = 0.6  # share of the Nyquist frequency over which so few lags give velocity and acceleration to 0.3 %
HALF_WIDTH = 8  # samples to either side from which velocity and acceleration follow at the recorded rate
FITTED = (0.5, 15.0)  # Hz, over which viscosity and inertia are those of the intrinsic response
HIGHEST = 8  # order of difference of the angle up to which the intrinsic response is free
MANY = 10  # columns that a block of realizations is taken to have, whose values are counted

Rows = slice | NDArray[np.int64]
Columns = Callable[[Rows], Array]  # (column, realization, time) of some realizations; all take many times the data


def intrinsic_filters(lags: int, rate: float) -> Array:
    """Filters (signal, lag) of the angle: itself, its velocity, its acceleration, and its differences from order 3 on.

    The first passes what stands still, the others nothing of it, so that a response's sum is the first's coefficient;
    the velocity of a ramp and the acceleration of a parabola are exact.
    """
    offsets = np.arange(-lags, lags + 1)
    filters = derivative_weights(lags, BAND).copy()
    filters[1] *= -rate / (filters[1] @ offsets)
    filters[2] *= 2 * rate**2 / (filters[2] @ offsets**2)
    step = max(1, lags // 4)
    second, odd = np.zeros(2 * step + 1), np.zeros(2 * step + 1)
    second[::step], odd[::step] = (1, -2, 1), (0.5, 0, -0.5)
    rows = list(filters)
    for order in range(3, HIGHEST + 1):
        taps = odd if order % 2 else np.ones(1)
        for _ in range(order // 2):
            taps = np.convolve(taps, second)
        if len(taps) <= len(offsets):
            rows.append(np.pad(taps, (len(offsets) - len(taps)) // 2))
    return np.stack(rows)


def second_order_fit(lags: Array) -> Array:
    """Weights (quantity, lag) that give stiffness, viscosity and inertia of a response's weights at lags in s.

    By least squares to its frequency response from 0.5 to 15 Hz.
    """
    omega = 2 * np.pi * np.linspace(*FITTED, 60)
    phase = np.outer(omega, lags)
    real = np.linalg.pinv(np.stack([np.ones_like(omega), -(omega**2)], axis=1)) @ np.cos(phase)
    return np.stack([real[0], -(omega @ np.sin(phase)) / (omega @ omega), real[1]])


def readout(lags: int, rate: float) -> Array:
    """Weights (quantity, signal) that give the same of the coefficients of the :func:`intrinsic_filters`."""
    return np.asarray(second_order_fit(np.arange(-lags, lags + 1) / rate) @ intrinsic_filters(lags, rate).T)


def part_of(columns: Columns, rows: NDArray[np.int64]) -> Columns:
    """Columns of some realizations, counted among these."""
    return lambda some: columns(rows[some])


def deviations(values: Array, fitted: NDArray[np.bool_]) -> Array:
    """Values (…, realization, time) less their mean over the realizations fitted at each time; 0 where not fitted.

    Of one realization, the mean over time is subtracted.
    """
    axis = -1 if len(fitted) == 1 else -2
    if fitted.all():
        return np.asarray(values - values.mean(axis=axis, keepdims=True))
    known = np.where(fitted, values, 0.0)
    count = np.maximum(fitted.sum(axis=axis, keepdims=True), 1)
    return np.where(fitted, known - known.sum(axis=axis, keepdims=True) / count, 0.0)


@dataclass(frozen=True, eq=False)
class Data:
    """Deviations of the torque (realization, time) and of the intrinsic ``signals`` from their mean over realizations.

    ``bases`` are the functions of time (time, function) by which each signal's coefficient changes; samples that are
    not ``fitted`` are 0. ``own`` are the moments of the signals' products with their functions. Of ``number``
    independent samples each counts as a ``share`` of one, because noise is not white; ``remainder`` is the log size of
    the prior of the differences, where it is known.
    """

    torque: Array
    signals: Array
    bases: tuple[Array, ...]
    fitted: NDArray[np.bool_]
    number: float
    own: Moments
    share: float = 1.0
    remainder: float | None = None

    @classmethod
    def of(cls, torque: Array, signals: Array, bases: tuple[Array, ...], fitted: NDArray[np.bool_]) -> Self:
        """Of torque and signals (signal, realization, time) as they are."""
        taken = int(fitted.any(axis=0).sum()) if len(fitted) > 1 else 1
        number = float(fitted.sum() - taken)
        torque, signals = deviations(torque, fitted), deviations(signals, fitted)
        return cls(torque, signals, bases, fitted, number, _own(torque, signals, bases, number))

    @property
    def varies(self) -> bool:
        """Whether anything changes over time."""
        return any(functions.shape[1] > 1 for functions in self.bases)

    def constant(self) -> Self:
        """Data of coefficients that do not change."""
        bases = tuple(a[:, :1] for a in self.bases)
        own = _own(self.torque, self.signals, bases, self.number).times(self.share)
        return replace(self, bases=bases, own=own)

    def counting(self, share: float, remainder: float | None = None) -> Self:
        """Data of which each sample counts as this share of an independent one."""
        return replace(self, own=self.own.times(share / self.share), share=share, remainder=remainder)

    def part(self, rows: NDArray[np.int64]) -> Self:
        """Data of some realizations, the means subtracted being those of all."""
        number = self.number * float(self.fitted[rows].sum() / self.fitted.sum())
        torque, signals, fitted = self.torque[rows], self.signals[:, rows], self.fitted[rows]
        own = _own(torque, signals, self.bases, number).times(self.share)
        return replace(self, torque=torque, signals=signals, fitted=fitted, number=number, own=own)

    def moments(self, columns: Columns) -> Moments:
        """Moments of the intrinsic columns and of others, which are deviations."""
        own, total = len(self.own.cross), np.zeros(())
        for some in row_blocks(len(self.torque), MANY * self.torque.shape[1]):
            these = columns(some)
            flat = these.reshape(len(these), self.torque[some].size)
            mixed = [
                a.T @ np.einsum("rt,krt->tk", s[some], these) for a, s in zip(self.bases, self.signals, strict=True)
            ]
            total = total + np.concatenate([*mixed, flat @ flat.T, [flat @ self.torque[some].ravel()]])
        total = self.share * total
        gram = np.block([[self.own.gram, total[:own]], [total[:own].T, total[own:-1]]])
        return Moments(gram, np.concatenate([self.own.cross, total[-1]]), self.own.square, self.own.number)

    def features(self, weights: Array) -> list[Array]:
        """What gives sums of the signals' coefficients at each time, (time, column), by weights (sum, signal)."""
        return [np.concatenate([a * w for a, w in zip(self.bases, row, strict=True)], axis=1) for row in weights]

    def modulated(self, rows: slice) -> Array:
        """Intrinsic columns of some realizations (column, realization, time)."""
        parts = [s[None, rows] * a.T[:, None] for a, s in zip(self.bases, self.signals, strict=True)]
        return np.concatenate(parts)

    def torque_of(self, coefficients: Array) -> Array:
        """Intrinsic torque (realization, time), as a deviation from its mean."""
        out, at = np.zeros_like(self.torque), 0
        for functions, signal in zip(self.bases, self.signals, strict=True):
            out += (functions @ coefficients[at : at + functions.shape[1]]) * signal
            at += functions.shape[1]
        return out


def _own(torque: Array, signals: Array, bases: tuple[Array, ...], number: float) -> Moments:
    """Moments of signals times functions of time, from those of the signals at each time."""
    products = np.zeros(())
    for some in row_blocks(len(torque), MANY * torque.shape[1]):
        both = np.concatenate([signals[:, some], torque[None, some]])
        products = products + np.einsum("irt,jrt->tij", signals[:, some], both, optimize=True)
    gram = np.block([[(a * products[:, i, j, None]).T @ b for j, b in enumerate(bases)] for i, a in enumerate(bases)])
    cross = np.concatenate([a.T @ products[:, i, -1] for i, a in enumerate(bases)])
    return Moments(gram, cross, float(np.vdot(torque, torque)), number)


class Shape(NamedTuple):
    """Of the reflex: ``delay`` in s, ``frequency`` in rad/s and ``damping`` of the muscle, ``threshold`` in rad/s."""

    delay: float
    frequency: float
    damping: float
    threshold: float

    def muscle(self, rate: float) -> tuple[int, Array, Array]:
        r"""Whole samples of the delay, and a recursive filter for the rest and for the muscle.

        Its impulse response is that of :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`, sampled, with unit gain.
        """
        samples = self.delay * rate
        whole = math.floor(samples + 1e-9)
        rest = max(0.0, samples - whole)
        root = cmath.sqrt(self.damping**2 - 1 or 1e-12)
        if abs(root) < 1e-4:
            root = 1e-4 + 0j
        first, second = (self.frequency / rate * (-self.damping + sign * root) for sign in (1, -1))
        poles = cmath.exp(first), cmath.exp(second)
        late = cmath.exp(-first * rest), cmath.exp(-second * rest)
        one = (late[0] * poles[0] - late[1] * poles[1]) / (poles[0] - poles[1])
        two = poles[0] * poles[1] * (late[1] - late[0]) / (poles[0] - poles[1])
        down = np.array([1.0, -(poles[0] + poles[1]).real, (poles[0] * poles[1]).real])
        up = np.array([0.0, one.real, two.real])
        return whole, up * (down.sum() / up.sum()), down

    def response(self, samples: int, rate: float) -> Array:
        """Impulse response of delay and muscle at lags from 0 on, which sums to 1."""
        whole, up, down = self.muscle(rate)
        impulse = np.zeros(samples)
        impulse[min(whole, samples - 1)] = 1.0
        response = scipy.signal.lfilter(up, down, impulse)
        return np.asarray(response / response.sum())


def behind(driven: Array, muscle: tuple[int, Array, Array], samples: int) -> Array:
    """What comes out of delay and muscle (:meth:`Shape.muscle`) at the last so many samples."""
    whole, up, down = muscle
    stop = driven.shape[-1] - whole
    return np.asarray(scipy.signal.lfilter(up, down, driven)[..., stop - samples : stop])


@dataclass(frozen=True, eq=False)
class Reflex:
    """Columns of the reflex pathway: what drives it, times functions of time, behind delay and muscle.

    ``drive`` gives the rows (realization, history + time) for a threshold, as deviations from their mean over
    realizations, 0 where nothing was recorded; ``basis`` is that of the gain over a ``period`` in s.
    """

    drive: Callable[[float], Array]
    basis: FourierSeries
    period: float
    rate: float
    fitted: NDArray[np.bool_]

    def functions(self, shape: Shape, times: int) -> Array:
        """Functions of the gain (time, function) at the times of arrival of so many last samples of the drive."""
        samples = self.fitted.shape[1]
        arrival = np.arange(samples - times, samples) / self.rate + shape.delay
        return self.basis(arrival / self.period)

    def columns(self, shape: Shape) -> Columns:
        """Regressors (function, realization, time), as deviations from their mean over realizations."""
        rows, fitted = self.drive(shape.threshold), self.fitted
        muscle, samples = shape.muscle(self.rate), fitted.shape[1]
        functions = self.functions(shape, rows.shape[1]).T[:, None]
        if len(rows) == 1:
            return lambda some: deviations(behind(rows[some] * functions, muscle, samples), fitted)
        # The sum over realizations is what the sum of the drives gives, less what is not fitted.
        lost = ~fitted & fitted.any(axis=0)
        losing = np.flatnonzero(lost.any(axis=1))
        total = behind(rows.sum(axis=0, keepdims=True) * functions, muscle, samples)
        total -= (behind(rows[losing] * functions, muscle, samples) * lost[losing]).sum(axis=1, keepdims=True)
        mean = total / np.maximum(fitted.sum(axis=0), 1)
        return lambda some: (behind(rows[some] * functions, muscle, samples) - mean) * fitted[some]

    def torque(self, shape: Shape, coefficients: Array) -> Array:
        """Sum of the columns times coefficients, (realization, time)."""
        rows = self.drive(shape.threshold)
        driven = rows * (self.functions(shape, rows.shape[1]) @ coefficients)
        return deviations(behind(driven, shape.muscle(self.rate), self.fitted.shape[1]), self.fitted)


def lagged_signals(angle: Array, context: int, lags: int, rate: float) -> tuple[Array, NDArray[np.bool_]]:
    """Intrinsic signals (signal, realization, time) of angles with context, and where their lags lie within it."""
    missing = max(0, lags - context)
    angle = np.pad(angle, ((0, 0), (missing, missing)))
    first = max(0, context - lags)
    windows = sliding_window_view(angle[:, first : angle.shape[1] - first], 2 * lags + 1, axis=1)
    filters = intrinsic_filters(lags, rate)[:, ::-1]
    signals = np.moveaxis(np.tensordot(windows, filters, axes=(2, 1)), 2, 0)
    known = np.zeros(signals.shape[2], dtype=bool)
    known[missing : len(known) - missing] = True
    return np.ascontiguousarray(signals), known


def unresolved(recorded: Array, lags: int, rate: float) -> Array:
    """What velocity and acceleration have beyond those of so few lags of the decimated angle: (2, realization, time).

    They are derivatives of the angle as ``recorded`` (realization, time, sample), decimated as the torque was, so that
    the torque of fast movements is followed where decimation takes it for a slower one's (aliases). Zero where a filter
    reaches beyond the samples.
    """
    samples = recorded.shape[-1]
    out = np.zeros((2, *recorded.shape[:2]))
    reach = max(lags, -(-(HALF_WIDTH + TAPS // 2) // samples))
    inside = slice(reach, recorded.shape[1] - reach)
    if samples == 1 or inside.stop <= inside.start:
        return out
    few = intrinsic_filters(lags, rate)[:, ::-1]
    many = derivative_weights(HALF_WIDTH, BAND)[:, ::-1]
    for some in row_blocks(len(recorded), recorded.shape[1] * samples):
        angle = recorded[some].reshape(-1, recorded.shape[1] * samples)
        slow = decimated(angle, samples)
        for order in (1, 2):
            fast = decimated(correlate1d(angle, many[order] * (rate * samples) ** order), samples)
            out[order - 1, some, inside] = (fast - correlate1d(slow, few[order]))[:, inside]
    return out
