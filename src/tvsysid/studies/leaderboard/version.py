"""What is run, and frozen: to change any of it is to begin a version with a number of its own."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import CLOSED_LOOP, names, parse
from tvsysid.study.scenarios import Scenario, Study, preset_study

VERSION = 1
SEED = 1  # of the public trials; those of an official table are kept secret
DIGEST = "aea0ef10ed2fb7ec"  # of the scenarios below
TRIALS = 10
SIMULATED_S = 8.0  # s of each scenario that its digest counts
SECRET = 2**64  # a smaller seed could be found from its hash by trying

OTHER_SINE = "sine:mean=80,amplitude=60,offset=0.3"
SCHEDULED = "scheduled:variable=scheduling"
FREE = (
    "loaded:inertia=0.1,viscosity=1.3,actuator_stiffness=0,actuator_viscosity=0,actuator_inertia=0"
)
SCENARIOS = (
    Scenario("square", "noise", 40.0, 10.0),
    Scenario("square", "prbs", 80.0, 10.0, "covarying"),
    Scenario(OTHER_SINE, "pulses", 40.0, 0.0),
    Scenario("sine", "multisine", 80.0, 10.0),
    Scenario("sine", "noise", 80.0, 10.0, system="reflex-sine"),
    Scenario("square", "prbs", 80.0, 10.0, system="reflex-square:noise_bandwidth=1"),
    Scenario("constant", "pulses", 40.0, 5.0, system="reflex"),
    Scenario("sine", "noise:cutoff=20", 40.0, 5.0, system="compliant:noise_bandwidth=5"),
    Scenario(
        "square",
        "noise:cutoff=20",
        80.0,
        5.0,
        system="loaded:actuator_stiffness=30,noise_bandwidth=2",
    ),
    Scenario("sine", "pulses:duration=0.02,interval=1", 80.0, 10.0, system=FREE),
    Scenario("sine", "noise", 40.0, 10.0, system=SCHEDULED),
    Scenario("square", "prbs", 150.0, 0.0, system=SCHEDULED),
    Scenario(OTHER_SINE, "pulses", 80.0, 10.0, system=SCHEDULED),
)
"""Joints whose angle is imposed, with a reflex, in closed loop, and scheduled by a variable."""


def study_of(
    entries: Sequence[object] = (), scenarios: Sequence[object] = (), **changes: Any
) -> Study:
    """Return the leaderboard's study: methods of the package, of installed packages, and others.

    Further ``scenarios`` and ``changes`` of settings make it another one than the version's, as
    its digest shows. An installed method that cannot be made as it is is left out, with a
    warning.
    """
    first, *others = (
        {name: (value,) for name, value in each._asdict().items()} for each in SCENARIOS
    )
    methods = dict.fromkeys((*filter(_usable, names()), *CLOSED_LOOP, *entries))
    fixed = {"subtract_mean": True, "trials": TRIALS, "seed": SEED, "methods": tuple(methods)}
    study = preset_study({**first, **fixed, "also": others}, **changes)
    return attrs.evolve(study, also=(*study.also, *scenarios))


def _usable(name: str) -> bool:
    try:
        parse(name)
    except InputError as error:
        warnings.warn(f"{error}; it is left out", DataQualityWarning, stacklevel=3)
        return False
    return True


def digest(study: Study) -> str:
    """Return a hash of the settings of each scenario, and of the size of its first seconds.

    The sizes show a change of a default or of a simulation, which no setting shows.
    """
    settings = f"{study.rate:g} Hz of {study.period:g} s, {study.subtract_mean}"
    lines = [f"{study.trials} trials at {settings}"]
    for scenario in study.scenarios:
        system, perturbation = study.simulated(scenario)
        seed, snr_db = np.random.SeedSequence(0), scenario.snr_db
        simulation = system.simulate(
            SIMULATED_S, perturbation=perturbation, snr_db=snr_db, seed=seed, rate=1000.0
        )
        signals = simulation.recording.angle, simulation.recording.torque
        lines.append(" ".join([*map(str, scenario), *(f"{np.std(each):.3e}" for each in signals)]))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def commitment(seed: int) -> str:
    """Return the SHA-256 that is published before its seed.

    Whoever is later given the seed can check that it is the same one.
    """
    return hashlib.sha256(f"tvsysid leaderboard {VERSION} seed {seed}".encode()).hexdigest()
