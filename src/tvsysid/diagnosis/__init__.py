"""What is doubtful about an ensemble: each finding with its strength, its effect and its remedy."""

from tvsysid.diagnosis.catalogue import KINDS
from tvsysid.diagnosis.check import Check
from tvsysid.diagnosis.curves import Curves
from tvsysid.diagnosis.diagnose import Diagnosis, diagnose, strength

__all__ = ["KINDS", "Check", "Curves", "Diagnosis", "diagnose", "strength"]
