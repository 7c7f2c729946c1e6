"""What makes one virtual person differ from another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tvsysid.errors import InputError
from tvsysid.simulate.settings import not_negative, positive


@dataclass(frozen=True)
class Traits:
    """What makes one person differ from another.

    Parameters
    ----------
    maximal_torque
        Maximal voluntary torque in N·m.
    inertia
        Of foot and footplate together in kg·m².
    passive_stiffness
        In N·m/rad, without voluntary torque.
    stiffness_per_torque
        Rise of the stiffness with voluntary torque in 1/rad.
    damping_ratio
        Share of critical damping; the viscosity is 2 · damping ratio · √(stiffness · inertia).
    reflex_gain
        Torque per velocity of stretch in N·m·s/rad; 0 for no stretch reflex.
    delay
        By how much the voluntary torque follows the target on average, in s.
    delay_jitter
        Standard deviation of the delay from period to period, in s.
    amplitude_jitter, amplitude_drift
        Standard deviation of the amplitude from period to period, and of its slow drift, as shares of it.
    offset_jitter
        Standard deviation of the mean torque from period to period, as a share of the amplitude.
    fluctuation
        Standard deviation of the torque's fluctuations up to some 3 Hz, as a share of the torque.
    sensor_noise
        Standard deviation of the torque sensor's noise in N·m.
    late_noise, late_prbs
        Share of the periods in which the rhythm is lost, for either perturbation.
    weak, twitches
        Share of the periods in which the amplitude lapses, and in which the foot twitches.
    """

    maximal_torque: float
    inertia: float
    passive_stiffness: float
    stiffness_per_torque: float
    damping_ratio: float
    reflex_gain: float
    delay: float
    delay_jitter: float
    amplitude_jitter: float
    amplitude_drift: float
    offset_jitter: float
    fluctuation: float
    sensor_noise: float
    late_noise: float
    late_prbs: float
    weak: float
    twitches: float

    def __post_init__(self) -> None:
        positive("Traits", **{name: getattr(self, name) for name in ("maximal_torque", "inertia", "passive_stiffness")})
        not_negative("Traits", **vars(self))

    @classmethod
    def of(cls, number: int) -> Traits:
        """Traits of the participant with this number; without a stretch reflex.

        Notes
        -----
        Stiffness rises by some 4 N·m/rad with each N·m, and the damping ratio does not depend on it, as is usually
        found at the ankle under small perturbations; with the target's range, that gives the 50 to 150 N·m/rad of
        the paper's simulations. The imperfections are set such that the paper's exclusions and VAFs come out.
        """
        random = streams_of(number)[0]
        clumsiness = math.exp(0.15 * random.standard_normal())
        lapsing = random.uniform(0.4, 1.6)
        return cls(
            maximal_torque=random.uniform(48, 66),
            inertia=random.uniform(0.052, 0.066),
            passive_stiffness=random.uniform(25, 45),
            stiffness_per_torque=random.uniform(3.3, 4.5),
            damping_ratio=random.uniform(0.35, 0.5),
            reflex_gain=0.0,
            delay=random.uniform(0.0, 0.1),
            delay_jitter=0.03 * clumsiness,
            amplitude_jitter=0.025 * clumsiness,
            amplitude_drift=0.02 * clumsiness,
            offset_jitter=0.016 * clumsiness,
            fluctuation=0.058 * clumsiness,
            sensor_noise=0.15,
            late_noise=0.005 * lapsing,
            late_prbs=0.04 * lapsing,
            weak=0.024 * lapsing,
            twitches=0.05 * lapsing,
        )


def streams_of(number: int) -> list[np.random.Generator]:
    """Independent random numbers for the person's traits and for either perturbation's trials."""
    try:
        return np.random.default_rng(number).spawn(3)
    except (TypeError, ValueError) as error:
        raise InputError(f"Participant: number must be a whole number of zero or more, got {number!r}") from error
