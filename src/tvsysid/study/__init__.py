"""Comparing methods: what is studied, running it, where results are kept, and what they say."""

from tvsysid.study.contents import EXPERIMENT, SIMULATIONS
from tvsysid.study.prepared import Prepared, prepared_recordings, shown
from tvsysid.study.recorded import Experiment, Recorded
from tvsysid.study.run import plan, read_results, run
from tvsysid.study.scores import score, time_spent
from tvsysid.study.simulated import Study
from tvsysid.study.summary import (
    alignments,
    by_full_name,
    exclusions,
    of_quantity,
    stiffness_over_time,
    summarize,
)
from tvsysid.study.workers import cores, processes

__all__ = ["EXPERIMENT", "SIMULATIONS", "Experiment", "Prepared", "Recorded", "Study", "alignments"]
__all__ += ["by_full_name", "cores"]
__all__ += [
    "exclusions",
    "of_quantity",
    "plan",
    "prepared_recordings",
    "processes",
    "read_results",
    "run",
    "score",
    "shown",
]
__all__ += ["stiffness_over_time", "summarize", "time_spent"]
