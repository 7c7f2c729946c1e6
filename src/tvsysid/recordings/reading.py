"""Settings for reading a recording from a file and cutting it into realizations.

The command line imports this module for its options, and must start quickly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

import attrs

from tvsysid.errors import InputError
from tvsysid.validators import finite, not_negative, one_of, optional, positive

AngleUnit = Literal["rad", "deg"]
TorqueUnit = Literal["Nm", "Nmm"]
Columns = Literal["contiguous", "trials"]
TorqueSign = Literal[1, -1]

OPTION_NAMES = {"sampling_rate": "rate", "channels": "channel"}
"""Names of command-line options that differ from the names of the settings."""


def named_channels(channels: Iterable[str]) -> dict[str, str]:
    """Return the channel in the file for each name in the recording.

    ``channels`` is such a mapping, or a sequence of NAME=CHANNEL texts.

    Examples
    --------
    >>> named_channels(["emg=EMG_SIGNAL"])
    {'emg': 'EMG_SIGNAL'}
    """
    if not isinstance(channels, Mapping):
        pairs = [text.partition("=")[::2] for text in channels]
        if not all(map(all, pairs)) or len(dict(pairs)) < len(pairs):
            raise InputError(
                f"--channel {' '.join(channels)}: expected NAME=CHANNEL, as in emg=EMG_SIGNAL, and "
                "each name once"
            )
        channels = dict(pairs)
    if channels.keys() & {"angle", "torque"}:
        raise InputError("channels: the names angle and torque are taken; give other names")
    return dict(channels)


@attrs.frozen(kw_only=True)
class Reading:
    """Settings for reading a recording from a file.

    Parameters
    ----------
    angle
        Variable or column with the angle.
    torque
        Variable or column with the torque.
    sampling_rate
        Sampling rate in Hz.
    channels
        Further channels by the name that a method expects: ``emg=EMG_SIGNAL``. Repeatable.
    columns
        Whether the columns of a matrix follow each other in time or are separate trials.
    torque_sign
        -1 if the torque in the file falls when the angle rises.
    angle_unit
        Unit of the angle in the file.
    torque_unit
        Unit of the torque in the file; most C3D files have Nmm.
    start
        Time of the first sample in s. Realizations begin at time 0 and each period later.

    Raises
    ------
    InputError
        For a setting that is not valid.

    Examples
    --------
    >>> import numpy as np, tempfile, tvsysid as tv
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> reading = Reading(angle="angle", torque="torque", sampling_rate=100)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/ankle.npz", angle=angle, torque=80 * angle)
    ...     tv.read_recording(f"{folder}/ankle.npz", reading)
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """

    angle: str | None = None
    torque: str | None = attrs.field(default=None)
    sampling_rate: float | None = attrs.field(default=None, validator=optional(positive))
    channels: Mapping[str, str] = attrs.field(factory=dict, converter=named_channels, hash=False)
    columns: Columns = attrs.field(default="contiguous", validator=one_of(Columns))
    torque_sign: TorqueSign = attrs.field(default=1, validator=one_of(TorqueSign))
    angle_unit: AngleUnit = attrs.field(default="rad", validator=one_of(AngleUnit))
    torque_unit: TorqueUnit = attrs.field(default="Nm", validator=one_of(TorqueUnit))
    start: float = attrs.field(default=0.0, validator=finite)

    @torque.validator
    def _is_not_the_angle(self, _: object, torque: str | None) -> None:
        if torque is not None and torque == self.angle:
            raise InputError(
                f"angle and torque are both {torque!r}; name the channel of each (--angle, "
                "--torque)"
            )

    @property
    def missing(self) -> list[str]:
        """Names of the settings that reading needs and that are not given."""
        needed = ("angle", "torque", "sampling_rate")
        return [name for name in needed if getattr(self, name) is None]

    @property
    def names(self) -> dict[str, str]:
        """Channel in the file for each signal of the recording.

        Raises
        ------
        InputError
            If the angle, the torque or the sampling rate is not given.
        """
        if missing := self.missing:
            options = " ".join(f"--{OPTION_NAMES.get(name, name)}" for name in missing)
            raise InputError(
                f"missing: {', '.join(missing)}; add {options}. `tvsysid inspect FILE` lists the "
                "channels of a file"
            )
        return {"angle": str(self.angle), "torque": str(self.torque), **self.channels}


@attrs.frozen(kw_only=True)
class Segmentation:
    """Settings for decimating a recording and cutting it into realizations.

    Parameters
    ----------
    period
        Duration of a realization (one repetition of the movement) in s.
    decimate
        Filter and decimate to this rate in Hz first; 100 Hz is usual.
    context
        Seconds kept on either side of a realization, for lags and windows.
    """

    period: float | None = attrs.field(default=None, validator=optional(positive))
    decimate: float | None = attrs.field(default=None, validator=optional(positive))
    context: float = attrs.field(default=0.5, validator=not_negative)


def split_settings(settings: Mapping[str, Any]) -> tuple[Reading, Segmentation]:
    """Divide settings by name into those for reading a file and those for cutting it."""
    cutting = attrs.fields_dict(Segmentation).keys() & settings
    return (
        Reading(**{name: settings[name] for name in settings if name not in cutting}),
        Segmentation(**{name: settings[name] for name in cutting}),
    )
