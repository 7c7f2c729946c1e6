"""Write recordings as NWB."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from types import MappingProxyType

from tvsysid.errors import InputError
from tvsysid.recordings.write import checked, whole_file
from tvsysid.signals import Recording

NWB_VERSION = "2.7.0"
GROUPS = (
    "acquisition",
    "analysis",
    "general",
    "processing",
    "stimulus/presentation",
    "stimulus/templates",
)


def write_nwb(
    path: str | Path,
    recording: Recording,
    session_start: datetime,
    description: str = "Joint perturbation experiment",
    units: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write a recording as Neurodata Without Borders.

    :func:`tvsysid.read_recording` and other programs read it.

    Parameters
    ----------
    path
        File to write, ``.nwb``.
    recording
        Angle (rad), torque (N·m) and channels become the time series ``acquisition/angle`` and so
        on.
    session_start
        When the recording began; in local time if it has no time zone.
    description
        Of the session, in words.
    units
        Of further channels, by their names.

    Raises
    ------
    InputError
        For another ending, a channel whose name has a slash, or more than one trial: NWB has one
        axis of time, so write each trial to a file of its own, which :func:`tvsysid.read_trials`
        joins.

    Examples
    --------
    >>> import numpy as np, tempfile, tvsysid as tv
    >>> from datetime import datetime, timezone
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = f"{folder}/ankle.nwb"
    ...     start = datetime(2026, 5, 4, 9, 30, tzinfo=timezone.utc)
    ...     write_nwb(file, tv.Recording(angle, 80 * angle, 100), start)
    ...     names = {"angle": "acquisition/angle", "torque": "acquisition/torque"}
    ...     tv.read_recording(file, **names, sampling_rate=100)
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    import h5py  # noqa: PLC0415  # heavy

    def typed(kind: str) -> dict[str, str]:
        return {"namespace": "core", "neurodata_type": kind, "object_id": str(uuid.uuid4())}

    file = checked(path, ".nwb")
    if len(recording.trials) > 1:
        raise InputError(f"{file}: NWB has one axis of time; write each trial to a file of its own")
    signals = {"angle": recording.angle, "torque": recording.torque, **recording.channels}
    if bad := [name for name in signals if not name or "/" in name or name == "."]:
        raise InputError(f"{file}: a time series cannot be called {bad[0]!r}; rename the channel")
    began = session_start.astimezone().isoformat()
    units = {"angle": "rad", "torque": "N m", **units}
    with whole_file(file) as temporary, h5py.File(temporary, "w") as root:
        for group in GROUPS:
            root.create_group(group)
        root["identifier"], root["session_description"] = file.stem, description
        root["session_start_time"] = root["timestamps_reference_time"] = began
        root.create_dataset("file_create_date", data=[began], maxshape=(None,))
        root.attrs.update(typed("NWBFile") | {"nwb_version": NWB_VERSION})
        for name, values in signals.items():
            series = root.create_group(f"acquisition/{name}")
            series.attrs.update(typed("TimeSeries"))
            data = series.create_dataset("data", data=values, compression="gzip", shuffle=True)
            data.attrs["unit"] = units.get(name, "unknown")
            start = series.create_dataset("starting_time", data=float(recording.start))
            start.attrs.update({"rate": float(recording.sampling_rate), "unit": "seconds"})
