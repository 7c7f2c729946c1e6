"""Recommend a method for an ensemble, and judge how far its stiffness can be trusted."""

from tvsysid.recommendation.recommendation import (
    Recommendation,
    find_unnamed_references,
    recommend,
)
from tvsysid.recommendation.trust import Trust, trust_in

__all__ = ["Recommendation", "Trust", "find_unnamed_references", "recommend", "trust_in"]
