"""Which method suits an ensemble, and why."""

from tvsysid.recommendation.decide import Recommendation, moving, recommend
from tvsysid.recommendation.rules import RULES, Rule, rule_of

__all__ = ["RULES", "Recommendation", "Rule", "moving", "recommend", "rule_of"]
