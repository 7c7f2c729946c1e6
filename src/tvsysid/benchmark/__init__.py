"""Comparing methods on simulated data: what is studied, running it, where results are kept, and what they say."""

from tvsysid.benchmark.claims import judge
from tvsysid.benchmark.example import example_responses
from tvsysid.benchmark.plan import plan
from tvsysid.benchmark.run import read_results, run
from tvsysid.benchmark.scores import score, summarize, time_spent
from tvsysid.benchmark.study import PRESETS, Study

__all__ = [
    "PRESETS",
    "Study",
    "example_responses",
    "judge",
    "plan",
    "read_results",
    "run",
    "score",
    "summarize",
    "time_spent",
]
