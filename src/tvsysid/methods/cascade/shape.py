"""Describe the shape of a reflex: delay, muscle frequency, muscle damping and threshold."""

from __future__ import annotations

import cmath
import math
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from tvsysid.numerics import Array


class Terms(NamedTuple):
    """Priors of some numbers of the shape: means, standard deviations, bounds and steps.

    The steps are for numerical derivatives. Frequency and damping are given by their logarithms.
    """

    mean: Array
    spread: Array
    low: Array
    high: Array
    step: Array

    @classmethod
    def of(cls, free: tuple[str, ...]) -> Terms:
        """Return the priors of the free numbers."""
        return cls(*np.array([TERMS[name] for name in free]).reshape(-1, 5).T)


TERMS = {
    "frequency": (math.log(16), 0.6, math.log(3), math.log(60), 1e-3),
    "damping": (math.log(0.8), 0.5, math.log(0.2), math.log(3), 1e-3),
    "threshold": (0.0, 0.3, 0.0, 2.0, 0.02),
    "delay": (0.045, 0.010, 0.035, 0.075, 1e-4),
}
LOGARITHMIC = ("frequency", "damping")
START_FREQUENCIES, START_THRESHOLDS = (9.0, 16.0, 26.0), (0.0, 0.15, 0.5)  # rad/s
START_DELAYS = (0.04, 0.05, 0.06)  # s


class Shape(NamedTuple):
    """Shape of a reflex.

    ``delay`` is in s, ``frequency`` and ``threshold`` are in rad/s, and ``damping`` is a ratio.
    """

    delay: float
    frequency: float = 16.0
    damping: float = 0.8
    threshold: float = 0.0

    def position(self, free: tuple[str, ...]) -> Array:
        """Return the free numbers, with frequency and damping as logarithms."""
        values = self._asdict()
        return np.array([math.log(values[n]) if n in LOGARITHMIC else values[n] for n in free])

    def at(self, free: tuple[str, ...], position: Array) -> Shape:
        """Return a shape with these free numbers, kept within their bounds."""
        terms = Terms.of(free)
        inside = dict(zip(free, np.clip(position, terms.low, terms.high).tolist(), strict=True))
        return self._replace(
            **{name: math.exp(v) if name in LOGARITHMIC else v for name, v in inside.items()}
        )

    def log_prior(self, free: tuple[str, ...]) -> float:
        """Return the log density of the free numbers, up to a constant."""
        terms = Terms.of(free)
        return -0.5 * float(np.sum(((self.position(free) - terms.mean) / terms.spread) ** 2))

    def delayed(self, values: Array, rate: float) -> Array:
        r"""Return values (…, time) behind the delay and the muscle.

        The muscle is :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`, sampled, with unit gain.
        """
        whole = math.floor(self.delay * rate + 1e-9)
        rest = max(0.0, self.delay * rate - whole)
        # Poles of critical damping would be the same. They are taken apart.
        root = max(cmath.sqrt(self.damping**2 - 1), 1e-4, key=abs)
        exponents = self.frequency / rate * (np.array([root, -root]) - self.damping)
        poles, late = np.exp(exponents), np.exp(-exponents * rest)
        ratio = poles.prod() * (late[1] - late[0]) / (late[0] * poles[0] - late[1] * poles[1])
        down = np.array([1.0, -poles.sum().real, poles.prod().real])
        up = down.sum() / (1 + ratio.real) * np.array([1.0, ratio.real])
        # A recursive filter is a banded system; importing scipy.signal takes 0.3 s.
        times = values.shape[-1]
        band = np.repeat(down[:, None], times, axis=1)
        slow = lapack.dtbtrs(band, values.reshape(-1, times).T, uplo="L")[0].T.reshape(values.shape)
        out: Array = np.zeros_like(slow)
        for lag, weight in enumerate(up, whole + 1):
            out[..., lag:] += weight * slow[..., : max(times - lag, 0)]
        return out

    def response(self, samples: int, rate: float) -> Array:
        """Return the impulse response of delay and muscle at lags from 0 on."""
        return self.delayed(np.eye(1, samples)[0], rate)


def first_shapes(delay: float | None, free: tuple[str, ...]) -> list[Shape]:
    """Return the initial shapes. A delay of None is free."""
    thresholds = START_THRESHOLDS if "threshold" in free else (0.0,)
    frequencies = START_FREQUENCIES if free else (16.0,)
    delays = START_DELAYS if delay is None else (delay,)
    return [Shape(d, w, 0.8, c) for d, w, c in product(delays, frequencies, thresholds)]
