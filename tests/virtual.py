"""Virtual participants that tests share, and the same without imperfections."""

from functools import cache, lru_cache

import attrs

import tvsysid as tv

IMPERFECTIONS = (
    "delay",
    "delay_jitter",
    "amplitude_jitter",
    "amplitude_drift",
    "offset_jitter",
    "fluctuation",
    "sensor_noise",
    "late_noise",
    "late_prbs",
    "weak",
    "twitches",
)


@lru_cache(maxsize=4)
def simulated(number: int, perturbation: str = "noise") -> tv.simulate.Simulation:
    return tv.simulate.Participant(number).simulate(
        perturbation=tv.simulate.PERTURBATIONS[perturbation]
    )


def perfect(number: int = 1, **changes: float) -> tv.simulate.Traits:
    """Traits of a person who follows the target without fail."""
    return attrs.evolve(
        tv.simulate.Traits.of(number), **{**dict.fromkeys(IMPERFECTIONS, 0.0), **changes}
    )


@cache
def prepared(number: int, perturbation: str) -> tv.preprocess.Preparation:
    return tv.preprocess.prepare_experiment(simulated(number, perturbation).recording)
