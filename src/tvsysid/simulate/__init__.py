"""Simulated joints that carry the truth: perturbations, stiffness profiles, the joint, a whole participant."""

from tvsysid.simulate.joint import Simulation, joint
from tvsysid.simulate.participant import Participant, Traits, Trials, participant
from tvsysid.simulate.perturbations import PRBS, FilteredNoise
from tvsysid.simulate.profiles import Constant, CovaryingViscosity, SineWave, SquareWave

__all__ = [
    "PRBS",
    "Constant",
    "CovaryingViscosity",
    "FilteredNoise",
    "Participant",
    "Simulation",
    "SineWave",
    "SquareWave",
    "Traits",
    "Trials",
    "joint",
    "participant",
]
