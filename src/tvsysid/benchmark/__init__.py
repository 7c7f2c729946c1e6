"""Comparing methods on simulated data: what is studied, running it, and what a method must do to take part."""

from tvsysid.benchmark.contract import Check, check_method
from tvsysid.benchmark.run import run
from tvsysid.benchmark.study import PERTURBATIONS, PROFILES, Study
from tvsysid.benchmark.summary import summarize

__all__ = ["PERTURBATIONS", "PROFILES", "Check", "Study", "check_method", "run", "summarize"]
