"""Simulation study: scenarios, methods, trials."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import STUDIED_METHODS, Method, label_of, resolve
from tvsysid.methods.registry import find
from tvsysid.simulate import (
    PERTURBATIONS,
    PROFILES,
    SYSTEMS,
    CovaryingViscosity,
    Participant,
    Perturbation,
    ScheduledJoint,
    System,
)
from tvsysid.study.settings import (
    Settings,
    check_distinct,
    check_keys,
    first_repeated,
    from_table,
    labels_of,
    replace_settings,
    spawn_key,
    to_method,
    to_tuple,
)
from tvsysid.validators import (
    at_least,
    boolean,
    is_number,
    positive,
    settings_of,
    to_float,
    with_settings,
)

VISCOSITIES = ("constant", "covarying")
"""The system's own (2.2 N·m·s/rad), or between 1 and 3 N·m·s/rad with the stiffness."""
PERIOD, RATE = 2.0, 100.0  # s of a realization, and Hz after decimation, as in the paper
OWN = "own"  # stiffness and viscosity of a system that has no such settings

GRID = ("stiffness", "perturbation", "duration_s", "snr_db", "viscosity", "system")
KINDS: dict[str, tuple[Mapping[str, object], str, str]] = {
    "stiffness": (PROFILES, "profile", "__call__"),
    "perturbation": (PERTURBATIONS, "perturbation", "generate"),
    "system": (SYSTEMS, "system", "simulate"),
    "viscosity": (dict.fromkeys(VISCOSITIES, ""), "viscosity", ""),
}
"""Known values of a setting, their kind, and the method of an object in their place."""


class Scenario(NamedTuple):
    """One kind of simulated experiment, by the labels of its parts."""

    stiffness: str
    perturbation: str
    duration_s: float
    snr_db: float
    viscosity: str = "constant"
    system: str = "joint"

    @property
    def label(self) -> str:
        """Name in results and files."""
        words = [self.stiffness, self.perturbation]
        words += [f"{self.duration_s:.10g}s", f"{self.snr_db:.10g}dB"]
        words += [self.viscosity] if self.viscosity not in ("constant", OWN) else []
        words = [self.system, *words] if self.system != "joint" else words
        return re.sub(r"[^\w.+=,() -]+", "_", "-".join(words))


def _check_parts(grid: object, field: attrs.Attribute[Any], values: tuple[Any, ...]) -> None:
    """Raise for an unknown part of a simulation, or an object that cannot take its place."""
    check_distinct(grid, field, values)
    known, kind, verb = KINDS[field.name]
    for value in values:
        if not verb:
            if value not in known:
                raise InputError(f"unknown {kind} {value!r}; expected one of {', '.join(known)}")
            continue
        part = resolve(value, known, kind)
        if isinstance(part, Participant):
            raise InputError(
                "system: a virtual participant has a protocol of its own; run an Experiment with "
                "virtual = its number"
            )
        if not callable(getattr(part, verb, None)):
            form = "that is called with times" if verb == "__call__" else f"with {verb}()"
            raise InputError(
                f"{field.name}: expected a name ({', '.join(known)}), module:Object, or an object "
                f"{form}; got {value!r}"
            )


def _check_numbers(grid: object, field: attrs.Attribute[Any], values: tuple[Any, ...]) -> None:
    """Raise for anything but numbers; no noise is an infinite signal-to-noise ratio."""
    check_distinct(grid, field, values)
    for value in values:
        if not is_number(value) and not (field.name == "snr_db" and value == math.inf):
            unit = "decibels, or inf for no noise" if field.name == "snr_db" else "seconds"
            raise InputError(f"{field.name}: expected numbers of {unit}; got {value!r}")


def _check_methods(grid: object, field: attrs.Attribute[Any], values: tuple[Any, ...]) -> None:
    check_distinct(grid, field, values)
    for value in values:
        to_method(value)


def _to_numbers(values: Any) -> Any:
    return tuple(map(to_float, to_tuple(values)))


def _to_tables(values: Any) -> tuple[Mapping[str, Any], ...]:
    """Return tables of further scenarios from tables, or from names of tables."""
    tables = []
    for number, value in enumerate(to_tuple(values)):
        table = find(value, "scenario") if isinstance(value, str) else value
        if isinstance(value, str) and not isinstance(table, Mapping):
            raise InputError(
                f"also: scenario {value!r} must be a mapping of settings, such as 'duration_s', "
                f"got {table!r}"
            )
        check_keys(table, (*GRID, "methods"), f"also.{number}")
        tables.append(table)
    return tuple(tables)


def _parts(*default: str) -> Any:
    return attrs.field(default=default, converter=to_tuple, validator=_check_parts)


def _numbers(*default: float) -> Any:
    return attrs.field(default=default, converter=_to_numbers, validator=_check_numbers)


@attrs.frozen(slots=False, kw_only=True)
class Study(Settings):
    """Scenarios x methods x trials, all methods on the same simulated data.

    Parameters
    ----------
    stiffness
        Stiffness profiles: ``"square"``, ``"sine"``, ``"constant"``, ``"module:Object"``, or
        callables of time.
    perturbation
        ``"noise"``, ``"prbs"``, ``"module:Object"``, or objects with ``generate``.
    duration_s, snr_db
        Seconds of data, each a whole number of realizations; signal-to-noise ratios in dB.
    viscosity
        ``"constant"`` (the system's own: 2.2 N·m·s/rad), ``"covarying"`` (1 to 3 N·m·s/rad with the
        stiffness).
    system
        What is simulated: names of :data:`tvsysid.simulate.SYSTEMS`, ``"module:Object"``, or
        objects with ``simulate``. An object with settings ``stiffness`` and ``viscosity`` gets
        those of the scenario.
    also
        Further scenarios: mappings of the settings above and of ``methods``, each a grid of its
        own. What is not given is as above. A name stands for such a mapping of an installed
        package; ``"module:name"`` for one of your own.
    rate, period
        Rate in Hz to which the data are decimated, and duration of a realization in s.
    subtract_mean
        Whether to subtract the mean over realizations from angle, torque and noiseless torque. A
        reflex gives the torque a mean.
    methods
        Keys of methods, with settings if need be (``"sds:window=0.2"``), ``"mymodule:MyMethod"``,
        or objects with ``identify``; by default the paper's five, and ``adaptive``.
    trials, seed
        Monte-Carlo repetitions, and the seed of the whole study. Each trial of each scenario has
        random numbers of its own, so that a further scenario, trial or method changes no other
        number. Scenarios that differ in viscosity alone share them, which pairs them.

    Raises
    ------
    InputError
        For an unknown name, or a value out of range.

    Examples
    --------
    >>> Study(perturbation="prbs", trials=5).scenarios[0]
    Scenario(stiffness='square', perturbation='prbs', duration_s=150.0, snr_db=10.0,
    viscosity='constant',
             system='joint')
    """

    stiffness: tuple[Any, ...] = _parts("square")
    perturbation: tuple[Any, ...] = _parts("noise", "prbs")
    duration_s: tuple[float, ...] = _numbers(150.0)
    snr_db: tuple[float, ...] = _numbers(10.0)
    viscosity: tuple[str, ...] = _parts("constant")
    system: tuple[Any, ...] = _parts("joint")
    also: tuple[Mapping[str, Any], ...] = attrs.field(default=(), converter=_to_tables)
    rate: float = attrs.field(default=RATE, converter=to_float, validator=positive)
    period: float = attrs.field(default=PERIOD, converter=to_float, validator=positive)
    subtract_mean: bool = attrs.field(default=False, validator=boolean)
    methods: tuple[Any, ...] = attrs.field(
        default=STUDIED_METHODS, converter=to_tuple, validator=_check_methods
    )
    trials: int = attrs.field(default=20, validator=at_least(1))
    seed: int = attrs.field(default=0, validator=at_least(0))

    def __attrs_post_init__(self) -> None:
        samples = self.period * self.rate
        if samples < 2 or abs(samples - round(samples)) > 1e-6:
            raise InputError(
                f"period: expected whole samples, {self.period:g} s at {self.rate:g} Hz are "
                f"{samples:g}; give another period or rate"
            )
        for value in self._every("duration_s"):
            count = value / self.period
            if count < 2 or abs(count - round(count)) > 1e-9:
                raise InputError(
                    f"duration_s: expected whole realizations of {self.period:g} s, two at least: "
                    f"multiples of {self.period:g} s; got {value!r}"
                )
        for name, (_, kind, _) in {"methods": ({}, "method", ""), **KINDS}.items():
            values = self._every(name)
            if len(set(map(label_of, values))) < len(set(map(repr, values))):
                raise InputError(
                    f"{name}: two {kind}s have the same name; as attrs classes or dataclasses "
                    "their settings tell them apart"
                )
        if twice := first_repeated([scenario.label for scenario in self.scenarios]):
            raise InputError(
                f"two scenarios are called {twice}; give their parts names that differ in letters "
                "or digits"
            )
        for scenario in self.scenarios:
            system = self.parts[f"system {scenario.system}"]
            if scenario.viscosity == "covarying" and isinstance(system, ScheduledJoint):
                raise InputError(
                    "viscosity: covarying follows the profile, which the stiffness of system "
                    f"{scenario.system} does not; give constant, or another system"
                )

    @cached_property
    def grids(self) -> tuple[Study, ...]:
        """Grid of the settings above, and one for each table of further scenarios."""
        plain = attrs.evolve(self, also=()) if self.also else self
        return (plain, *(attrs.evolve(plain, **table) for table in self.also))

    def _every(self, name: str) -> list[Any]:
        """Return the values of a setting in all grids."""
        return [value for grid in self.grids for value in getattr(grid, name)]

    @cached_property
    def named_methods(self) -> dict[str, Method]:
        """Method objects by the label that they have in results."""
        return {label_of(value): to_method(value) for value in self._every("methods")}

    @cached_property
    def parts(self) -> dict[str, Any]:
        """Systems, profiles and perturbations by setting and label (``"stiffness square"``)."""
        return {
            f"{name} {label_of(value)}": resolve(value, known, kind)
            for name, (known, kind, verb) in KINDS.items()
            for value in self._every(name)
            if verb
        }

    @property
    def scenarios(self) -> tuple[Scenario, ...]:
        """Every combination of the settings of each grid, once."""
        return tuple(self.methods_of)

    @cached_property
    def methods_of(self) -> dict[Scenario, frozenset[str]]:
        """Labels of the methods that identify each scenario, from every grid that has it."""
        methods_of: dict[Scenario, frozenset[str]] = {}
        for grid in self.grids:
            methods = frozenset(map(label_of, grid.methods))
            for combination in itertools.product(*(getattr(grid, name) for name in GRID)):
                scenario = self._without_unused(Scenario._make(labels_of(combination)))
                methods_of[scenario] = methods_of.get(scenario, frozenset()) | methods
        return methods_of

    def _without_unused(self, scenario: Scenario) -> Scenario:
        """Return the scenario without settings that its system does not have."""
        names = settings_of(self.parts[f"system {scenario.system}"]).keys()
        return scenario._replace(
            stiffness=scenario.stiffness if "stiffness" in names else OWN,
            viscosity=scenario.viscosity if {"stiffness", "viscosity"} <= names else OWN,
        )

    def simulated(self, scenario: Scenario) -> tuple[System, Perturbation]:
        """Return the system and perturbation of a scenario."""
        system, changes = self.parts[f"system {scenario.system}"], {}
        if scenario.stiffness != OWN:
            changes["stiffness"] = self.parts[f"stiffness {scenario.stiffness}"]
        if scenario.viscosity == "covarying":
            changes["viscosity"] = CovaryingViscosity(changes["stiffness"])
        perturbation = self.parts[f"perturbation {scenario.perturbation}"]
        return with_settings(system, **changes) if changes else system, perturbation

    def seed_of(self, scenario: Scenario, *trial: int) -> np.random.SeedSequence:
        """Return the seed of a scenario or of one trial; it depends on no other scenario."""
        parts = (*tuple(scenario)[:4], *([scenario.system] if scenario.system != "joint" else []))
        return np.random.SeedSequence(self.seed, spawn_key=(*spawn_key(repr(parts)), *trial))

    def to_json(self) -> str:
        """Return the settings as text, methods and parts by their labels."""
        settings: dict[str, Any] = {name: labels_of(getattr(self, name)) for name in GRID}
        if self.also:
            settings["also"] = [
                {name: labels_of(getattr(grid, name)) for name in table}
                for grid, table in zip(self.grids[1:], self.also, strict=True)
            ]
        settings["methods"] = labels_of(self.methods)
        settings |= {name: getattr(self, name) for name in ("rate", "period", "trials", "seed")}
        return json.dumps(settings | ({"subtract_mean": True} if self.subtract_mean else {}))


def preset_study(settings: Mapping[str, object], **changes: Any) -> Study:
    """Return a preset's study, with some settings replaced."""
    return from_table(Study, replace_settings(settings, changes))
