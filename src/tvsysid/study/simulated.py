"""What a study compares."""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator

from tvsysid.errors import InputError
from tvsysid.methods import METHODS, label_of, parse
from tvsysid.simulate import PERTURBATIONS, PROFILES, CovaryingViscosity, Profile
from tvsysid.study.settings import overridden, settings_in

VISCOSITIES = ("constant", "covarying")
"""2.2 N·m·s/rad, or between 1 and 3 N·m·s/rad with the stiffness."""
CONSTANT_VISCOSITY = 2.2

PERIOD = 2.0
"""Duration of a realization in s, as in the paper."""
RATE = 100.0
"""Sampling rate in Hz after decimation, as in the paper."""

GRID = ("stiffness", "perturbation", "duration_s", "snr_db", "viscosity")
EXPECTED = {
    "stiffness": f"names of profiles: {', '.join(PROFILES)}",
    "perturbation": f"names of perturbations: {', '.join(PERTURBATIONS)}",
    "duration_s": "numbers of seconds",
    "snr_db": "numbers of decibels",
    "viscosity": f"names: {', '.join(VISCOSITIES)}",
    "methods": "keys of methods, such as 'sds:window=0.2'",
    "trials": "a whole number of one or more",
    "seed": "a whole number of zero or more",
    "also": "tables of further scenarios",
}

Value = TypeVar("Value")


def _listed(value: Any) -> Any:
    return value if isinstance(value, (list, tuple)) else (value,)


Names = Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1)]
Numbers = Annotated[tuple[float, ...], BeforeValidator(_listed), Field(min_length=1)]


class Scenario(NamedTuple):
    """One kind of simulated experiment."""

    stiffness: str
    perturbation: str
    duration_s: float
    snr_db: float
    viscosity: str = "constant"

    @property
    def label(self) -> str:
        """Name in results and files."""
        words = [self.stiffness, self.perturbation, f"{self.duration_s:.10g}s", f"{self.snr_db:.10g}dB"]
        return "-".join(words if self.viscosity == "constant" else [*words, self.viscosity])

    @property
    def profile(self) -> Profile:
        """Stiffness over time."""
        return PROFILES[self.stiffness]

    @property
    def viscosity_profile(self) -> float | Profile:
        """Viscosity, or viscosity over time."""
        return CONSTANT_VISCOSITY if self.viscosity == "constant" else CovaryingViscosity(self.profile)


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    @field_validator("stiffness", "perturbation", "viscosity", check_fields=False)
    @classmethod
    def _known(cls, values: tuple[str, ...] | None, info: Any) -> tuple[str, ...] | None:
        known = {"stiffness": (*PROFILES,), "perturbation": (*PERTURBATIONS,), "viscosity": VISCOSITIES}[
            info.field_name
        ]
        for value in values or ():
            if value not in known:
                raise ValueError(f"unknown name {value!r}; expected one of {', '.join(known)}")
        return values and _unique(values)

    @field_validator("duration_s", check_fields=False)
    @classmethod
    def _whole_realizations(cls, values: tuple[float, ...] | None) -> tuple[float, ...] | None:
        for value in values or ():
            count = value / PERIOD
            if not count >= 2 or abs(count - round(count)) > 1e-9:
                raise ValueError(f"expected whole realizations of 2 s, two at least: multiples of {PERIOD:g} s")
        return values and _unique(values)

    @field_validator("snr_db", check_fields=False)
    @classmethod
    def _decibels(cls, values: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if any(np.isnan(value) or value == -np.inf for value in values or ()):
            raise ValueError("expected decibels, or inf for no noise")
        return values and _unique(values)


class Further(_Settings):
    """Scenarios beside those of the study's own grid; what is not given is as there."""

    stiffness: Names | None = None
    perturbation: Names | None = None
    duration_s: Numbers | None = None
    snr_db: Numbers | None = None
    viscosity: Names | None = None


class Study(_Settings):
    """Scenarios x methods x trials, all methods on the same simulated data.

    Parameters
    ----------
    stiffness
        Stiffness profiles: ``"square"``, ``"sine"``, ``"constant"``.
    perturbation
        ``"noise"``, ``"prbs"``.
    duration_s
        Seconds of data; each a whole number of 2-s realizations.
    snr_db
        Signal-to-noise ratios in dB.
    viscosity
        ``"constant"`` (2.2 N·m·s/rad), ``"covarying"`` (1 to 3 N·m·s/rad with the stiffness).
    also
        Further scenarios: mappings of the settings above, each a grid of its own; what is not given is as above.
    methods
        Keys of methods, with settings if need be (``"sds:window=0.2"``), ``"mymodule:MyMethod"``, or objects with
        ``identify``; by default the package's own five.
    trials
        Monte-Carlo repetitions.
    seed
        Of the whole study. Each trial of each scenario has a stream of its own, so that adding a scenario, a trial or a
        method changes no other number. Scenarios that differ in viscosity only share it, which pairs them.

    Raises
    ------
    InputError
        For an unknown setting or name, or a value out of range.

    Examples
    --------
    >>> Study(perturbation="prbs", trials=5).scenarios
    (Scenario(stiffness='square', perturbation='prbs', duration_s=150.0, snr_db=10.0, viscosity='constant'),)
    """

    stiffness: Names = ("square",)
    perturbation: Names = ("noise", "prbs")
    duration_s: Numbers = (150.0,)
    snr_db: Numbers = (10.0,)
    viscosity: Names = ("constant",)
    also: tuple[Further, ...] = ()
    methods: Annotated[tuple[Any, ...], BeforeValidator(_listed), Field(min_length=1)] = tuple(METHODS)
    trials: Annotated[int, Field(ge=1)] = 20
    seed: Annotated[int, Field(ge=0)] = 0

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            raise InputError(f"study: {_explained(error)}") from error

    @classmethod
    def from_toml(cls, path: str | Path, **settings: Any) -> Study:
        """Study from a TOML file whose keys are the settings.

        Parameters
        ----------
        path
            The file.
        **settings
            Take the place of the file's, in its further scenarios too.

        Raises
        ------
        InputError
            For a file that is missing or no TOML, or a wrong study; names the file and the key.
        """
        found = settings_in(path)
        try:
            return cls(**overridden(found, settings))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    @field_validator("trials", "seed", mode="before")
    @classmethod
    def _no_truth_value(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError("expected a whole number")
        return value

    @field_validator("methods")
    @classmethod
    def _can_identify(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        for value in values:
            if isinstance(value, str):
                parse(value)
            elif isinstance(value, type) or not callable(getattr(value, "identify", None)):
                raise ValueError("expected the key of a method, or an object with identify(ensemble)")
        if len(set(map(label_of, _unique(values)))) < len(values):
            raise ValueError("two methods have the same name; as dataclasses their settings tell them apart")
        return values

    @cached_property
    def named_methods(self) -> dict[str, Any]:
        """Method objects by the label that they have in results."""
        return {label_of(value): parse(value) if isinstance(value, str) else value for value in self.methods}

    @cached_property
    def scenarios(self) -> tuple[Scenario, ...]:
        """Every combination of the settings of each grid, once."""
        own = {name: getattr(self, name) for name in GRID}
        grids = [own]
        for further in self.also:
            given = {name: getattr(further, name) for name in GRID}
            grids.append({name: own[name] if value is None else value for name, value in given.items()})
        every = (Scenario(*values) for grid in grids for values in itertools.product(*grid.values()))
        return tuple(dict.fromkeys(every))

    def seed_of(self, scenario: Scenario, trial: int) -> np.random.SeedSequence:
        """Seed of one trial of one scenario, whatever else the study holds."""
        digest = hashlib.sha256(repr(tuple(scenario)[:4]).encode()).digest()
        key = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
        return np.random.SeedSequence(self.seed, spawn_key=(*key, trial))

    def to_json(self) -> str:
        """The settings as text, methods by their labels; what tells one study from another."""
        settings = {name: list(getattr(self, name)) for name in GRID}
        if self.also:
            settings["also"] = [
                {name: list(value) for name, value in further if value is not None} for further in self.also
            ]
        return json.dumps(settings | {"methods": list(self.named_methods), "trials": self.trials, "seed": self.seed})


def _explained(error: ValidationError) -> str:
    """First fault in plain words: the key, what came, what was expected."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    key = next((str(part) for part in reversed(first["loc"]) if isinstance(part, str)), "")
    if first["type"] == "extra_forbidden":
        known = tuple(EXPECTED) if len(first["loc"]) == 1 else GRID
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]}?" if close else ""
        return f"{where}: unknown key{hint} (settings of a study: {', '.join(known)})"
    message = str(first["msg"]).removeprefix("Value error, ")
    expected = f" (expected {EXPECTED[key]})" if key in EXPECTED and first["type"] != "value_error" else ""
    return f"{where}: {message}; got {first['input']!r}{expected}"


def _unique(values: tuple[Value, ...]) -> tuple[Value, ...]:
    if len(set(map(repr, values))) < len(values):
        raise ValueError("the same value is given twice")
    return values
