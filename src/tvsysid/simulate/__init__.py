"""Systems that can be simulated, and carry the truth; perturbations and profiles for them."""

from tvsysid.simulate.compliant import CompliantActuator as CompliantActuator
from tvsysid.simulate.joint import Joint as Joint
from tvsysid.simulate.joint import ReflexJoint as ReflexJoint
from tvsysid.simulate.joint import ScheduledJoint as ScheduledJoint
from tvsysid.simulate.joint import StretchReflex as StretchReflex
from tvsysid.simulate.participant import Participant as Participant
from tvsysid.simulate.participant import Traits as Traits
from tvsysid.simulate.perturbations import PERTURBATIONS as PERTURBATIONS
from tvsysid.simulate.perturbations import PRBS as PRBS
from tvsysid.simulate.perturbations import FilteredNoise as FilteredNoise
from tvsysid.simulate.perturbations import Perturbation as Perturbation
from tvsysid.simulate.profiles import PROFILES as PROFILES
from tvsysid.simulate.profiles import Constant as Constant
from tvsysid.simulate.profiles import CovaryingViscosity as CovaryingViscosity
from tvsysid.simulate.profiles import Profile as Profile
from tvsysid.simulate.profiles import SineWave as SineWave
from tvsysid.simulate.profiles import SquareWave as SquareWave
from tvsysid.simulate.simulation import Seed as Seed
from tvsysid.simulate.simulation import Simulation as Simulation
from tvsysid.simulate.simulation import System as System

SYSTEMS: dict[str, Joint] = {
    "joint": Joint(),
    "reflex": ReflexJoint(),
    "compliant": CompliantActuator(),
    "scheduled": ScheduledJoint(),
}
"""Systems by name. Each is a dataclass with fields ``stiffness``, ``viscosity`` and ``inertia``, so that
``dataclasses.replace(SYSTEMS["reflex"], stiffness=PROFILES["sine"])`` gives the same system with another profile."""
