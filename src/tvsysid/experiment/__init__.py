"""Comparing methods on people: their trials prepared, bootstrapped and identified, and what came out."""

from tvsysid.experiment.claims import judge
from tvsysid.experiment.experiment import Experiment, Recorded
from tvsysid.experiment.layout import TITLE
from tvsysid.experiment.prepared import Prepared, prepared_recordings, shown
from tvsysid.experiment.run import read_results, run
from tvsysid.experiment.summary import exclusions, stiffness_over_time, summarize

__all__ = [
    "TITLE",
    "Experiment",
    "Prepared",
    "Recorded",
    "exclusions",
    "judge",
    "prepared_recordings",
    "read_results",
    "run",
    "shown",
    "stiffness_over_time",
    "summarize",
]
