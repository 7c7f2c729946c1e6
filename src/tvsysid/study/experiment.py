"""Experimental study: participants, reading, preparation and analyses."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Mapping
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import Method, label_of
from tvsysid.preprocess import prepare
from tvsysid.recordings import Reading
from tvsysid.study.settings import (
    Settings,
    check_keys,
    from_table,
    spawn_key,
    to_method,
    to_tuple,
)
from tvsysid.validators import at_least

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
PREPARATION = {
    name: setting.default
    for name, setting in inspect.signature(prepare).parameters.items()
    if name not in ("recording", "channels")
}
"""How a recording is prepared by default."""


def _to_preparation(table: Any) -> dict[str, Any]:
    """Return all settings of the preparation; false stands for None, which TOML has not."""
    check_keys(table, PREPARATION, "preparation")
    given = {name: None if value is False else value for name, value in table.items()}
    return PREPARATION | given


def _to_reading(value: Any) -> Reading | None:
    reading = from_table(Reading, value, "reading") if isinstance(value, Mapping) else value
    if reading is not None:
        _ = reading.names  # raises if a setting is missing
    return reading


def _to_table(value: Any) -> dict[str, Any]:
    """Return a method in any notation as a table with its name and what it stands for."""
    table = dict(value) if isinstance(value, Mapping) else {"name": value}
    check_keys(table, ("name", "method", "realizations"), "methods")
    name = table.get("name", table.get("method"))
    standard = PAPER.get(name, name) if isinstance(name, str) else name
    return {"method": standard, **table, "name": label_of(name)}


def _to_tables(values: Any) -> tuple[dict[str, Any], ...]:
    return tuple(map(_to_table, to_tuple(values)))


def _to_files(values: Any) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return file patterns by participant and perturbation."""
    try:
        files = {
            participant: {name: to_tuple(given) for name, given in recorded.items()}
            for participant, recorded in values.items()
        }
        names = [*files, *chain(*files.values())]
        is_named = all(re.fullmatch(NAME, name) and name.isprintable() for name in names)
        if is_named and all(all(recorded.values()) and recorded for recorded in files.values()):
            return files
    except (AttributeError, TypeError):
        pass
    raise InputError(
        "participants: expected files by participant and perturbation, as in {P1 = {noise = "
        f"'P1/noise*.mat'}}}}, with names that files and tables may have: up to {MAX_NAME_LENGTH} "
        f"characters, no slashes or colons, and none of . = + - @ first; got {values!r}"
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


@attrs.frozen
class Analysis:
    """A method with a number of realizations."""

    name: str
    method: Method
    realizations: int = attrs.field(validator=at_least(2))

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
        be, a ``name``, and ``realizations`` of its own. A method whose attribute ``contiguous`` is
        true, such as kbr, gets draws in one block.
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
        factory=dict, converter=_to_files
    )
    virtual: tuple[int, ...] | None = attrs.field(default=None, converter=to_tuple)
    reading: Reading | None = attrs.field(default=None, converter=_to_reading)
    preparation: dict[str, Any] = attrs.field(factory=dict, converter=_to_preparation)
    perturbation: tuple[str, ...] | None = attrs.field(default=None, converter=to_tuple)
    methods: tuple[dict[str, Any], ...] = attrs.field(default=tuple(PAPER), converter=_to_tables)
    realizations: tuple[int, ...] | None = attrs.field(default=None, converter=to_tuple)
    bootstraps: int = attrs.field(default=100, validator=at_least(2))
    seed: int = attrs.field(default=0, validator=at_least(0))
    folder: Path = attrs.field(factory=Path, converter=Path)

    def __attrs_post_init__(self) -> None:
        if self.participants and self.reading is None:
            raise InputError(
                "reading: files need it: which channels are angle and torque, and the sampling "
                "rate, as in reading = {angle = 'pos', torque = 'tq', sampling_rate = 1000}"
            )
        if not self.preparation["period"]:
            raise InputError(
                "preparation: period must be given: an experiment draws realizations of a period; "
                "a record without one is identified by tvsysid identify --scheduling"
            )
        for name, items in (("methods", self.analyses), ("participants", self.recordings)):
            labels = [item.label for item in items]
            if not labels or len(set(labels)) < len(labels):
                raise InputError(
                    f"{name}: expected at least 1, each with a name of its own; got "
                    f"{', '.join(labels) or 'none'}"
                )
        there = {recorded.perturbation for recorded in self.recordings}
        if missing := set(self.perturbation or ()) - there:
            raise InputError(f"perturbation: {', '.join(missing)} was not recorded")

    @cached_property
    def recordings(self) -> tuple[Recorded, ...]:
        """Recordings that are studied, participant by participant."""
        virtual = VIRTUAL if self.virtual is None and not self.participants else self.virtual or ()
        for number in virtual:
            at_least(0).check("Experiment", "virtual", number)
        every = [
            Recorded(name, perturbation, files)
            for name, recorded in self.participants.items()
            for perturbation, files in recorded.items()
        ]
        every += [
            Recorded(f"P{number}", perturbation, number=number)
            for number in virtual
            for perturbation in PERTURBATIONS
        ]
        chosen = self.perturbation
        return tuple(each for each in every if chosen is None or each.perturbation in chosen)

    @cached_property
    def analyses(self) -> tuple[Analysis, ...]:
        """Analyses of each recording."""
        analyses = []
        for table in self.methods:
            method = to_method(table["method"])
            usual = BLOCK_REALIZATIONS if method.contiguous else REALIZATIONS
            counts = to_tuple(table.get("realizations")) or self.realizations or usual
            analyses += [Analysis(table["name"], method, count) for count in counts]
        return tuple(analyses)

    @property
    def named_methods(self) -> dict[str, Method]:
        """Method objects by the name that they have in results."""
        return {each.name: each.method for each in self.analyses}

    def seed_of(self, recorded: Recorded, realizations: int) -> int:
        """Return the seed of the draws from one recording; it depends on no other recording."""
        key = spawn_key(f"{recorded.label} {realizations}")
        return int(np.random.SeedSequence(self.seed, spawn_key=key).generate_state(1, np.uint64)[0])

    def to_json(self) -> str:
        """Return all settings as text, methods by their labels."""
        settings = attrs.asdict(self, recurse=False)
        settings["reading"] = self.reading and attrs.asdict(self.reading)
        settings["folder"] = str(self.folder.resolve())
        if not self.participants:
            del settings["folder"]
        return json.dumps(settings, default=label_of)
