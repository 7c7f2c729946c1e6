"""Plan an experiment: how many realizations a required precision of stiffness takes."""

from tvsysid.planning.curves import Curve
from tvsysid.planning.plans import Plan, RequiredRecording, plan
from tvsysid.planning.protocol import Protocol

__all__ = ["Curve", "Plan", "Protocol", "RequiredRecording", "plan"]
