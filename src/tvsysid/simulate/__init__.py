"""Systems that can be simulated, and carry the truth; perturbations and profiles for them."""

from tvsysid.simulate.joint import Joint
from tvsysid.simulate.participant import Participant
from tvsysid.simulate.perturbations import PERTURBATIONS, PRBS, FilteredNoise, Perturbation
from tvsysid.simulate.profiles import PROFILES, Constant, CovaryingViscosity, Profile, SineWave, SquareWave
from tvsysid.simulate.reflex import StretchReflex
from tvsysid.simulate.simulation import Seed, Simulation, System
from tvsysid.simulate.traits import Traits

__all__ = [
    "PERTURBATIONS",
    "PRBS",
    "PROFILES",
    "Constant",
    "CovaryingViscosity",
    "FilteredNoise",
    "Joint",
    "Participant",
    "Perturbation",
    "Profile",
    "Seed",
    "Simulation",
    "SineWave",
    "SquareWave",
    "StretchReflex",
    "System",
    "Traits",
]
