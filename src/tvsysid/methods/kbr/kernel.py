"""Features of the locally periodic kernel over a record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics import Array
from tvsysid.numerics.kernels import TOLERANCE, DecayFeatures, harmonic_features, harmonic_variances

ENDLESS = 120_000.0  # decay in s that stands for none: the paper's for its simulated study
VISIBLE = 0.03  # share of the noise that a feature's part of the torque must be able to reach to be fitted at all
STRICT = 20.0  # length of the decay, in lengths of the record, from which on the kernel is taken as strictly periodic


@dataclass(frozen=True, eq=False)
class Kernel:
    """Features of the locally periodic kernel: products of a harmonic of the period and a slow function of time.

    ``decay`` gives the slow functions beside the constant, None where the kernel is strictly periodic. ``products`` are
    harmonic, part (0 for cosine, 1 for sine) and slow function of each column, ``precision`` (column,) its prior
    precision for gamma = 1. The first column is the constant without prior, 0.
    """

    period: float
    decay: DecayFeatures | None
    products: tuple[tuple[int, int, int], ...]
    precision: Array

    def __post_init__(self) -> None:
        self.precision.flags.writeable = False

    @classmethod
    def of(cls, period: float, l1: float, l2: float, first: float, last: float, rate: float) -> Kernel:
        """Features that matter over the record, from its first to its last time in s."""
        variances = harmonic_variances(l1)
        # Harmonics beyond the Nyquist frequency would be aliases of slower ones.
        variances = variances[: max(1, math.ceil(period * rate / 2))]
        decay = None if l2 >= STRICT * (last - first) else DecayFeatures(first, last, l2)
        slow = [(0, 1.0)] if decay is None else list(enumerate(decay.variances, start=1))
        products = [
            (harmonic, part, function)
            for harmonic, variance in enumerate(variances)
            for part in range(2 if harmonic else 1)
            for function, share in slow
            # Of the constant one column is enough: that without prior.
            if variance * share > TOLERANCE and (harmonic, function) != (0, 0)
        ]
        precision = [0.0, *(1 / variances[harmonic] for harmonic, _, _ in products)]
        return cls(period, decay, ((0, 0, 0), *products), np.array(precision))

    @property
    def columns(self) -> int:
        """Features of each coefficient."""
        return len(self.products)

    @cached_property
    def harmonics(self) -> int:
        """Highest harmonic of the period."""
        return max(harmonic for harmonic, _, _ in self.products)

    def slow_features(self, clock: Array) -> Array:
        """Constant and slow functions at times of the record in s, shape (function, time)."""
        constant = np.ones((1, len(clock)))
        return constant if self.decay is None else np.concatenate([constant, self.decay(clock).T])

    def visible(self, power: Array, noise: float) -> NDArray[np.bool_]:
        """Features that may reach a ``noise``, as a sum of squares, in the torque, shape (signal, column).

        ``power`` (signal,) is the prior variance of a signal's coefficient times its summed squares.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(np.outer(power, 1 / self.precision) >= noise)

    def __call__(self, phase: Array, clock: Array) -> Array:
        """Features at times in s: of the periodic behaviour, and of the record; shape (time, column)."""
        periodic = harmonic_features(phase, self.period, self.harmonics)
        slow = self.slow_features(clock)
        place, slowness = self.places
        return np.asarray(periodic[:, place] * slow[slowness].T)

    def combined(self, phase: Array, clock: Array, coefficients: Array) -> Array:
        """Sums of features times coefficients (signal x column), without the features; shape (time, signal)."""
        of_signals = coefficients.reshape(-1, self.columns)
        slow = 1 if self.decay is None else 1 + len(self.decay.variances)
        weights = np.zeros((2 * self.harmonics + 1, len(of_signals), slow))
        place, slowness = self.places
        weights[place, :, slowness] = of_signals.T
        of_harmonics = np.tensordot(self.slow_features(clock), weights, axes=(0, 2))  # (time, harmonic, signal)
        return np.asarray(np.einsum("th,thm->tm", harmonic_features(phase, self.period, self.harmonics), of_harmonics))

    @cached_property
    def places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Column of :func:`harmonic_features` and row of :meth:`slow_features` that make each feature."""
        harmonic, part, slowness = np.array(self.products).T
        return np.maximum(0, 2 * harmonic - 1 + part), slowness
