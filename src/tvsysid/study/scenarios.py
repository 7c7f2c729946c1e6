"""Simulation study: scenarios, methods, trials."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any, Literal, NamedTuple, Self

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import STUDIED_METHODS, Method, label_of, resolve
from tvsysid.simulate import (
    PERTURBATIONS,
    PROFILES,
    SYSTEMS,
    CovaryingViscosity,
    System,
)
from tvsysid.simulate.conditions import is_snr
from tvsysid.study.settings import StudySettings, check_keys, spawn_key, to_method, to_tuple
from tvsysid.validators import (
    at_least,
    boolean,
    one_of,
    positive,
    settings_of,
    to_float,
    with_settings,
)

Viscosity = Literal["constant", "covarying"]
"""Viscosity of the system (2.2 N·m·s/rad), or rising with stiffness from 1 to 3 N·m·s/rad."""
PERIOD, RATE = 2.0, 100.0  # s of a realization, and Hz after decimation, as in the paper
PARTS: dict[str, Callable[[Any], Any]] = {
    "stiffness": partial(resolve, known=PROFILES, kind="profile"),
    "perturbation": partial(resolve, known=PERTURBATIONS, kind="perturbation"),
    "system": partial(resolve, known=SYSTEMS, kind="system"),
    "methods": to_method,
}
"""By setting, the function that turns a text into an object."""


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
        if self.viscosity == "covarying":
            words.append(self.viscosity)
        if self.system != "joint":
            words.insert(0, self.system)
        return re.sub(r"[^\w.+=,() -]+", "_", "-".join(words))


def _values(*default: Any, validator: Any = None) -> Any:
    """Return a field of one value or several, numbers as floats."""
    each = validator and attrs.validators.deep_iterable(validator)
    return attrs.field(
        default=default,
        converter=lambda values: tuple(map(to_float, to_tuple(values))),
        validator=each,
    )


@attrs.frozen(slots=False, kw_only=True)
class Study(StudySettings):
    """Scenarios x methods x trials, all methods on the same simulated data.

    Parameters
    ----------
    stiffness
        Stiffness profiles: ``"square"``, ``"sine"``, ``"constant"``, ``"module:Object"``, or
        callables of time.
    perturbation
        ``"noise"``, ``"prbs"``, ``"module:Object"``, or objects with ``generate``.
    duration_s, snr_db
        Seconds of data, and signal-to-noise ratios in dB.
    viscosity
        ``"constant"`` (the system's own: 2.2 N·m·s/rad), ``"covarying"`` (1 to 3 N·m·s/rad with the
        stiffness).
    system
        What is simulated: names of :data:`tvsysid.simulate.SYSTEMS`, ``"module:Object"``, or
        objects with ``simulate``. An object with settings ``stiffness`` and ``viscosity`` gets
        those of the scenario.
    also
        Further scenarios: mappings of the settings above and of ``methods``, each a grid of its
        own. Settings that a mapping leaves out have their values above.
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

    stiffness: tuple[Any, ...] = _values("square")
    perturbation: tuple[Any, ...] = _values("noise", "prbs")
    duration_s: tuple[float, ...] = _values(150.0, validator=positive)
    snr_db: tuple[float, ...] = _values(10.0, validator=is_snr)
    viscosity: tuple[str, ...] = _values("constant", validator=one_of(Viscosity))
    system: tuple[Any, ...] = _values("joint")
    also: tuple[Mapping[str, Any], ...] = attrs.field(default=(), converter=to_tuple)
    rate: float = attrs.field(default=RATE, converter=to_float, validator=positive)
    period: float = attrs.field(default=PERIOD, converter=to_float, validator=positive)
    subtract_mean: bool = attrs.field(default=False, validator=boolean)
    methods: tuple[Any, ...] = _values(*STUDIED_METHODS)
    trials: int = attrs.field(default=20, validator=at_least(1))
    seed: int = attrs.field(default=0, validator=at_least(0))

    def __attrs_post_init__(self) -> None:
        _ = self.scenarios, self.parts  # raises for an unknown name

    def replaced(self, **settings: Any) -> Self:
        """Return the study with other values of some settings, in its further scenarios too."""
        also = [
            {name: value for name, value in table.items() if name not in settings}
            for table in self.also
        ]
        return attrs.evolve(self, **{"also": also} | settings)

    @cached_property
    def grids(self) -> tuple[Study, ...]:
        """Grid of the settings above, and one for each table of further scenarios."""
        for table in self.also:
            check_keys(table, (*Scenario._fields, "methods"), f"also: scenario {table!r}")
        plain = attrs.evolve(self, also=()) if self.also else self
        return (plain, *(attrs.evolve(plain, **table) for table in self.also))

    @cached_property
    def parts(self) -> dict[str, dict[str, Any]]:
        """Objects of all grids by setting and label, as in ``parts["stiffness"]["square"]``."""
        parts: dict[str, dict[str, Any]] = {}
        for grid, (name, resolved) in itertools.product(self.grids, PARTS.items()):
            for value in getattr(grid, name):
                part, label = resolved(value), label_of(value)
                if repr(parts.setdefault(name, {}).setdefault(label, part)) != repr(part):
                    raise InputError(
                        f"{name}: two objects have the same name, {label}; make them attrs classes "
                        "or dataclasses, so that the name holds their settings"
                    )
        return parts

    @property
    def scenarios(self) -> tuple[Scenario, ...]:
        """Every combination of the settings of each grid, once."""
        return tuple(self.methods_of)

    @cached_property
    def methods_of(self) -> dict[Scenario, dict[str, Method]]:
        """Methods that identify each scenario, by label, from every grid that has it."""
        methods_of: dict[Scenario, dict[str, Method]] = {}
        for grid in self.grids:
            methods = {label_of(each): to_method(each) for each in grid.methods}
            for values in itertools.product(*(getattr(grid, name) for name in Scenario._fields)):
                labels = [each if isinstance(each, float) else label_of(each) for each in values]
                scenario = Scenario._make(labels)
                methods_of.setdefault(scenario, {}).update(methods)
        return methods_of

    def system_of(self, scenario: Scenario) -> System:
        """Return the system of a scenario, with its stiffness and viscosity."""
        system: System = self.parts["system"][scenario.system]
        changes = {"stiffness": self.parts["stiffness"][scenario.stiffness]}
        if scenario.viscosity == "covarying":
            changes["viscosity"] = CovaryingViscosity(changes["stiffness"])
        names = changes.keys() & settings_of(system)
        return with_settings(system, **{name: changes[name] for name in names}) if names else system

    def seed_of(self, scenario: Scenario, *trial: int) -> np.random.SeedSequence:
        """Return the seed of a scenario or of one trial; it depends on no other scenario."""
        # Scenarios that differ in viscosity share their seed.
        parts = (*tuple(scenario)[:4], *([scenario.system] if scenario.system != "joint" else []))
        return np.random.SeedSequence(self.seed, spawn_key=(*spawn_key(repr(parts)), *trial))
