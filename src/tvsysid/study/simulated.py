"""What a simulation study compares: scenarios, methods, trials."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from tvsysid.errors import InputError, describe_error
from tvsysid.methods import STUDIED_METHODS, Method, label_of, parse, resolve
from tvsysid.methods.registry import find
from tvsysid.models import IMPEDANCE
from tvsysid.signals import Array, Ensemble
from tvsysid.simulate import (
    PERTURBATIONS,
    PROFILES,
    SYSTEMS,
    CovaryingViscosity,
    Participant,
    Perturbation,
    ScheduledJoint,
    Simulation,
    System,
)
from tvsysid.study.settings import (
    AnyMethod,
    Listed,
    Settings,
    StudySettings,
    Whole,
    listed,
    spawn_key,
    unique,
)
from tvsysid.study.trial import Setting, true_values
from tvsysid.validators import settings_of, with_settings

VISCOSITIES = ("constant", "covarying")
"""The system's own (2.2 N·m·s/rad), or between 1 and 3 N·m·s/rad with the stiffness."""
PERIOD, RATE = 2.0, 100.0  # s of a realization, and Hz after decimation, as in the paper
OWN = "own"  # stiffness and viscosity of a system that cannot be given any
PROBED = 20  # realizations that are simulated to see what a system knows

GRID = ("stiffness", "perturbation", "duration_s", "snr_db", "viscosity", "system")
KINDS: dict[str, tuple[Mapping[str, object], str, str]] = {
    "stiffness": (PROFILES, "profile", "__call__"),
    "perturbation": (PERTURBATIONS, "perturbation", "generate"),
    "system": (SYSTEMS, "system", "simulate"),
    "viscosity": (dict.fromkeys(VISCOSITIES, ""), "viscosity", ""),
}
"""What each setting may name, what it is called, and the verb of an object in its place."""


def _scenarios(values: Any) -> Any:
    """Replace names of scenarios by their settings."""
    named = {name: find(name, "scenario") for name in listed(values) if isinstance(name, str)}
    for name, found in named.items():
        if not isinstance(found, Mapping):
            raise ValueError(
                f"scenario {name!r} must be a mapping of settings, such as 'duration_s', got "
                f"{found!r}"
            )
    return tuple(named[each] if isinstance(each, str) else each for each in listed(values))


Parts = Annotated[tuple[Any, ...], Listed, Field(min_length=1)]
Numbers = Annotated[tuple[float, ...], Listed, Field(min_length=1)]
Methods = Annotated[tuple[AnyMethod, ...], Listed, Field(min_length=1)]


def _said(expected: str, **limits: Any) -> Any:
    """Return a field with its expected value, for messages, and its limits."""
    return Field(description=expected, **limits)


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
        words = [
            self.stiffness,
            self.perturbation,
            f"{self.duration_s:.10g}s",
            f"{self.snr_db:.10g}dB",
        ]
        words += [self.viscosity] if self.viscosity not in ("constant", OWN) else []
        words = [self.system, *words] if self.system != "joint" else words
        return re.sub(r"[^\w.+=,() -]+", "_", "-".join(words))


class Known(NamedTuple):
    """What simulations tell before any is identified.

    ``quantities`` whose estimates are measured: stiffness, viscosity and inertia, what a
    simulation knows, and what a method says that it estimates (``quantities``). ``pathways`` of
    the systems, and those that a method says it tells apart (``pathway_names``); none unless
    they are several. ``truth`` of each scenario over one realization, shape (quantity, time),
    NaN where it is not known; ``changes`` says whether it differs from trial to trial, as where
    the joint is scheduled by a random signal.
    """

    quantities: tuple[str, ...]
    pathways: tuple[str, ...]
    truth: Mapping[Scenario, Array]
    changes: bool


class _Grid(Settings):
    @field_validator("methods", check_fields=False)
    @classmethod
    def _given_once(cls, values: tuple[object, ...] | None) -> tuple[object, ...] | None:
        return values and unique(values)

    @field_validator(*KINDS, check_fields=False)
    @classmethod
    def _found(cls, values: tuple[object, ...] | None, info: Any) -> tuple[object, ...] | None:
        known, what, verb = KINDS[info.field_name]
        for value in values or ():
            if not verb and value not in known:
                raise ValueError(f"unknown {what} {value!r}; expected one of {', '.join(known)}")
            if verb and isinstance(found := resolve(value, known, what), Participant):
                raise ValueError(
                    "a virtual participant has a protocol of its own; give an Experiment virtual "
                    "= its number"
                )
            if verb and not callable(getattr(found, verb, None)):
                raise ValueError(
                    f"expected a name ({', '.join(known)}), module:Object, or an object "
                    + ("that is called with times" if verb == "__call__" else f"with {verb}()")
                )
        return values and unique(values)

    @field_validator("duration_s", "snr_db", check_fields=False)
    @classmethod
    def _numbers(cls, values: tuple[float, ...] | None, info: Any) -> tuple[float, ...] | None:
        if info.field_name == "snr_db" and any(
            np.isnan(value) or value == -np.inf for value in values or ()
        ):
            raise ValueError("expected decibels, or inf for no noise")
        return values and unique(values)


class Further(_Grid):
    """Scenarios beside those of the study's own grid; what is not given is as there."""

    stiffness: Parts | None = None
    perturbation: Parts | None = None
    duration_s: Numbers | None = None
    snr_db: Numbers | None = None
    viscosity: Parts | None = None
    system: Parts | None = None
    methods: Methods | None = None


class Study(_Grid, StudySettings):
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
        objects with ``simulate``. A dataclass with fields ``stiffness`` and ``viscosity`` is given
        those of the scenario; any other has its own.
    also
        Further scenarios: mappings of the settings above and of ``methods``, each a grid of its
        own; what is not given is as above. Or names: of such a mapping that an installed package
        offers, or ``"module:name"``.
    rate, period
        Rate in Hz to which the data are decimated, and duration of a realization in s.
    subtract_mean
        Whether angle and torque lose their mean over realizations, as that which a reflex's torque
        has; the noiseless torque then loses it too.
    methods
        Keys of methods, with settings if need be (``"sds:window=0.2"``), ``"mymodule:MyMethod"``,
        or objects with ``identify``; by default the paper's five, and ``adaptive``.
    trials, seed
        Monte-Carlo repetitions, and the seed of the whole study. Each trial of each scenario has a
        stream of its own, so that adding a scenario, a trial or a method changes no other number.
        Scenarios that differ in viscosity only share it, which pairs them.

    Raises
    ------
    InputError
        For an unknown setting or name, or a value out of range.

    Examples
    --------
    >>> Study(perturbation="prbs", trials=5).scenarios[0]
    Scenario(stiffness='square', perturbation='prbs', duration_s=150.0, snr_db=10.0,
    viscosity='constant',
             system='joint')
    """

    noun: ClassVar[str] = "study"

    stiffness: Annotated[Parts, _said(f"names of profiles: {', '.join(PROFILES)}")] = ("square",)
    perturbation: Annotated[Parts, _said(f"names of perturbations: {', '.join(PERTURBATIONS)}")] = (
        "noise",
        "prbs",
    )
    duration_s: Annotated[Numbers, _said("numbers of seconds")] = (150.0,)
    snr_db: Annotated[Numbers, _said("numbers of decibels")] = (10.0,)
    viscosity: Annotated[Parts, _said(f"names: {', '.join(VISCOSITIES)}")] = ("constant",)
    system: Annotated[Parts, _said(f"names of systems: {', '.join(SYSTEMS)}")] = ("joint",)
    also: Annotated[
        tuple[Further, ...],
        BeforeValidator(_scenarios),
        _said("further scenarios: tables, or names"),
    ] = ()
    rate: Annotated[float, _said("a number of hertz", gt=0)] = RATE
    period: Annotated[float, _said("a number of seconds", gt=0)] = PERIOD
    subtract_mean: Annotated[bool, _said("true or false")] = False
    methods: Annotated[Methods, _said("keys of methods, such as 'sds:window=0.2'")] = (
        STUDIED_METHODS
    )
    trials: Annotated[Whole, _said("a whole number of one or more", ge=1)] = 20
    seed: Annotated[Whole, _said("a whole number of zero or more", ge=0)] = 0

    @model_validator(mode="after")
    def _named_apart(self) -> Study:
        for name, what in {
            "methods": "method",
            **{name: what for name, (_, what, _) in KINDS.items()},
        }.items():
            values = [
                value
                for settings in (self, *self.also)
                for value in getattr(settings, name, None) or ()
            ]
            if len(set(map(label_of, values))) < len(set(map(repr, values))):
                raise ValueError(
                    f"{name}: two {what}s have the same name; as dataclasses their settings tell "
                    "them apart"
                )
        labels = [scenario.label for scenario in self.scenarios]
        if twice := next((label for label in labels if labels.count(label) > 1), ""):
            raise ValueError(
                f"two scenarios are called {twice}; give their parts names that differ in letters "
                "or digits"
            )
        for scenario in self.scenarios:
            if scenario.viscosity == "covarying" and isinstance(
                self.parts[f"system {scenario.system}"], ScheduledJoint
            ):
                raise ValueError(
                    "viscosity: covarying follows the profile, which the stiffness of system "
                    f"{scenario.system} does "
                    "not; give constant, or another system"
                )
        return self

    @model_validator(mode="after")
    def _whole_realizations(self) -> Study:
        samples = self.period * self.rate
        if not 2 <= samples < math.inf or abs(samples - round(samples)) > 1e-6:
            raise ValueError(
                f"period: expected whole samples, {self.period:g} s at {self.rate:g} Hz are "
                f"{samples:g}; give another "
                "period or rate"
            )
        for value in itertools.chain(
            self.duration_s, *(further.duration_s or () for further in self.also)
        ):
            count = value / self.period
            if not 2 <= count < math.inf or abs(count - round(count)) > 1e-9:
                raise ValueError(
                    f"duration_s: expected whole realizations of {self.period:g} s, two at least: "
                    "multiples of "
                    f"{self.period:g} s; got {value!r}"
                )
        return self

    @cached_property
    def named_methods(self) -> dict[str, Method]:
        """Method objects by the label that they have in results."""
        every = [
            *self.methods,
            *(value for further in self.also for value in further.methods or ()),
        ]
        return {
            label_of(value): parse(value) if isinstance(value, str) else value for value in every
        }

    @cached_property
    def parts(self) -> dict[str, Any]:
        """Systems, profiles and perturbations by setting and label (``"stiffness square"``)."""
        return {
            f"{name} {label_of(value)}": resolve(value, known, what)
            for name, (known, what, verb) in KINDS.items()
            for settings in (self, *self.also)
            for value in getattr(settings, name) or ()
            if verb
        }

    @property
    def scenarios(self) -> tuple[Scenario, ...]:
        """Every combination of the settings of each grid, once."""
        return tuple(self.methods_of)

    @cached_property
    def methods_of(self) -> dict[Scenario, frozenset[str]]:
        """Labels of the methods that identify each scenario, from every grid that it belongs to."""
        found: dict[Scenario, frozenset[str]] = {}
        for settings in (self, *self.also):
            chosen = {
                name: getattr(settings, name) or getattr(self, name) for name in (*GRID, "methods")
            }
            methods = frozenset(map(label_of, chosen.pop("methods")))
            for values in itertools.product(*chosen.values()):
                scenario = self._as_taken(Scenario._make(_labels(values)))
                found[scenario] = found.get(scenario, frozenset()) | methods
        return found

    def _as_taken(self, scenario: Scenario) -> Scenario:
        """Return the scenario without settings that its system does not take."""
        system = self.parts[f"system {scenario.system}"]
        takes = settings_of(system).keys()
        return scenario._replace(
            stiffness=scenario.stiffness if "stiffness" in takes else OWN,
            viscosity=scenario.viscosity if {"stiffness", "viscosity"} <= takes else OWN,
        )

    def simulated(self, scenario: Scenario) -> tuple[System, Perturbation]:
        """Return the system and perturbation of a scenario."""
        system, changes = self.parts[f"system {scenario.system}"], {}
        if scenario.stiffness != OWN:
            changes["stiffness"] = self.parts[f"stiffness {scenario.stiffness}"]
        if scenario.viscosity == "covarying":
            changes["viscosity"] = CovaryingViscosity(changes["stiffness"])
        return with_settings(system, **changes) if changes else system, self.parts[
            f"perturbation {scenario.perturbation}"
        ]

    def setting_of(self, scenario: Scenario) -> Setting:
        """Return how a scenario is simulated and cut."""
        measured = self.known.quantities, self.known.pathways, self.scheduled
        return Setting(
            scenario.duration_s,
            scenario.snr_db,
            self.rate,
            self.period,
            *measured,
            self.subtract_mean,
        )

    @cached_property
    def known(self) -> Known:
        """Truth of the simulations, from a short and a long one of each system and profile.

        Where these know other things from realization to realization, the truth is that of a
        simulation as long as the scenario.
        """
        kinds: dict[Scenario, list[Scenario]] = {}
        for scenario in self.scenarios:
            kinds.setdefault(scenario._replace(duration_s=0.0, snr_db=0.0), []).append(scenario)
        probes = [
            [
                self._probed(alike[0], PROBED * self.period, 0),
                self._probed(alike[0], max(each.duration_s for each in alike), 1),
            ]
            for alike in kinds.values()
        ]
        first = [both[0][0] for both in probes]
        quantities = self.said(
            "quantities", *IMPEDANCE, *(name for each in first for name in each.truth)
        )
        pathways = self.said("pathway_names", *(name for each in first for name in each.pathways))
        truth, changes = {}, False
        for alike, both in zip(kinds.values(), probes, strict=True):
            usual = true_values(*both[0], quantities)
            steady = all(
                _is_always(dict(zip(quantities, usual, strict=True)), *each) for each in both
            )
            changes |= not steady
            for scenario in alike:
                own = () if steady else self._probed(scenario, scenario.duration_s, 0)
                truth[scenario] = true_values(*own, quantities) if own else usual
        return Known(quantities, pathways if len(pathways) > 1 else (), truth, changes)

    def _probed(
        self, scenario: Scenario, duration_s: float, seed: int
    ) -> tuple[Simulation, Ensemble]:
        setting = Setting(duration_s, 10.0, self.rate, self.period, (), ())
        try:
            simulation = setting.simulated(*self.simulated(scenario), np.random.SeedSequence(seed))
            return simulation, setting.cut(simulation.recording)
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"study: scenario {scenario.label} cannot be simulated: {describe_error(error)}"
            ) from error

    def seed_of(self, scenario: Scenario, trial: int) -> np.random.SeedSequence:
        """Return the seed of one trial of a scenario; it depends on no other scenario."""
        parts = (*tuple(scenario)[:4], *([scenario.system] if scenario.system != "joint" else []))
        return np.random.SeedSequence(self.seed, spawn_key=(*spawn_key(repr(parts)), trial))

    def to_json(self) -> str:
        """Return the settings as text, methods and parts by their labels.

        What tells one study from another.
        """
        settings: dict[str, object] = {name: _labels(getattr(self, name)) for name in GRID}
        if self.also:
            settings["also"] = [
                {name: _labels(value) for name, value in further if value is not None}
                for further in self.also
            ]
        others: dict[str, object] = {
            "rate": self.rate,
            "period": self.period,
            "trials": self.trials,
            "seed": self.seed,
        }
        others |= {"subtract_mean": True} if self.subtract_mean else {}
        return json.dumps(settings | {"methods": _labels(self.methods)} | others)


def _is_always(usual: Mapping[str, Array], simulation: Simulation, ensemble: Ensemble) -> bool:
    """Whether a simulation knows these values of every realization, rounding aside."""
    known = simulation.truth_of(ensemble)
    return all(
        np.allclose(known.get(name, np.nan), values, rtol=1e-6, equal_nan=True)
        for name, values in usual.items()
    )


def _labels(values: tuple[object, ...]) -> list[str | float]:
    return [value if isinstance(value, float) else label_of(value) for value in values]
