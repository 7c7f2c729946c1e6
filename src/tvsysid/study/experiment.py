"""Experimental study: participants, reading, preparation and analyses."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import Method, label_of
from tvsysid.preprocess import prepare_experiment
from tvsysid.preprocess.trials import nearest_rate
from tvsysid.recordings import Reading
from tvsysid.study.settings import (
    StudySettings,
    check_keys,
    from_table,
    spawn_key,
    to_method,
    to_tuple,
)
from tvsysid.validators import at_least

VIRTUAL = (1, 2, 3, 4, 5, 6)  # virtual participants of an experiment without files
PERTURBATIONS = ("noise", "prbs")  # their perturbations
BLOCK_REALIZATIONS, REALIZATIONS = (20, 40), (75, 150)  # of draws in one block, of others

PAPER = {
    "eirf": "eirf:max_lag=0.1171875",
    "sds": "sds:max_lag=0.1171875,window=0.09375",
    "birf": "birf:max_lag=0.1171875",
    "esm": "esm:window=0.234375",
    "kbr": "kbr:length_periodic=0.36787944117144233,length_decay=30,gamma=13.8",
}
"""The paper's methods with its settings for the experiment, by their keys: a longest lag of 15
samples, and windows of 12 and 30."""
PREPARATION = {
    name: setting.default
    for name, setting in inspect.signature(prepare_experiment).parameters.items()
    if name not in ("recording", "channels", "gaps")
}
"""How a recording is prepared by default."""


def _to_preparation(table: Any, experiment: Any) -> dict[str, Any]:
    """Return all settings of the preparation; false stands for None, which TOML has not."""
    check_keys(table, PREPARATION, "preparation")
    settings = dict(PREPARATION)
    if (reading := experiment.reading) is not None:
        if "period" not in table:
            raise InputError(
                "preparation.period: a setting is missing: give the duration of one cycle of the "
                "movement in s"
            )
        settings["reference"] = "target" if "target" in reading.channels else None
        settings["rate"] = nearest_rate(reading.sampling_rate, PREPARATION["rate"], table["period"])
    return settings | {name: None if value is False else value for name, value in table.items()}


def _to_reading(value: Any) -> Reading | None:
    reading = from_table(Reading, value, "reading") if isinstance(value, Mapping) else value
    if reading is not None:
        _ = reading.names  # raises if a setting is missing
    return reading


def _to_files(values: Any) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return file patterns by participant and perturbation."""
    try:
        return {
            participant: {name: to_tuple(given) for name, given in recorded.items()}
            for participant, recorded in values.items()
        }
    except AttributeError as error:
        raise InputError(
            "participants: expected files by participant and perturbation, as in {P1 = {noise = "
            f"'P1/noise*.mat'}}}}; got {values!r}"
        ) from error


class Recorded(NamedTuple):
    """One participant under one perturbation: files, or the number of a virtual participant."""

    participant: str
    perturbation: str
    source: tuple[str, ...] | int

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
        Settings of :func:`tvsysid.preprocess.prepare_experiment` that are not its defaults. For
        files, the default rate is near 128 Hz: it divides their rate, and a period is a whole
        number of samples. Realizations are aligned only if ``reference``, or a channel ``"target"``
        in ``reading``, names the target torque. In a TOML file, ``false`` stands for None.
    perturbation
        Which of the perturbations are studied; None takes all there are.
    methods
        ``"eirf"``, ``"sds"``, ``"birf"``, ``"esm"`` and ``"kbr"`` by themselves take the paper's
        settings for its experiment. Others are keys with settings (``"sds:window=0.2"``),
        ``"mymodule:MyMethod"``, or methods. A method whose attribute ``contiguous`` is true, such
        as kbr, gets draws in one block.
    realizations
        Numbers of realizations in a draw, for all methods. By default 75 and 150, and 20 and 40 for
        methods with draws in one block, as in the paper.
    max_realizations
        Maximum of ``realizations``, by default the fewest that a recording has. Larger numbers are
        left out. If all are larger, the maximum is used.
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
    preparation: dict[str, Any] = attrs.field(
        factory=dict,
        converter=attrs.Converter(_to_preparation, takes_self=True),  # type: ignore[misc]
    )
    perturbation: tuple[str, ...] | None = attrs.field(default=None, converter=to_tuple)
    methods: tuple[Any, ...] = attrs.field(default=tuple(PAPER), converter=to_tuple)
    realizations: tuple[int, ...] | None = attrs.field(default=None, converter=to_tuple)
    max_realizations: int | None = None
    bootstraps: int = attrs.field(default=100, validator=at_least(2))
    seed: int = attrs.field(default=0, validator=at_least(0))
    folder: str = attrs.field(default=".", converter=str)

    def __attrs_post_init__(self) -> None:
        if self.participants and self.reading is None:
            raise InputError(
                "reading: files need it: which channels are angle and torque, and the sampling "
                "rate, as in reading = {angle = 'angle', torque = 'torque', sampling_rate = 1000}"
            )
        if not (self.recordings and self.analyses):
            raise InputError(
                "participants: expected at least 1, with a perturbation that is studied, and at "
                "least 1 method"
            )

    @cached_property
    def recordings(self) -> tuple[Recorded, ...]:
        """Recordings that are studied, participant by participant."""
        virtual = () if self.participants else VIRTUAL
        sources: dict[str, dict[str, Any]] = self.participants | {
            f"P{number}": dict.fromkeys(PERTURBATIONS, number)
            for number in (virtual if self.virtual is None else self.virtual)
        }
        return tuple(
            Recorded(participant, perturbation, source)
            for participant, recorded in sources.items()
            for perturbation, source in recorded.items()
            if self.perturbation is None or perturbation in self.perturbation
        )

    @cached_property
    def analyses(self) -> tuple[Analysis, ...]:
        """Analyses of each recording."""
        analyses = {}
        for value in self.methods:
            label = label_of(value)
            method = to_method(PAPER.get(label, value))
            usual = BLOCK_REALIZATIONS if method.contiguous else REALIZATIONS
            counts = self.realizations or usual
            most = self.max_realizations or max(counts)
            for count in [each for each in counts if each <= most] or [most]:
                analysis = Analysis(label, method, count)
                analyses[analysis.label] = analysis
        return tuple(analyses.values())

    def seed_of(self, recorded: Recorded, realizations: int) -> int:
        """Return the seed of the draws from one recording; it depends on no other recording."""
        key = spawn_key(f"{recorded.label} {realizations}")
        return int(np.random.SeedSequence(self.seed, spawn_key=key).generate_state(1, np.uint64)[0])
