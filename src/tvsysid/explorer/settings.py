"""What the explorer's controls say, and the command line and the Python that do the same."""

from __future__ import annotations

import math
import numbers
import shlex
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, get_args

import attrs

from tvsysid.errors import InputError
from tvsysid.methods import key_of, parse
from tvsysid.methods.settings import split_settings
from tvsysid.recordings.reading import (
    OPTION_NAMES,
    AngleUnit,
    Columns,
    Reading,
    Segmentation,
    TorqueSign,
    TorqueUnit,
    named_channels,
)
from tvsysid.signals import Recording
from tvsysid.validators import settings_of

CHOICES: dict[str, tuple[Any, ...]] = {
    "angle_unit": get_args(AngleUnit),
    "torque_unit": get_args(TorqueUnit),
    "columns": get_args(Columns),
    "torque_sign": get_args(TorqueSign),
}


@attrs.frozen
class SourceFile:
    """A file, and how it is read."""

    file: Path
    reading: Reading


@attrs.frozen
class Cutting(Segmentation):
    """How a recording is cut into realizations, and whether a delay of the torque is corrected."""

    align_channels: bool = True


Source = Mapping[str, Any] | Recording  # what of a reading has no control, or a recording


@attrs.frozen
class Settings:
    """A recording, or how it is read from a file; how it is cut; and the method, as typed."""

    source: SourceFile | Recording
    cutting: Cutting
    method: str = "adaptive"


def command(settings: Settings) -> str:
    """Return the command of the same analysis; empty for a recording without a file."""
    if isinstance(settings.source, Recording):
        return ""
    words = ["tvsysid", "identify", str(settings.source.file)]
    for name, value in (
        _changed(settings.source.reading) | _changed(settings.cutting) | {"method": settings.method}
    ).items():
        option = f"--{OPTION_NAMES.get(name, name).replace('_', '-')}"
        if isinstance(value, bool):
            words.append(option if value else option.replace("--", "--no-"))
        elif isinstance(value, Mapping):
            for own, in_file in value.items():
                words += (option, f"{own}={in_file}")
        else:
            words += (option, _text(value))
    return shlex.join(words)


def python(
    settings: Settings, delay: float = 0.0, mains: float = 0.0, deviating: tuple[str, ...] = ()
) -> str:
    """Return Python code of the same analysis, with ``delay`` (s) and ``mains`` (Hz) removed.

    ``deviating`` channels lose their mean.
    """
    lines = ["import tvsysid as tv", ""]
    if isinstance(settings.source, SourceFile):
        words = [repr(str(settings.source.file))]
        words += (
            f"{name}={_text(value) if name == 'sampling_rate' else repr(value)}"
            for name, value in _changed(settings.source.reading).items()
        )
        lines.append(f"recording = tv.read_recording({', '.join(words)})")
    lines.append("gaps = tv.preprocess.find_gaps(recording)")
    if mains:
        lines.append(f"recording = tv.preprocess.remove_mains(recording, {mains:g})")
    if delay:
        lines.append(f"recording = tv.preprocess.align_channels(recording, {delay!r})")
    cutting = settings.cutting
    if cutting.decimate is not None:
        lines.append(f"recording = tv.preprocess.decimate(recording, {_text(cutting.decimate)})")
    cut = (
        f"tv.preprocess.segment(recording, {_text(cutting.period)}, {_text(cutting.context)}, gaps)"
    )
    names = f", {list(deviating)!r}" if deviating else ""
    lines.append(f"ensemble = tv.preprocess.subtract_mean({cut}{names})")
    return "\n".join([*lines, f"found = tv.compare(ensemble, [{settings.method!r}])"])


def _changed(settings: Reading | Cutting) -> dict[str, object]:
    """Return the settings that differ from the defaults."""
    usual = attrs.asdict(type(settings)())
    return {name: value for name, value in attrs.asdict(settings).items() if value != usual[name]}


def _text(value: object) -> str:
    """Return a value as typed, whole numbers without a point."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def checked(given: Mapping[str, Any], channels: Collection[str] = ()) -> dict[str, Any]:
    """Return the initial settings of a page, if its controls can show them.

    Raises
    ------
    InputError
        For a channel that is not in the file, a word that is no choice, or what should be a number.
    """
    further = named_channels(
        [given["channel"]] if isinstance(given["channel"], str) else given["channel"]
    )
    for name, in_file in {
        "angle": given["angle"],
        "torque": given["torque"],
        **further,
    }.items():
        if in_file is not None and in_file not in channels:
            raise InputError(
                f"{name}: no channel {in_file!r}; the file holds {', '.join(channels) or 'none'}"
            )
    for name, choices in CHOICES.items():
        if given[name] not in choices:
            raise InputError(
                f"{name}: expected one of {', '.join(map(str, choices))}, got {given[name]!r}"
            )
    found = {
        name: _number(given[name], name)
        for name in ("rate", "start", "period", "decimate", "context")
    }
    return {**given, **found, "channel": further}


def settings_from(said: Mapping[str, Any], source: Source) -> Settings:
    """Return the settings from the values of the controls.

    ``source`` has the file, and the settings of :class:`Reading` that have no control.

    Raises
    ------
    InputError
        For what is missing, or is no number; says where.
    """
    reading = source if isinstance(source, Recording) else _reading(said, source)
    period = _number(
        said["period"],
        "period",
        "the duration of one repetition (s), any if the joint is held still",
    )
    context = _number(said["context"], "context", "0 for none (s)")
    cutting = Cutting(
        period=period,
        decimate=_number(said["decimate"], "decimate"),
        context=context,
        align_channels=said["align_channels"],
    )
    return Settings(reading, cutting, method_text(said["method"], said["settings"]))


def _reading(said: Mapping[str, Any], source: Mapping[str, Any]) -> SourceFile:
    for name in ("angle", "torque"):
        if not said[name]:
            raise InputError(f"choose the channel with the {name}")
    own = {name: said[name] for name in ("angle", "torque", "angle_unit", "torque_unit", "columns")}
    rate = _number(said["rate"], "sampling rate", "what the recording was sampled at (Hz)")
    reading = Reading(
        **own,
        sampling_rate=rate,
        torque_sign=-1 if said["reversed"] else 1,
        channels=source["channel"],
        start=source.get("start", 0.0),
    )
    return SourceFile(source["file"], reading)


def _number(value: object, what: str, need: str = "") -> Any:
    """Return the number in a control, or None if it is empty. With a ``need`` it must not be."""
    if value is None and need:
        raise InputError(f"{what} is missing: give {need}")
    if value is not None and not (isinstance(value, numbers.Real) and math.isfinite(value)):
        raise InputError(f"{what}: expected a number, got {value!r}")
    return None if value is None else float(value)


def method_settings(key: str) -> dict[str, str]:
    """Return the settings of a method and their defaults as text; none if one is required."""
    try:
        method = parse(key)
    except InputError:
        return {}
    shown = {
        name: f"{value:.4g}" if isinstance(value, float) else str(value)
        for name, value in settings_of(method).items()
    }
    return shown | ({"tuned": "false"} if method.can_be_tuned else {})


def method_text(key: str, given: Mapping[str, str]) -> str:
    """Return a method as typed: its key and settings."""
    words = [f"{name}={text.strip()}" for name, text in given.items() if text.strip()]
    return ":".join(filter(None, (key, ",".join(words))))


def method_parts(text: str) -> tuple[str, dict[str, str]]:
    """Return the key of a method as typed, and its settings."""
    key = key_of(text)
    return key, split_settings(text[len(key) + 1 :])
