"""Recommend a method for an ensemble, and judge what an identified stiffness is worth."""

from tvsysid.recommendation.answer import Answer, answer
from tvsysid.recommendation.method import Recommendation, find_unnamed_references, recommend

__all__ = ["Answer", "Recommendation", "answer", "find_unnamed_references", "recommend"]
