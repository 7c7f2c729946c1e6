"""Definition of an experimental study: participants, reading, preparation and analyses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import attrs
import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from tvsysid.methods import Method, label_of, parse
from tvsysid.methods.base import Input
from tvsysid.models import IMPEDANCE, Model
from tvsysid.recordings import Reading
from tvsysid.signals import Ensemble
from tvsysid.study.settings import AnyMethod, Listed, Settings, StudySettings, listed, spawn_key

VIRTUAL = (1, 2, 3, 4, 5, 6)  # virtual participants that are studied if nobody else is named
PERTURBATIONS = ("noise", "prbs")  # what they undergo
LAG, SHORT, LONG = 15 / 128, 12 / 128, 30 / 128
"""Longest lag and windows of sds and esm in the paper, in s: 15, 12 and 30 samples."""
LONGEST = 80  # characters of a name, of which files are called
FEW, MANY = (20, 40), (75, 150)  # realizations in a draw: in one piece, and otherwise

Counts = Annotated[tuple[Annotated[int, Field(ge=2)], ...], Listed, Field(min_length=1)]
Files = Annotated[tuple[str, ...], Listed, Field(min_length=1)]


def _reading(value: Any) -> Any:
    """Make a Reading of a table of settings."""
    if not isinstance(value, Mapping):
        return value
    names = [item.name for item in attrs.fields(Reading)]
    if unknown := [name for name in value if name not in names]:
        raise ValueError(f"unknown setting {unknown[0]!r}; the settings are {', '.join(names)}")
    reading = Reading(**value)
    _ = reading.names  # raises if a setting is missing
    return reading


class Preparing(Settings):
    """How a recording is prepared; see :func:`tvsysid.preprocess.prepare`."""

    reference: str | None = "target"
    rate: Annotated[float, Field(gt=0)] = 128.0
    ends: Annotated[float, Field(ge=0)] = 5.0
    period: Annotated[float, Field(gt=0)] = 2.0
    context: Annotated[float, Field(ge=0)] = 0.5
    search: Annotated[float, Field(gt=0)] = 0.5
    max_shift: Annotated[float, Field(gt=0)] = 0.25
    task_limit: Annotated[float, Field(gt=0)] | None = 3.0
    cutoff: Annotated[float, Field(gt=0)] = 5.0
    residual_limit: Annotated[float, Field(gt=0)] | None = 3.0

    @model_validator(mode="before")
    @classmethod
    def _words_for_none(cls, values: Any) -> Any:
        # TOML has no null.
        if isinstance(values, Mapping):
            if values.get("period", True) in (None, False):
                raise ValueError(
                    "period must be given: an experiment draws realizations of a period; a record "
                    "without one is "
                    "identified by tvsysid identify --scheduling"
                )
            optional = ("reference", "task_limit", "residual_limit")
            return {
                name: None if name in optional and value is False else value
                for name, value in values.items()
            }
        return values


class Applied(Settings):
    """A method, and how many realizations it is given."""

    method: AnyMethod
    name: str = ""
    realizations: Counts | None = None
    contiguous: bool | None = None


PAPER: dict[str, dict[str, Any]] = {
    "eirf": {"method": f"eirf:max_lag={LAG}"},
    "sds": {"method": f"sds:max_lag={LAG},window={SHORT}"},
    "birf": {"method": f"birf:max_lag={LAG}"},
    "esm": {"method": f"esm:window={LONG}"},
    "kbr": {"method": "kbr:preset=experiment"},
}
"""The paper's methods with its settings for the experiment, by the key that stands for them."""


class Recorded(NamedTuple):
    """One participant under one perturbation."""

    participant: str
    perturbation: str
    files: tuple[str, ...] = ()
    number: int = 0

    @property
    def label(self) -> str:
        """Name in results and files."""
        return f"{self.participant}-{self.perturbation}"

    @property
    def is_virtual(self) -> bool:
        """Whether it is simulated."""
        return not self.files


@attrs.frozen
class Analysis:
    """A method with a number of realizations."""

    name: str
    method: str | Method
    realizations: int
    contiguous: bool

    @property
    def label(self) -> str:
        """Name in results."""
        return f"{self.name}-{self.realizations}"


@attrs.frozen
class _ReadsChannels(Method):
    """Method that reads the channels of a stored experiment and is never fitted."""

    inputs: tuple[Input, ...] = ()  # type: ignore[misc]

    def fit(self, ensemble: Ensemble) -> Model:
        """Raise an error."""
        raise NotImplementedError


class Experiment(StudySettings):
    """Participants x perturbations x methods x numbers of realizations, each bootstrapped.

    Parameters
    ----------
    participants
        Files by participant and perturbation: ``{"P1": {"noise": "P1/noise*.mat", "prbs": ["a.mat",
        "b.mat"]}}``; one pattern or a list of files, each a trial or, with ``columns="trials"``, a
        matrix of trials. Any names will do for participants and perturbations.
    virtual
        Numbers of virtual participants; by default 1 to 6 if no files are given, else none.
    reading
        How the files are read: ``angle``, ``torque``, ``sampling_rate`` and the other settings of
        :func:`tvsysid.read_recording`. ``channels`` maps the names that methods use to those in the
        files (``channels={"emg": "EMG_SIGNAL"}``).
    preparation
        Settings of :func:`tvsysid.preprocess.prepare` that are not its defaults. In a TOML file,
        ``false`` stands for None: ``reference = false`` where there was no torque to follow.
    perturbation
        Which of the perturbations are studied; None takes all there are.
    methods
        ``"eirf"``, ``"sds"``, ``"birf"``, ``"esm"`` and ``"kbr"`` by themselves take the paper's
        settings for its experiment. Others are keys with settings (``"sds:window=0.2"``),
        ``"mymodule:MyMethod"``, objects with ``identify``, or mappings with ``method`` and, if need
        be, a ``name``, ``realizations`` of its own, and ``contiguous`` for draws in one piece (of
        itself true for kbr, and for a method whose attribute ``contiguous`` is).
    realizations
        How many are drawn, of all methods; by default 75 and 150, and 20 and 40 in one piece, as in
        the paper.
    bootstraps, seed
        Number of draws, and their seed. The draws depend on the seed, the recording and the number
        of realizations alone, so that all methods see the same ones.

    Raises
    ------
    InputError
        For an unknown setting or name, or a value out of range.

    Examples
    --------
    >>> experiment = Experiment(virtual=[1, 2], methods=["sds", "kbr"])
    >>> [recorded.label for recorded in experiment.recordings]
    ['P1-noise', 'P1-prbs', 'P2-noise', 'P2-prbs']
    >>> [analysis.label for analysis in experiment.analyses]
    ['sds-75', 'sds-150', 'kbr-20', 'kbr-40']
    """

    noun: ClassVar[str] = "experiment"

    participants: dict[str, dict[str, Files]] = Field(default_factory=dict)
    virtual: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Listed] | None = None
    reading: Annotated[Reading, BeforeValidator(_reading)] | None = None
    preparation: Preparing = Preparing()
    perturbation: Annotated[tuple[str, ...], Listed, Field(min_length=1)] | None = None
    methods: Annotated[tuple[Applied, ...], Field(min_length=1)] = tuple(
        Applied(**{"name": key} | each) for key, each in PAPER.items()
    )
    realizations: Counts | None = None
    bootstraps: Annotated[int, Field(ge=2)] = 100
    seed: Annotated[int, Field(ge=0)] = 0
    folder: Path = Path()

    @field_validator("participants")
    @classmethod
    def _names_for_files(
        cls, values: dict[str, dict[str, tuple[str, ...]]]
    ) -> dict[str, dict[str, tuple[str, ...]]]:
        for name in [*values, *(name for recorded in values.values() for name in recorded)]:
            # A spreadsheet takes what begins with = + - @ for a formula.
            if (
                not name.isprintable()
                or not 0 < len(name) <= LONGEST
                or set(name) & set("/\\:")
                or name[0] in ".=+-@"
            ):
                raise ValueError(
                    f"expected names that files and tables may have: up to {LONGEST} characters, "
                    "no slashes or colons, "
                    f"and none of . = + - @ first; got the name {name[: LONGEST + 1]!r}"
                )
        if empty := [name for name, recorded in values.items() if not recorded]:
            raise ValueError(
                f"expected perturbations with files for each participant; {empty[0]} has none"
            )
        return values

    @field_validator("methods", mode="before")
    @classmethod
    def _each_applied(cls, values: Any) -> Any:
        return tuple(_applied(value) for value in listed(values))

    @model_validator(mode="after")
    def _consistent(self) -> Experiment:
        if self.participants and self.reading is None:
            raise ValueError(
                "reading: files need it: which channels are angle and torque, and the sampling "
                "rate, as in "
                "reading = {angle = 'pos', torque = 'tq', sampling_rate = 1000}"
            )
        if twice := _twice([analysis.label for analysis in self.analyses]):
            raise ValueError(f"methods: {twice} is there twice; give each method a name of its own")
        there = list(dict.fromkeys(recorded.perturbation for recorded in self._every_recording))
        if unknown := [name for name in self.perturbation or () if name not in there]:
            raise ValueError(
                f"perturbation: {unknown[0]} was not recorded; there are {', '.join(there)}"
            )
        virtual = {
            recorded.participant for recorded in self._every_recording if recorded.is_virtual
        }
        if both := sorted(virtual & set(self.participants)):
            raise ValueError(
                f"participants: {both[0]} is a virtual one too; give the one with files another "
                "name"
            )
        if twice := _twice([recorded.label for recorded in self.recordings]):
            raise ValueError(f"participants: {twice} is there twice; give each a name of its own")
        return self

    @property
    def _every_recording(self) -> list[Recorded]:
        virtual = VIRTUAL if self.virtual is None and not self.participants else self.virtual or ()
        return [
            Recorded(name, perturbation, files)
            for name, recorded in self.participants.items()
            for perturbation, files in recorded.items()
        ] + [
            Recorded(f"P{number}", perturbation, (), number)
            for number in virtual
            for perturbation in PERTURBATIONS
        ]

    @cached_property
    def recordings(self) -> tuple[Recorded, ...]:
        """What is studied, participant by participant."""
        chosen = self.perturbation
        return tuple(
            recorded
            for recorded in self._every_recording
            if chosen is None or recorded.perturbation in chosen
        )

    @cached_property
    def analyses(self) -> tuple[Analysis, ...]:
        """What is done with each recording."""
        found = []
        for item in self.methods:
            own = self.named_methods[item.name].contiguous
            contiguous = own if item.contiguous is None else item.contiguous
            counts = item.realizations or self.realizations or (FEW if contiguous else MANY)
            found += [Analysis(item.name, item.method, count, contiguous) for count in counts]
        return tuple(found)

    @cached_property
    def named_methods(self) -> dict[str, Method]:
        """Method objects by the name that they have in results."""
        return {
            item.name: parse(item.method) if isinstance(item.method, str) else item.method
            for item in self.methods
        }

    @property
    def quantities(self) -> tuple[str, ...]:
        """Whose estimates are measured.

        Stiffness, viscosity and inertia; of virtual participants, the gain of their reflex,
        which is known; and what a method says that it estimates (``quantities``).
        """
        virtual = any(recorded.is_virtual for recorded in self.recordings)
        return self.said("quantities", *IMPEDANCE, *(["reflex_gain"] if virtual else []))

    @property
    def pathways(self) -> tuple[str, ...]:
        """Return the pathways whose torques are measured, if methods state several."""
        names = self.said("pathway_names")
        return names if len(names) > 1 else ()

    def seed_of(self, recorded: Recorded, realizations: int) -> int:
        """Return the seed of the draws from one recording; it depends on no other recording."""
        key = spawn_key(f"{recorded.label} {realizations}")
        return int(np.random.SeedSequence(self.seed, spawn_key=key).generate_state(1, np.uint64)[0])

    @property
    def identity(self) -> dict[str, object]:
        """What is done with each recording.

        With the recordings themselves, it tells one experiment from another.
        """
        methods = []
        for item in self.methods:
            own = [each for each in self.analyses if each.name == item.name]
            counts, contiguous = (
                [each.realizations for each in own],
                any(each.contiguous for each in own),
            )
            labels = {"name": item.name, "method": label_of(item.method)}
            methods.append(labels | {"realizations": counts, "contiguous": contiguous})
        return {"methods": methods, "bootstraps": self.bootstraps, "seed": self.seed}

    def to_json(self) -> str:
        """Return all settings as text."""
        settings = self.identity
        virtual = dict.fromkeys(
            recorded.number for recorded in self.recordings if recorded.is_virtual
        )
        if virtual:
            settings["virtual"] = list(virtual)
        participants: dict[str, dict[str, list[str]]] = {}
        for recorded in self.recordings:
            if not recorded.is_virtual:
                participants.setdefault(recorded.participant, {})[recorded.perturbation] = list(
                    recorded.files
                )
        if participants:
            settings |= {"participants": participants, "folder": str(self.folder.resolve())}
        if self.reading is not None:
            settings["reading"] = attrs.asdict(self.reading)
        prepared = self.preparation.model_dump()
        settings["preparation"] = {
            name: False if value is None else value for name, value in prepared.items()
        }
        settings["perturbation"] = list(
            dict.fromkeys(recorded.perturbation for recorded in self.recordings)
        )
        inputs = dict.fromkeys(
            item for method in self.named_methods.values() for item in method.inputs
        )
        return json.dumps(
            settings | ({"inputs": [attrs.asdict(item) for item in inputs]} if inputs else {})
        )

    @classmethod
    def without_methods(cls, text: str) -> Experiment:
        """Return the experiment of :meth:`to_json`; methods of others are not loaded."""
        settings = json.loads(text)
        inputs = tuple(Input(**item) for item in settings.pop("inputs", ()))
        return cls(**settings | {"methods": _ReadsChannels(inputs)})


def _applied(value: Any) -> Any:
    """Return a method in any notation as a mapping of its settings."""
    if isinstance(value, Applied):
        return value
    given = dict(value) if isinstance(value, Mapping) else {}
    short = given.get("name") if isinstance(value, Mapping) and "method" not in given else value
    if isinstance(short, str) and short in PAPER:
        return {"name": short} | PAPER[short] | given
    method = given.get("method", value)
    return {"method": method, "name": label_of(method)} | given


def _twice(labels: list[str]) -> str:
    """Return the first label that occurs twice, or nothing."""
    return next((label for number, label in enumerate(labels) if label in labels[:number]), "")
