"""Settings of the explorer, and the command and the Python code that repeat an analysis."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from tvsysid.comparison import PreparedRecording
from tvsysid.errors import InputError
from tvsysid.methods import key_of, parse
from tvsysid.methods.settings import split_settings
from tvsysid.recordings.reading import OPTION_NAMES, Reading, Segmentation
from tvsysid.signals import Recording
from tvsysid.validators import settings_of

REQUIRED = {
    "angle": "choose the channel with the angle",
    "torque": "choose the channel with the torque",
    "sampling_rate": "enter the sampling rate of the recording (Hz)",
    "period": "enter the duration of one repetition (s); any, if the joint is held still",
}


@attrs.frozen
class Settings:
    """A recording or a file, how it is read and cut, and the method with its settings as text."""

    source: Path | Recording
    reading: Reading = attrs.field(factory=Reading)
    cutting: Segmentation = attrs.field(factory=Segmentation)
    align_channels: bool = True
    method: str = "adaptive"

    @property
    def command(self) -> str:
        """The command of the same analysis; empty for a recording without a file."""
        if isinstance(self.source, Recording):
            return ""
        words = ["tvsysid", "identify", str(self.source)]
        for name, value in (_changed(self.reading) | _changed(self.cutting)).items():
            channels = value.items() if isinstance(value, Mapping) else ()
            for text in [f"{own}={there}" for own, there in channels] or [_text(value)]:
                words += ("--" + OPTION_NAMES.get(name, name).replace("_", "-"), text)
        words += [] if self.align_channels else ["--no-align-channels"]
        return shlex.join([*words, "--method", self.method])

    def python(self, prepared: PreparedRecording) -> str:
        """Return Python code of the same analysis, with the corrections that were made."""
        lines = ["import tvsysid as tv", ""]
        if isinstance(self.source, Path):
            words = [repr(str(self.source))]
            words += (
                f"{name}={value!r}"
                if isinstance(value, Mapping | str)
                else f"{name}={_text(value)}"
                for name, value in _changed(self.reading).items()
            )
            lines.append(f"recording = tv.read_recording({', '.join(words)})")
        lines.append("gaps = tv.preprocess.find_gaps(recording)")
        delay, rate = float(prepared.ensemble.delay_removed), self.cutting.decimate
        for step, value in (
            ("remove_mains", prepared.mains),
            ("align_channels", delay),
            ("decimate", rate),
        ):
            if value:
                lines.append(f"recording = tv.preprocess.{step}(recording, {_text(value)})")
        cut = f"{_text(self.cutting.period)}, {_text(self.cutting.context)}, gaps"
        channels = f", {list(prepared.centered)!r}" if prepared.centered else ""
        lines += [
            f"ensemble = tv.preprocess.segment(recording, {cut})",
            f"ensemble = tv.preprocess.subtract_mean(ensemble{channels})",
            f"found = tv.compare(ensemble, [{self.method!r}])",
        ]
        return "\n".join(lines)


def _changed(settings: Reading | Segmentation) -> dict[str, object]:
    """Return the settings that differ from the defaults."""
    usual = attrs.asdict(type(settings)())
    return {name: value for name, value in attrs.asdict(settings).items() if value != usual[name]}


def _text(value: object) -> str:
    """Return a value as typed, whole numbers without a point."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def settings_from(controls: Mapping[str, Any], start: Settings) -> Settings:
    """Return the settings that the controls of the page show.

    Parameters
    ----------
    controls
        Fields of :class:`Reading` and :class:`Segmentation`; ``reversed``, ``align_channels``, the
        key of the ``method`` and the texts of its ``settings``.
    start
        Settings of the page when it opens: the source, and what has no control.

    Raises
    ------
    InputError
        For what is missing or not valid.
    """
    for name, text in REQUIRED.items():
        if name in controls and controls[name] in ("", None):
            raise InputError(text)
    reading = start.reading
    if isinstance(start.source, Path):
        own = {name: controls[name] for name in attrs.fields_dict(Reading) if name in controls}
        reading = attrs.evolve(reading, **own, torque_sign=-1 if controls["reversed"] else 1)
    cutting = Segmentation(**{name: controls[name] for name in attrs.fields_dict(Segmentation)})
    method = method_text(controls["method"], controls["settings"])
    return Settings(start.source, reading, cutting, controls["align_channels"], method)


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
