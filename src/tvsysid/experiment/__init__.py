"""Comparing methods on people: their trials prepared, bootstrapped and identified, and what came out."""

from tvsysid.experiment.experiment import Experiment, Recorded
from tvsysid.experiment.prepared import Prepared, prepared_recordings, shown
from tvsysid.experiment.run import read_results, run

__all__ = [
    "Experiment",
    "Prepared",
    "Recorded",
    "prepared_recordings",
    "read_results",
    "run",
    "shown",
]
