"""A joint with time-varying impedance whose angle is imposed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tvsysid.simulate.actuator import answer
from tvsysid.simulate.perturbations import Perturbation
from tvsysid.simulate.profiles import Profile, SquareWave, checked_profile, over_time
from tvsysid.simulate.settings import positive
from tvsysid.simulate.setup import Setup
from tvsysid.simulate.simulation import Seed, Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Joint:
    r"""A joint whose torque answers an imposed angle.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + n(t)

    Its truth holds ``stiffness``, ``viscosity`` and ``inertia``; its one pathway is ``intrinsic``.

    Parameters
    ----------
    stiffness
        Callable of time in s, to N·m/rad; one with an attribute ``period`` (in s) is evaluated over one period.
    viscosity
        In N·m·s/rad, or a callable as for the stiffness.
    inertia
        In kg·m².

    Raises
    ------
    InputError
        For an inertia that is not positive, or what is neither number nor callable.

    References
    ----------
    van de Ruit et al. 2021, section 3.1.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    >>> joint.simulate(40, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    Simulation(Recording(42 s at 1000 Hz; ...); stiffness 50 to 150, viscosity 2.2, inertia 0.02; pathways intrinsic)
    """

    stiffness: Profile = field(default_factory=SquareWave)
    viscosity: float | Profile = 2.2
    inertia: float = 0.02

    def __post_init__(self) -> None:
        name = type(self).__name__
        checked_profile(name, "stiffness", self.stiffness)
        checked_profile(name, "viscosity", self.viscosity, number=True)
        positive(name, inertia=self.inertia)

    def simulate(
        self, duration: float, *, perturbation: Perturbation, snr_db: float, seed: Seed, rate: float = 1000.0
    ) -> Simulation:
        """Record so many seconds.

        The perturbation passes a 40-Hz second-order Bessel filter (the actuator), whose states are angle and velocity
        and give the acceleration, so that nothing is differenced. The angle is scaled to an RMS of 0.5 degrees. The
        noise is white noise through a 40-Hz second-order Butterworth filter, scaled so that noiseless torque and
        noise have the ratio of variances asked for. Both scales are those of the samples from time 0 to the duration.

        Parameters
        ----------
        duration
            In s, counted from time 0. The recording has one second more on both sides.
        perturbation
            :class:`FilteredNoise`, :class:`PRBS`, or anything with their ``generate``.
        snr_db
            Ratio of the variances of noiseless torque and noise in dB; ``inf`` for no noise.
        seed
            Integer, SeedSequence or generator; the same one gives the same numbers. Perturbation and noise have
            streams of their own.
        rate
            Sampling rate in Hz, above twice the 40 Hz of the filters.

        Returns
        -------
        Simulation
            The recording and the truth.

        Raises
        ------
        InputError
            For a duration or rate that is not positive, or a profile that does not give one finite number for each
            time.
        """
        return self._simulated(Setup(type(self).__name__, duration, perturbation, snr_db, seed, rate))

    def _simulated(self, setup: Setup) -> Simulation:
        truth = self._impedance(setup, setup.index)
        found = answer(setup, truth, setup.streams())
        return setup.simulation(found.angle, found.noise, {"intrinsic": found.torque}, truth)

    def _impedance(self, setup: Setup, index: NDArray[np.int64]) -> dict[str, Array]:
        """Stiffness, viscosity and inertia over time."""
        values = {"stiffness": self.stiffness, "viscosity": self.viscosity, "inertia": self.inertia}
        return {name: over_time(f"{setup.system}: {name}", value, index, setup.rate) for name, value in values.items()}
