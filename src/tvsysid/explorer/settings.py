"""Settings of the explorer: as its form states them, and as a command or Python code."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from tvsysid.errors import InputError
from tvsysid.methods import parse
from tvsysid.recordings.reading import OPTION_NAMES, Reading, Segmentation
from tvsysid.signals import Recording
from tvsysid.validators import settings_of

REQUIRED = {
    "angle": "choose the channel with the angle",
    "torque": "choose the channel with the torque",
    "sampling_rate": "enter the sampling rate of the recording (Hz)",
    "period": "enter the duration of one repetition (s); any, if the joint is held still",
}
TEXTS = ("angle", "torque", "angle_unit", "torque_unit", "columns")
PYTHON = """import tvsysid as tv

prepared = tv.prepare(
    {source},
    {settings},
)
found = tv.compare(prepared, {methods!r})"""


@attrs.frozen
class Settings:
    """A recording or a file, how it is read and cut, and the method with its settings as text."""

    source: Path | Recording
    reading: Reading = attrs.field(factory=Reading)
    cutting: Segmentation = attrs.field(factory=Segmentation)
    align_channels: bool = True
    method: str = "adaptive"

    @property
    def methods(self) -> list[str]:
        """The methods to run; without any, ``adaptive`` and those that check it."""
        return [] if self.method == "adaptive" else [self.method]

    @property
    def preparation(self) -> dict[str, Any]:
        """Settings of :func:`tvsysid.prepare`, by name."""
        reading = attrs.asdict(self.reading) if isinstance(self.source, Path) else {}
        return reading | attrs.asdict(self.cutting) | {"align_channels": self.align_channels}

    @property
    def command(self) -> str:
        """The command of the same analysis; empty for a recording without a file."""
        if isinstance(self.source, Recording):
            return ""
        words = ["tvsysid", "identify", str(self.source)]
        for options in (self.reading, self.cutting):
            for name, usual in attrs.asdict(type(options)()).items():
                value = getattr(options, name)
                if value == usual:
                    continue
                texts = [str(value).removesuffix(".0")]
                if isinstance(value, Mapping):
                    texts = [f"{own}={value[own]}" for own in value]
                option = "--" + OPTION_NAMES.get(name, name).replace("_", "-")
                for text in texts:
                    words += [option, text]
        if not self.align_channels:
            words += ["--no-align-channels"]
        for method in self.methods:
            words += ["--method", method]
        return shlex.join(words)

    @property
    def python(self) -> str:
        """Python code of the same analysis."""
        return PYTHON.format(
            source=repr(str(self.source)) if isinstance(self.source, Path) else "recording",
            settings=",\n    ".join(f"{name}={each!r}" for name, each in self.preparation.items()),
            methods=self.methods,
        )


def settings_from(form: Mapping[str, str], start: Settings) -> Settings:
    """Return the settings that the form of the page states.

    Parameters
    ----------
    form
        Texts by name: fields of :class:`Reading` and :class:`Segmentation`, ``reversed`` and
        ``align_channels`` if they are checked, the key of the ``method``, and its settings, as
        ``sds.window``.
    start
        Settings of the page when it opens: the source, and what the form does not state.

    Raises
    ------
    InputError
        For what is missing or not valid.
    """
    for name, text in REQUIRED.items():
        if form.get(name) == "":
            raise InputError(text)
    numbers: dict[str, Any] = {
        name: float(form[name]) if form.get(name) else None
        for name in ("sampling_rate", "period", "decimate", "context")
    }
    reading, rate = start.reading, numbers.pop("sampling_rate")
    if isinstance(start.source, Path):
        words: dict[str, Any] = {name: form[name] for name in TEXTS}
        words |= {"sampling_rate": rate, "torque_sign": -1 if "reversed" in form else 1}
        reading = attrs.evolve(reading, **words)
    key = form["method"]
    own = {name: text for name, text in form.items() if name.startswith(f"{key}.")}
    return Settings(
        start.source,
        reading,
        Segmentation(**numbers),
        "align_channels" in form,
        method_text(key, {name.removeprefix(f"{key}."): text for name, text in own.items()}),
    )


def method_settings(key: str) -> dict[str, str]:
    """Return the settings of a method and their defaults as text."""
    method = parse(key)
    shown = {
        name: f"{value:.4g}" if isinstance(value, float) else str(value)
        for name, value in settings_of(method).items()
    }
    return shown | ({"tuned": "false"} if method.can_be_tuned else {})


def method_text(key: str, given: Mapping[str, str]) -> str:
    """Return a method as typed: its key and settings."""
    words = [f"{name}={text.strip()}" for name, text in given.items() if text.strip()]
    return ":".join(filter(None, (key, ",".join(words))))
