"""Simulate systems whose impedance is known; perturbations and profiles for them."""

from tvsysid.simulate.compliant import CompliantActuator
from tvsysid.simulate.joint import Joint, ReflexJoint, ScheduledJoint
from tvsysid.simulate.participant import Participant, Traits
from tvsysid.simulate.perturbations import (
    PERTURBATIONS,
    PRBS,
    FilteredNoise,
    Multisine,
    Perturbation,
    Pulses,
)
from tvsysid.simulate.profiles import (
    PROFILES,
    Constant,
    CovaryingViscosity,
    Profile,
    SineWave,
    SquareWave,
)
from tvsysid.simulate.reflex import StretchReflex
from tvsysid.simulate.simulation import Seed, Simulation, System

__all__ = [
    "PERTURBATIONS",
    "PRBS",
    "PROFILES",
    "SYSTEMS",
    "CompliantActuator",
    "Constant",
    "CovaryingViscosity",
    "FilteredNoise",
    "Joint",
    "Multisine",
    "Participant",
    "Perturbation",
    "Profile",
    "Pulses",
    "ReflexJoint",
    "ScheduledJoint",
    "Seed",
    "Simulation",
    "SineWave",
    "SquareWave",
    "StretchReflex",
    "System",
    "Traits",
]

SYSTEMS: dict[str, Joint] = {
    "joint": Joint(),
    "reflex": ReflexJoint(),
    "reflex-sine": ReflexJoint(reflex_gain=SineWave(8.0, 4.0, offset=-0.5)),
    "reflex-square": ReflexJoint(reflex_gain=SquareWave(4.0, 12.0, offset=0.0)),
    "compliant": CompliantActuator(),
    "scheduled": ScheduledJoint(),
    "loaded": CompliantActuator(disturbance="torque"),
}
"""Systems by name.

Each has fields ``stiffness``, ``viscosity`` and ``inertia``, so that
``attrs.evolve(SYSTEMS["reflex"], stiffness=PROFILES["sine"])`` gives the same system with
another profile."""
