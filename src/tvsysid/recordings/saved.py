"""Keep how a recording is read and cut beside its file, in FILE.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import attrs

from tvsysid.errors import InputError
from tvsysid.recordings.reading import Reading, Segmentation


def settings_file(file: Path) -> Path:
    """Return the path of a recording's settings: ``ankle.mat.toml`` beside ``ankle.mat``."""
    return file.with_name(f"{file.name}.toml")


def save_settings(file: Path, reading: Reading, segmentation: Segmentation) -> Path:
    """Write the settings of a recording beside its file, and return their path.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "ankle.mat")
    ...     reading = Reading(angle="angle", torque="torque")
    ...     path = save_settings(file, reading, Segmentation(period=2.0))
    ...     saved_settings(file)["period"]
    2.0
    """
    import tomli_w  # noqa: PLC0415  # the command line must start quickly

    from tvsysid.recordings.write import whole_file  # noqa: PLC0415  # as above

    settings = attrs.asdict(reading) | attrs.asdict(segmentation)
    text = tomli_w.dumps({name: value for name, value in settings.items() if value is not None})
    with whole_file(settings_file(file)) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return settings_file(file)


def saved_settings(file: Path) -> dict[str, Any]:
    """Return the settings that :func:`save_settings` wrote beside a recording, if any, by name.

    Raises
    ------
    InputError
        If the file of settings is no TOML.
    """
    path = settings_file(file)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise InputError(f"{path}: {error}; correct it, or delete it") from error
