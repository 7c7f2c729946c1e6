"""Settings chosen from data: how good they are by a criterion, and which are the best."""

from tvsysid.methods.tuning.evidence import Evidence, Tuned
from tvsysid.methods.tuning.halves import evidence_by_halves
