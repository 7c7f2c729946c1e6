"""Which method suits an ensemble, and why."""

from tvsysid.recommendation.decide import Recommendation, moving, recommend
from tvsysid.recommendation.rules import RULES, Rule, rule_of
from tvsysid.recommendation.trust import Trust, trust_in

__all__ = ["RULES", "Recommendation", "Rule", "Trust", "moving", "recommend", "rule_of", "trust_in"]
