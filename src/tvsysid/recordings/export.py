"""Write recordings as NWB, and estimates as tables of BIDS derivatives."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from tvsysid import __version__
from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.recordings.write import checked, whole_file, write_table
from tvsysid.signals import Recording

if TYPE_CHECKING:
    import pandas as pd

NWB_VERSION, BIDS_VERSION = "2.7.0", "1.10.0"
GROUPS = (
    "acquisition",
    "analysis",
    "general",
    "processing",
    "stimulus/presentation",
    "stimulus/templates",
)
COLUMN_UNITS = {**UNITS, "time_s": "s", "time_varying_vaf": "%"}
DATASET = {
    "Name": "Joint impedance identified by tvsysid",
    "BIDSVersion": BIDS_VERSION,
    "DatasetType": "derivative",
    "GeneratedBy": [{"Name": "tvsysid", "Version": __version__}],
}


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


def write_bids(folder: str | Path, source: str | Path, table: pd.DataFrame) -> Path:
    """Write estimates over time as a table of a BIDS derivative, with a description beside it.

    Returns the table.

    The derivative's ``dataset_description.json`` is written if there is none.

    Parameters
    ----------
    folder
        The derivative, such as ``derivatives/tvsysid``.
    source
        File that was identified, with a BIDS name: ``sub-01_task-ankle_…_motion.tsv`` becomes
        ``sub-01/motion/sub-01_task-ankle_…_desc-stiffness_timeseries.tsv``.
    table
        Estimates over time, as ``tv.compare(...).over_time()`` returns them.

    Raises
    ------
    InputError
        If the source's name has no participant (``sub-…``).

    Examples
    --------
    >>> import pandas as pd, tempfile
    >>> table = pd.DataFrame({"time_s": [0.0, 0.01], "method": "sds", "stiffness": [80.0, None]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_bids(folder, "sub-01_task-ankle_tracksys-robot_motion.tsv", table)
    ...     print(file.relative_to(folder).as_posix())
    ...     print(file.read_text())
    sub-01/motion/sub-01_task-ankle_tracksys-robot_desc-stiffness_timeseries.tsv
    time_s method  stiffness
    0      sds     80
    0.01   sds     n/a
    <BLANKLINE>
    """
    name = Path(source).name
    words = name.split("_")
    if not re.fullmatch(r"sub-[A-Za-z0-9]+", words[0]) or len(words) < 2:
        raise InputError(
            f"{name}: not the name of a BIDS file; expected one such as "
            "sub-01_task-ankle_motion.tsv"
        )
    above = [word for word in words[:2] if word.startswith(("sub-", "ses-"))]
    stem = "_".join([*words[:-1], "desc-stiffness_timeseries.tsv"])
    file = Path(folder).joinpath(*above, "motion", stem)
    meanings = {column: _meaning(column) for column in table.columns}
    _write_json(file.with_suffix(".json"), {"Sources": [name], **meanings})
    write_table(file, table, missing="n/a")
    described = Path(folder) / "dataset_description.json"
    if not described.exists():
        _write_json(described, DATASET)
    return file


def _meaning(column: str) -> dict[str, str]:
    """Return the description and the unit of a column."""
    quantity = column.removesuffix("_lower").removesuffix("_upper")
    limit = "" if quantity == column else f", {column[-5:]} limit of its 95 % band"
    unit = {"Units": COLUMN_UNITS[quantity]} if quantity in COLUMN_UNITS else {}
    return {"Description": f"{quantity.replace('_', ' ').capitalize()}{limit}", **unit}


def _write_json(file: Path, content: Mapping[str, object]) -> None:
    with whole_file(file) as temporary:
        text = json.dumps(content, indent=2, ensure_ascii=False)
        temporary.write_text(f"{text}\n", encoding="utf-8")
