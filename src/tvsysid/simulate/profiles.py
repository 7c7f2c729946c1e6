"""How stiffness, viscosity or a gain changes over time: any callable of time serves.

These are the usual ones.
"""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.simulate.settings import finite, is_number, positive

Profile = Callable[[Array], Array]  # of times in s, to one number for each


@attrs.frozen
class Constant:
    """The same value at all times, in N·m/rad for stiffness, N·m·s/rad for viscosity."""

    value: float = 100.0

    def __attrs_post_init__(self) -> None:
        finite("Constant", value=self.value)

    @property
    def period(self) -> float:
        """No time after which it repeats is needed: any will do; 1 s."""
        return 1.0

    def __call__(self, time: Array) -> Array:
        """Value at each time."""
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

    def __attrs_post_init__(self) -> None:
        finite("SquareWave", low=self.low, high=self.high, offset=self.offset)
        positive("SquareWave", period=self.period)

    def __call__(self, time: Array) -> Array:
        """Value at each time."""
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

    def __attrs_post_init__(self) -> None:
        finite("SineWave", mean=self.mean, amplitude=self.amplitude, offset=self.offset)
        positive("SineWave", period=self.period)

    def __call__(self, time: Array) -> Array:
        """Value at each time."""
        phase = 2 * np.pi * (np.asarray(time) - self.offset) / self.period
        return np.asarray(self.mean + self.amplitude * np.sin(phase))


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

    stiffness: Profile
    low: float = 1.0
    high: float = 3.0

    def __attrs_post_init__(self) -> None:
        if not callable(self.stiffness):
            raise InputError(
                f"CovaryingViscosity: stiffness must be a callable of time, got {self.stiffness!r}"
            )

    @property
    def period(self) -> float | None:
        """That of the stiffness in s, or None."""
        return getattr(self.stiffness, "period", None)

    def __call__(self, time: Array) -> Array:
        """Value at each time."""
        return self.low + (self.high - self.low) * (np.asarray(self.stiffness(time)) - 50.0) / 100.0


PROFILES: dict[str, Profile] = {"square": SquareWave(), "sine": SineWave(), "constant": Constant()}
"""Stiffness over time, by name."""


def checked_profile(system: str, name: str, profile: object, *, number: bool = False) -> None:
    """Raise InputError for what is no callable, nor (where one may be given) a finite number."""
    if callable(profile):
        return
    if not number:
        raise InputError(
            f"{system}: {name} must be a callable of time, such as Constant(100), got {profile!r}"
        )
    if not is_number(profile):
        raise InputError(
            f"{system}: {name} must be a finite number or a callable of time, got {profile!r}"
        )


def over_time(name: str, profile: float | Profile, index: NDArray[np.int64], rate: float) -> Array:
    """Profile at the times index / rate.

    One period is computed and repeated where that is exact.
    """
    if not callable(profile):
        return np.broadcast_to(np.float64(profile), len(index))
    period = getattr(profile, "period", None)
    exact = 0.0 if period is None else float(period) * rate
    cycle = round(exact)
    repeats = 0 < cycle < len(index) and abs(exact - cycle) < 1e-9 * cycle
    needed = np.arange(cycle) if repeats else index
    values = np.asarray(profile(needed / rate), dtype=np.float64)
    if values.shape != needed.shape or not np.isfinite(values).all():
        raise InputError(
            f"{name} must be one finite number for each time; for {len(needed)} times its profile "
            "gave "
            "values of shape "
            f"{values.shape}{'' if np.isfinite(values).all() else ', some of them not finite'}"
        )
    if not repeats:
        return np.array(values)
    shift = int(index[0]) % cycle
    return np.resize(np.concatenate([values[shift:], values[:shift]]), len(index))
