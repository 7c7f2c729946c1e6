"""What a study compares."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from tvsysid.errors import InputError
from tvsysid.methods import METHODS, parse
from tvsysid.simulate import PRBS, Constant, FilteredNoise, SineWave, SquareWave
from tvsysid.simulate.joint import Perturbation, Profile

PROFILES: dict[str, Profile] = {"square": SquareWave(), "sine": SineWave(), "constant": Constant()}
PERTURBATIONS: dict[str, Perturbation] = {"noise": FilteredNoise(), "prbs": PRBS()}
Value = TypeVar("Value")

PERIOD = 2.0
"""Duration of a realization in s, as in the paper."""
RATE = 100.0
"""Sampling rate in Hz after decimation, as in the paper."""


class Scenario(NamedTuple):
    """One kind of simulated experiment."""

    stiffness: str
    perturbation: str
    duration_s: float
    snr_db: float


class Study(BaseModel):
    """Scenarios x durations x methods x trials, all on the same simulated data.

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
    methods
        Keys of methods, with settings if need be (``"sds:window=0.2"``), ``"module:Class"``, or objects with
        ``identify``; by default the package's own five.
    trials
        Monte-Carlo repetitions.
    seed
        Of the whole study. Each trial of each scenario has a stream of its own, so that adding a scenario, a trial or a
        method changes no other number.

    Raises
    ------
    InputError
        For an unknown name or a value out of range.

    Examples
    --------
    >>> Study(perturbation=["prbs"], trials=5).trials
    5
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    stiffness: Annotated[tuple[str, ...], Field(min_length=1)] = ("square",)
    perturbation: Annotated[tuple[str, ...], Field(min_length=1)] = ("noise", "prbs")
    duration_s: Annotated[tuple[float, ...], Field(min_length=1)] = (150.0,)
    snr_db: Annotated[tuple[float, ...], Field(min_length=1)] = (10.0,)
    methods: Annotated[tuple[Any, ...], Field(min_length=1)] = tuple(METHODS)
    trials: Annotated[int, Field(ge=1)] = 20
    seed: Annotated[int, Field(ge=0)] = 0

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            known = ", ".join(type(self).model_fields)
            message = str(first["msg"]).removeprefix("Value error, ")
            hint = f" (settings of a study: {known})" if first["type"] == "extra_forbidden" else ""
            raise InputError(f"study: {where}: {message}; got {first['input']!r}{hint}") from error

    @field_validator("stiffness")
    @classmethod
    def _known_profile(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        return _known(values, PROFILES)

    @field_validator("perturbation")
    @classmethod
    def _known_perturbation(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        return _known(values, PERTURBATIONS)

    @field_validator("duration_s")
    @classmethod
    def _whole_realizations(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        for value in values:
            count = value / PERIOD
            if not count >= 2 or abs(count - round(count)) > 1e-9:
                raise ValueError(f"expected at least two whole realizations of {PERIOD:g} s")
        return _unique(values)

    @field_validator("snr_db")
    @classmethod
    def _number(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(np.isnan(value) or value == -np.inf for value in values):
            raise ValueError("expected decibels, or inf for no noise")
        return _unique(values)

    @field_validator("methods")
    @classmethod
    def _can_identify(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        for value in values:
            if isinstance(value, str):
                parse(value)
            elif not callable(getattr(value, "identify", None)):
                raise ValueError("expected the key of a method, or an object with identify(ensemble)")
        return _unique(values)

    @property
    def named_methods(self) -> dict[str, Any]:
        """Method objects by the label that they have in results."""
        return {
            value if isinstance(value, str) else repr(value): parse(value) if isinstance(value, str) else value
            for value in self.methods
        }

    @property
    def scenarios(self) -> Iterator[Scenario]:
        """Every combination of profile, perturbation, duration and noise."""
        for stiffness in self.stiffness:
            for perturbation in self.perturbation:
                for duration in self.duration_s:
                    for snr in self.snr_db:
                        yield Scenario(stiffness, perturbation, duration, snr)

    def seed_of(self, scenario: Scenario, trial: int) -> np.random.SeedSequence:
        """Seed of one trial of one scenario, whatever else the study holds."""
        digest = hashlib.sha256(repr(tuple(scenario)).encode()).digest()
        key = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
        return np.random.SeedSequence(self.seed, spawn_key=(*key, trial))


def _known(values: tuple[str, ...], known: dict[str, Any]) -> tuple[str, ...]:
    for value in values:
        if value not in known:
            raise ValueError(f"unknown name {value!r}; expected one of {', '.join(known)}")
    return _unique(values)


def _unique(values: tuple[Value, ...]) -> tuple[Value, ...]:
    if len(set(map(repr, values))) < len(values):
        raise ValueError("the same value is given twice")
    return values
