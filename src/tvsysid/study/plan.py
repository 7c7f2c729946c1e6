"""What a study will take, before it is run."""

from __future__ import annotations

import time
from dataclasses import dataclass

from tvsysid.study.simulated import Study
from tvsysid.study.source import Simulations
from tvsysid.study.task import carry_out

LONGEST_S = 600.0
"""Seconds of data beyond which nothing is timed."""


@dataclass(frozen=True)
class Plan:
    """What a study will take.

    Parameters
    ----------
    trials
        Of all scenarios.
    simulated_s
        Seconds of data that they simulate.
    work_s
        Seconds that they take one process.
    size_bytes
        Of the results.
    failures
        Methods that gave no result in the trials that were timed, and why.
    """

    trials: int
    simulated_s: float
    work_s: float
    size_bytes: int
    failures: dict[str, str]


def plan(study: Study) -> Plan:
    """Estimate from timing a trial of the shortest and one of the longest duration, but 600 s at most.

    Time is taken to grow in proportion to the duration, beside a fixed part.
    """
    source = Simulations(study)
    by_duration = sorted(study.scenarios, key=lambda scenario: scenario.duration_s)
    ends = [end._replace(duration_s=min(end.duration_s, LONGEST_S)) for end in (by_duration[0], by_duration[-1])]
    carry_out(source.trial(ends[0], 0))  # the first loads what is loaded lazily
    taken: list[float] = []
    failures: dict[str, str] = {}
    for scenario in ends:
        started = time.perf_counter()
        outcome = carry_out(source.trial(scenario, 0))
        taken.append(time.perf_counter() - started)
        failures |= {
            label: str(text) for label, text in zip(study.named_methods, outcome["failure"], strict=True) if text
        }
    span = ends[1].duration_s - ends[0].duration_s
    slope = max(0.0, (taken[1] - taken[0]) / span) if span else taken[0] / ends[0].duration_s
    work = sum(taken[0] + slope * (scenario.duration_s - ends[0].duration_s) for scenario in study.scenarios)
    simulated = sum(scenario.duration_s for scenario in study.scenarios) * study.trials
    return Plan(
        len(study.scenarios) * study.trials, simulated, work * study.trials, source.layout.bytes_of_numbers, failures
    )
