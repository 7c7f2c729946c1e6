"""Simulated joints that carry the truth: perturbations, stiffness profiles, the joint itself."""

from tvsysid.simulate.joint import Simulation, joint
from tvsysid.simulate.perturbations import PRBS, FilteredNoise
from tvsysid.simulate.profiles import Constant, CovaryingViscosity, SineWave, SquareWave

__all__ = ["PRBS", "Constant", "CovaryingViscosity", "FilteredNoise", "Simulation", "SineWave", "SquareWave", "joint"]
