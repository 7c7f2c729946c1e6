"""Plan an experiment: how many realizations a required precision of stiffness takes."""

from tvsysid.planning.answers import Answer, Plan, plan
from tvsysid.planning.curves import Curve
from tvsysid.planning.protocol import Protocol

__all__ = ["Answer", "Curve", "Plan", "Protocol", "plan"]
