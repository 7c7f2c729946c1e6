"""Profiles: how stiffness, viscosity or a gain changes over time. Any callable of time is one."""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np

from tvsysid.numerics import Array
from tvsysid.validators import Validator, is_number

Profile = Callable[[Array], Array]  # of times in s, to one number for each

is_profile = Validator("a callable of time, such as Constant(100)", callable)
number_or_profile = Validator(
    "a finite number or a callable of time", lambda value: is_number(value) or callable(value)
)


@attrs.frozen
class Constant:
    """Same value at all times, in N·m/rad for stiffness, N·m·s/rad for viscosity."""

    value: float = 100.0

    def __call__(self, time: Array) -> Array:
        """Return the value at each time."""
        return np.full(np.shape(time), self.value)


@attrs.frozen
class SquareWave:
    """Low, then high for half a period, then low: the most sudden change.

    The levels are in N·m/rad, the period and the ``offset`` of the first upward switch in s.

    Examples
    --------
    >>> SquareWave()(np.array([0.0, 0.499, 0.5, 1.499, 1.5, 2.0]))
    array([ 50.,  50., 150., 150.,  50.,  50.])
    """

    low: float = 50.0
    high: float = 150.0
    period: float = 2.0
    offset: float = 0.5

    def __call__(self, time: Array) -> Array:
        """Return the value at each time."""
        # Rounding keeps a sample that lies on a switch on the switch's far side.
        phase = np.round((np.asarray(time) - self.offset) / self.period, 9) % 1.0
        return np.where(phase < 0.5, self.high, self.low)


@attrs.frozen
class SineWave:
    """Sinusoid about a mean, both in N·m/rad, of a period in s: the usual voluntary modulation.

    At ``offset``, in s, it rises through its mean.
    """

    mean: float = 100.0
    amplitude: float = 50.0
    period: float = 2.0
    offset: float = 0.0

    def __call__(self, time: Array) -> Array:
        """Return the value at each time."""
        phase = 2 * np.pi * (np.asarray(time) - self.offset) / self.period
        return self.mean + self.amplitude * np.sin(phase)


@attrs.frozen
class CovaryingViscosity:
    """Viscosity that rises and falls with a stiffness, a profile in N·m/rad.

    It is ``low`` and ``high``, in N·m·s/rad, where the stiffness is 50 and 150 N·m/rad; in
    proportion elsewhere. The defaults are the range that van de Ruit et al. 2021 tried.

    Examples
    --------
    >>> CovaryingViscosity(SquareWave())(np.array([0.0, 1.0]))
    array([1., 3.])
    """

    stiffness: Profile = attrs.field(validator=is_profile)
    low: float = 1.0
    high: float = 3.0

    @property
    def period(self) -> float | None:
        """Period of the stiffness in s, if it has one."""
        return getattr(self.stiffness, "period", None)

    def __call__(self, time: Array) -> Array:
        """Return the value at each time."""
        return self.low + (self.high - self.low) * (np.asarray(self.stiffness(time)) - 50.0) / 100.0


PROFILES: dict[str, Profile] = {"square": SquareWave(), "sine": SineWave(), "constant": Constant()}
"""Stiffness over time, by name."""


def over_time(profile: float | Profile, time: Array, rate: float) -> Array:
    """Return the values of a number or profile at multiples of 1/rate.

    A profile with an attribute ``period`` in s is evaluated over one period, if this is a whole
    number of samples.
    """
    exact = rate * (getattr(profile, "period", None) or 0.0)
    cycle = round(exact)
    if 0 < cycle < len(time) and abs(exact - cycle) < 1e-9 * cycle:
        index = np.rint(time * rate).astype(np.int64)
        return evaluate(profile, np.arange(cycle) / rate)[index % cycle]
    return evaluate(profile, time)


def evaluate(function: float | Profile, argument: Array) -> Array:
    """Return the values of a number or function. One value holds for all arguments."""
    return np.full(argument.shape, function(argument) if callable(function) else function, float)
