"""Experimental study: participants, reading, preparation and analyses."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import Method, label_of
from tvsysid.recordings import Reading
from tvsysid.study.settings import (
    Settings,
    first_repeated,
    from_table,
    spawn_key,
    table_converter,
    to_method,
    to_tuple,
)
from tvsysid.validators import at_least, not_negative, optional, positive, text

VIRTUAL = (1, 2, 3, 4, 5, 6)  # virtual participants of an experiment without files
PERTURBATIONS = ("noise", "prbs")  # their perturbations
MAX_LAG_S, SHORT_WINDOW_S, LONG_WINDOW_S = 15 / 128, 12 / 128, 30 / 128
"""Longest lag and windows of sds and esm in the paper: 15, 12 and 30 samples."""
MAX_NAME_LENGTH = 80  # characters of a participant or perturbation; files are called by it
# A spreadsheet takes what begins with = + - @ for a formula.
NAME = rf"[^/\\:.=+@-][^/\\:]{{0,{MAX_NAME_LENGTH - 1}}}"
BLOCK_REALIZATIONS, REALIZATIONS = (20, 40), (75, 150)  # in one block, and otherwise

PAPER = {
    "eirf": f"eirf:max_lag={MAX_LAG_S}",
    "sds": f"sds:max_lag={MAX_LAG_S},window={SHORT_WINDOW_S}",
    "birf": f"birf:max_lag={MAX_LAG_S}",
    "esm": f"esm:window={LONG_WINDOW_S}",
    "kbr": "kbr:preset=experiment",
}
"""The paper's methods with its settings for the experiment, by their keys."""


def _numbers(least: int) -> Any:
    """Return a field of whole numbers, or None."""
    each: Any = attrs.validators.deep_iterable(at_least(least))
    return attrs.field(default=None, converter=to_tuple, validator=attrs.validators.optional(each))


@attrs.frozen(kw_only=True)
class Preparing:
    """How a recording is prepared; see :func:`tvsysid.preprocess.prepare`."""

    reference: str | None = attrs.field(default="target", validator=optional(text))
    rate: float = attrs.field(default=128.0, validator=positive)
    ends: float = attrs.field(default=5.0, validator=not_negative)
    period: float = attrs.field(default=2.0)
    context: float = attrs.field(default=0.5, validator=not_negative)
    search: float = attrs.field(default=0.5, validator=positive)
    max_shift: float = attrs.field(default=0.25, validator=positive)
    task_limit: float | None = attrs.field(default=3.0, validator=optional(positive))
    cutoff: float = attrs.field(default=5.0, validator=positive)
    residual_limit: float | None = attrs.field(default=3.0, validator=optional(positive))

    @period.validator
    def _is_given(self, field: attrs.Attribute[Any], value: Any) -> None:
        if not value:
            raise InputError(
                "preparation: period must be given: an experiment draws realizations of a period; "
                "a record without one is identified by tvsysid identify --scheduling"
            )
        positive(self, field, value)


def _to_preparing(value: Any) -> Any:
    if isinstance(value, Mapping):  # TOML has no null
        value = {name: None if item is False else item for name, item in value.items()}
    return table_converter(Preparing, "preparation")(value)


def _to_reading(value: Any) -> Any:
    reading = table_converter(Reading, "reading")(value)
    if reading is not None:
        _ = reading.names  # raises if a setting is missing
    return reading


@attrs.frozen(kw_only=True)
class Applied:
    """A method, and how many realizations it gets."""

    method: str | Method
    name: str
    realizations: tuple[int, ...] | None = _numbers(2)
    contiguous: bool | None = None
    identifier: Method = attrs.field(init=False, eq=False)

    @identifier.default
    def _parsed(self) -> Method:
        return to_method(self.method)

    @classmethod
    def of(cls, value: Any) -> Applied:
        """Return a method in any notation with its settings."""
        if isinstance(value, Applied):
            return value
        given = dict(value) if isinstance(value, Mapping) else {}
        if "method" not in given:
            short = given.get("name", value)
            is_paper = isinstance(short, str) and short in PAPER
            given = {"name": short, "method": PAPER[short] if is_paper else short} | given
            given["name"] = label_of(short)
        return from_table(cls, {"name": label_of(given["method"])} | given, "methods")


def _to_applied(values: Any) -> tuple[Applied, ...]:
    return tuple(map(Applied.of, to_tuple(values)))


def _to_files(values: Any) -> Any:
    """Return file patterns by participant and perturbation."""
    if not isinstance(values, Mapping) or not all(isinstance(i, Mapping) for i in values.values()):
        raise InputError(
            "participants: expected files by participant and perturbation, as in {P1 = {noise = "
            f"'P1/noise*.mat'}}}}; got {values!r}"
        )
    return {
        participant: {name: to_tuple(files) for name, files in recorded.items()}
        for participant, recorded in values.items()
    }


def _check_participants(
    experiment: object, field: object, participants: Mapping[str, Mapping[str, Any]]
) -> None:
    for name in [*participants, *(name for recorded in participants.values() for name in recorded)]:
        if not name.isprintable() or not re.fullmatch(NAME, name):
            raise InputError(
                "participants: expected names that files and tables may have: up to "
                f"{MAX_NAME_LENGTH} characters, no slashes or colons, and none of . = + - @ first; "
                f"got the name {name[: MAX_NAME_LENGTH + 1]!r}"
            )
    for name, recorded in participants.items():
        if not recorded or not all(recorded.values()):
            raise InputError(
                f"participants: expected perturbations with files for each participant; {name} has "
                "none"
            )


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


@attrs.frozen(slots=False, kw_only=True)
class Experiment(Settings):
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
        ``false`` stands for None: ``reference = false`` where there was no target torque.
    perturbation
        Which of the perturbations are studied; None takes all there are.
    methods
        ``"eirf"``, ``"sds"``, ``"birf"``, ``"esm"`` and ``"kbr"`` by themselves take the paper's
        settings for its experiment. Others are keys with settings (``"sds:window=0.2"``),
        ``"mymodule:MyMethod"``, objects with ``identify``, or mappings with ``method`` and, if need
        be, a ``name``, ``realizations`` of its own, and ``contiguous`` for draws in one block (by
        default as the method's attribute ``contiguous`` says, which is true for kbr).
    realizations
        How many are drawn, of all methods; by default 75 and 150, and 20 and 40 in one block, as in
        the paper.
    bootstraps, seed
        Number of draws, and their seed. The draws depend on the seed, the recording and the number
        of realizations alone, so that all methods see the same ones.

    Raises
    ------
    InputError
        For an unknown name, or a value out of range.

    Examples
    --------
    >>> experiment = Experiment(virtual=[1, 2], methods=["sds", "kbr"])
    >>> [recorded.label for recorded in experiment.recordings]
    ['P1-noise', 'P1-prbs', 'P2-noise', 'P2-prbs']
    >>> [analysis.label for analysis in experiment.analyses]
    ['sds-75', 'sds-150', 'kbr-20', 'kbr-40']
    """

    participants: dict[str, dict[str, tuple[str, ...]]] = attrs.field(
        factory=dict, converter=_to_files, validator=_check_participants
    )
    virtual: tuple[int, ...] | None = _numbers(0)
    reading: Reading | None = attrs.field(default=None, converter=_to_reading)
    preparation: Preparing = attrs.field(factory=Preparing, converter=_to_preparing)
    perturbation: tuple[str, ...] | None = attrs.field(default=None, converter=to_tuple)
    methods: tuple[Applied, ...] = attrs.field(default=tuple(PAPER), converter=_to_applied)
    realizations: tuple[int, ...] | None = _numbers(2)
    bootstraps: int = attrs.field(default=100, validator=at_least(2))
    seed: int = attrs.field(default=0, validator=at_least(0))
    folder: Path = attrs.field(factory=Path, converter=Path)

    def __attrs_post_init__(self) -> None:
        if self.participants and self.reading is None:
            raise InputError(
                "reading: files need it: which channels are angle and torque, and the sampling "
                "rate, as in reading = {angle = 'pos', torque = 'tq', sampling_rate = 1000}"
            )
        if not self.analyses:
            raise InputError("methods: it is empty; give at least 1")
        if twice := first_repeated([analysis.label for analysis in self.analyses]):
            raise InputError(f"methods: {twice} is there twice; give each method a name of its own")
        there = dict.fromkeys(recorded.perturbation for recorded in self._every_recording)
        if unknown := [name for name in self.perturbation or () if name not in there]:
            raise InputError(
                f"perturbation: {unknown[0]} was not recorded; there are {', '.join(there)}"
            )
        if not self.recordings:
            raise InputError("virtual: 0 participants; give at least 1")
        virtual = {each.participant for each in self._every_recording if each.is_virtual}
        if both := sorted(virtual & set(self.participants)):
            raise InputError(
                f"participants: {both[0]} is a virtual one too; give the one with files another "
                "name"
            )
        if twice := first_repeated([recorded.label for recorded in self.recordings]):
            raise InputError(f"participants: {twice} is there twice; give each a name of its own")

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
        """Recordings that are studied, participant by participant."""
        chosen = self.perturbation
        return tuple(
            recorded
            for recorded in self._every_recording
            if chosen is None or recorded.perturbation in chosen
        )

    @cached_property
    def analyses(self) -> tuple[Analysis, ...]:
        """Analyses of each recording."""
        analyses = []
        for item in self.methods:
            own = item.identifier.contiguous
            contiguous = own if item.contiguous is None else item.contiguous
            usual = BLOCK_REALIZATIONS if contiguous else REALIZATIONS
            counts = item.realizations or self.realizations or usual
            analyses += [Analysis(item.name, item.method, count, contiguous) for count in counts]
        return tuple(analyses)

    @property
    def named_methods(self) -> dict[str, Method]:
        """Method objects by the name that they have in results."""
        return {item.name: item.identifier for item in self.methods}

    def seed_of(self, recorded: Recorded, realizations: int) -> int:
        """Return the seed of the draws from one recording; it depends on no other recording."""
        key = spawn_key(f"{recorded.label} {realizations}")
        return int(np.random.SeedSequence(self.seed, spawn_key=key).generate_state(1, np.uint64)[0])

    def to_json(self) -> str:
        """Return all settings as text, methods by their labels."""

        def is_setting(field: attrs.Attribute[Any], value: Any) -> bool:
            is_needed = field.name != "folder" or bool(self.participants)
            return field.init and is_needed

        def serialize(item: object, field: attrs.Attribute[Any], value: Any) -> Any:
            if isinstance(value, Path):
                return str(value.resolve())
            return label_of(value) if isinstance(value, Method) else value

        return json.dumps(attrs.asdict(self, filter=is_setting, value_serializer=serialize))
