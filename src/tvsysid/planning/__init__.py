"""Planning an experiment: how many realizations stiffness takes to be known as precisely as one wishes."""

from tvsysid.planning.answers import Answer, Plan, Verified, plan
from tvsysid.planning.curves import Curve
from tvsysid.planning.setups import Pilot, Protocol

__all__ = ["Answer", "Curve", "Pilot", "Plan", "Protocol", "Verified", "plan"]
