"""Comparing methods on simulated data: what is studied, and running it."""

from tvsysid.benchmark.run import run
from tvsysid.benchmark.study import PERTURBATIONS, PROFILES, Study
from tvsysid.benchmark.summary import summarize

__all__ = ["PERTURBATIONS", "PROFILES", "Study", "run", "summarize"]
