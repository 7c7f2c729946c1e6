"""Describe the shape of a reflex: delay, muscle frequency, muscle damping and threshold."""

from __future__ import annotations

import cmath
import math
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from tvsysid.numerics import Array

FREQUENCIES, THRESHOLDS = (9.0, 16.0, 26.0), (0.0, 0.15, 0.5)  # initial values in rad/s
DELAYS = (0.04, 0.05, 0.06)  # initial values of a free delay in s


class Term(NamedTuple):
    """Prior mean and standard deviation of one number of the shape, its bounds and its step.

    The step is for numerical derivatives. Frequency and damping are given by their logarithms.
    """

    mean: float
    spread: float
    low: float
    high: float
    step: float


TERMS = {
    "frequency": Term(math.log(16), 0.6, math.log(3), math.log(60), 1e-3),
    "damping": Term(math.log(0.8), 0.5, math.log(0.2), math.log(3), 1e-3),
    "threshold": Term(0.0, 0.3, 0.0, 2.0, 0.02),
    "delay": Term(0.045, 0.010, 0.035, 0.075, 1e-4),
}
LOGARITHMIC = ("frequency", "damping")


class Shape(NamedTuple):
    """Shape of a reflex.

    ``delay`` is in s, ``frequency`` and ``threshold`` are in rad/s, and ``damping`` is a ratio.
    """

    delay: float
    frequency: float
    damping: float
    threshold: float

    def place(self, free: tuple[str, ...]) -> Array:
        """Return the free numbers, with frequency and damping as logarithms."""
        values = self._asdict()
        return np.array([math.log(values[n]) if n in LOGARITHMIC else values[n] for n in free])

    def at(self, free: tuple[str, ...], place: Array) -> Shape:
        """Return a shape with these free numbers, kept within their bounds."""
        inside = {
            name: min(max(float(value), TERMS[name].low), TERMS[name].high)
            for name, value in zip(free, place, strict=True)
        }
        return self._replace(
            **{name: math.exp(v) if name in LOGARITHMIC else v for name, v in inside.items()}
        )

    def log_prior(self, free: tuple[str, ...]) -> float:
        """Return the log density of the free numbers, up to a constant."""
        terms = zip(self.place(free), (TERMS[name] for name in free), strict=True)
        return -0.5 * float(sum(((value - term.mean) / term.spread) ** 2 for value, term in terms))

    def delayed(self, values: Array, rate: float) -> Array:
        r"""Return values (…, time) behind the delay and the muscle.

        The muscle is :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`, sampled, with unit gain.
        """
        whole = math.floor(self.delay * rate + 1e-9)
        rest = max(0.0, self.delay * rate - whole)
        root = cmath.sqrt(self.damping**2 - 1 or 1e-12)
        if abs(root) < 1e-4:
            root = 1e-4 + 0j
        first, second = (self.frequency / rate * (-self.damping + sign * root) for sign in (1, -1))
        poles = cmath.exp(first), cmath.exp(second)
        late = cmath.exp(-first * rest), cmath.exp(-second * rest)
        one = ((late[0] * poles[0] - late[1] * poles[1]) / (poles[0] - poles[1])).real
        two = (poles[0] * poles[1] * (late[1] - late[0]) / (poles[0] - poles[1])).real
        down = np.array([1.0, -(poles[0] + poles[1]).real, (poles[0] * poles[1]).real])
        up = np.array([one, two]) * (down.sum() / (one + two))
        times = values.shape[-1]
        # A recursive filter is a banded system; importing scipy.signal takes 0.3 s.
        band = np.repeat(down[:, None], times, axis=1)
        slow = lapack.dtbtrs(band, values.reshape(-1, times).T, uplo="L")[0].T.reshape(values.shape)
        out: Array = np.zeros_like(slow)
        for lag, weight in enumerate(up, whole + 1):
            out[..., lag:] += weight * slow[..., : max(times - lag, 0)]
        return out

    def response(self, samples: int, rate: float) -> Array:
        """Return the impulse response of delay and muscle at lags from 0 on."""
        return np.asarray(self.delayed(np.eye(1, samples)[0], rate))


def first_shapes(delay: float | None, free: tuple[str, ...]) -> list[Shape]:
    """Return the initial shapes. A delay of None is free."""
    thresholds = THRESHOLDS if "threshold" in free else (0.0,)
    delays = DELAYS if delay is None else (delay,)
    return [Shape(d, w, 0.8, c) for d, w, c in product(delays, FREQUENCIES, thresholds)]
