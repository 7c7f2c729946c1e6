"""A joint whose stiffness is a function of a measured variable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.simulate.actuator import answer
from tvsysid.simulate.joint import Joint
from tvsysid.simulate.profiles import Profile, SineWave
from tvsysid.simulate.settings import not_negative, positive
from tvsysid.simulate.setup import Setup
from tvsysid.simulate.simulation import Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScheduledJoint(Joint):
    r"""A joint whose stiffness follows a measured variable, such as EMG, that differs from realization to realization.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(\rho(t))\,\theta(t) + n(t), \qquad
              \rho(t) = (1 + \sigma\, g(t))\, k^{-1}(k_0(t))

    The variable ρ would give the profile k₀ of the stiffness, were it not stronger or weaker each time: g is drawn anew
    every so many seconds, Gaussian with unit variance, and changes linearly in between; ρ is never negative. All else
    is as for :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``. Pathway: ``intrinsic``. Channel: the variable, by its name.

    Parameters
    ----------
    stiffness
        k₀, callable of time in s, to N·m/rad.
    viscosity, inertia
        As for :class:`Joint`.
    relation
        k, callable of the variable, to N·m/rad; rises from 0 to 1 and covers the profile there.
    variation
        σ: standard deviation of the variable's strength, relative to its mean.
    interval
        Seconds after which the strength is drawn anew.
    variable
        Name of the channel.

    Raises
    ------
    InputError
        As for :class:`Joint`, and for a relation that does not rise, or does not cover the profile.

    References
    ----------
    Stiffness that rises with muscle activity: Hunter & Kearney 1982, J. Biomech. 15, 747-752.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.ScheduledJoint().simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> list(simulation.recording.channels)
    ['emg']
    """

    stiffness: Profile = field(default_factory=SineWave)
    relation: Callable[[Array], Array] = field(default_factory=lambda: Polynomial([20.0, 200.0]))
    variation: float = 0.3
    interval: float = 2.0
    variable: str = "emg"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.relation):
            raise InputError(f"ScheduledJoint: relation must be a callable of the variable, got {self.relation!r}")
        not_negative("ScheduledJoint", variation=self.variation)
        positive("ScheduledJoint", interval=self.interval)

    def _simulated(self, setup: Setup) -> Simulation:
        streams = setup.streams(3)
        impedance = self._impedance(setup, setup.index)
        variable = self._usual(impedance["stiffness"]) * self._strength(setup.index / setup.rate, streams[2])
        impedance["stiffness"] = np.asarray(self.relation(variable), dtype=np.float64)
        found = answer(setup, impedance, streams)
        return setup.simulation(
            found.angle, found.noise, {"intrinsic": found.torque}, impedance, {self.variable: variable}
        )

    def _usual(self, stiffness: Array) -> Array:
        """Variable that gives a stiffness."""
        grid = np.linspace(0.0, 1.0, 10_001)
        values = np.asarray(self.relation(grid), dtype=np.float64)
        if values.shape != grid.shape or not np.all(np.diff(values) > 0):
            raise InputError(
                f"ScheduledJoint: relation must rise from 0 to 1, one number for each, got {self.relation!r}"
            )
        if not (values[0] <= stiffness.min() and stiffness.max() <= values[-1]):
            raise InputError(
                f"ScheduledJoint: stiffness goes from {stiffness.min():g} to {stiffness.max():g} N·m/rad, but relation "
                f"gives {values[0]:g} to {values[-1]:g} N·m/rad from 0 to 1; change one of them"
            )
        return np.interp(stiffness, values, grid)

    def _strength(self, time: Array, random: np.random.Generator) -> Array:
        """Factor on the variable over time; it is 1 on average."""
        knots = np.arange(time[0], time[-1] + self.interval, self.interval)
        factor = np.interp(time, knots, 1 + self.variation * random.standard_normal(len(knots)))
        return np.maximum(factor, 0.0)
