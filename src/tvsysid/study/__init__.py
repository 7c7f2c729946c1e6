"""Compare methods: define a study, run it, and summarize its results."""

from tvsysid.study.bootstraps import Prepared, prepared_recordings
from tvsysid.study.dataset import read_results
from tvsysid.study.experiment import Experiment, Recorded
from tvsysid.study.run import estimate_duration, run
from tvsysid.study.scenarios import Study
from tvsysid.study.scores import exclusions, score, stiffness_over_time, summarize
from tvsysid.study.workers import cores

__all__ = [
    "Experiment",
    "Prepared",
    "Recorded",
    "Study",
    "cores",
    "estimate_duration",
    "exclusions",
    "prepared_recordings",
    "read_results",
    "run",
    "score",
    "stiffness_over_time",
    "summarize",
]
