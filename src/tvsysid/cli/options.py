"""Options that several commands share."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import attrs
from cyclopts import App, ArgumentCollection, Parameter, default_name_transform

from tvsysid.cli.console import remark
from tvsysid.errors import InputError
from tvsysid.recordings.reading import OPTION_NAMES, Reading, Segmentation, named_channels

if TYPE_CHECKING:
    from tvsysid.recordings import Channel

NAMES = {**OPTION_NAMES, "methods": "method", "duration_s": "duration"}
"""Names of options that differ from the names of the settings."""
FILES = ("FILE", "FILES", "--pilot")  # arguments that are recordings
USUAL_RATE = 100.0  # Hz
SLOW_RATE = 250.0  # Hz; identifying at higher rates takes minutes


@attrs.frozen
class Workers:
    """Processes that run a study.

    Parameters
    ----------
    workers
        Number of processes. [one for each core]
    scheduler
        Run on a Dask cluster instead: address of its scheduler, such as tcp://host:8786; needs
        `tvsysid[dask]`.
    """

    workers: int | None = None
    scheduler: str | None = None


def option_name(name: str) -> str:
    """Return the name of the option for a parameter or a setting."""
    return NAMES.get(name) or default_name_transform(name)


Flag = Annotated[bool, Parameter(negative=())]
Flattened = Parameter(name="*")  # each field of a class is an option
ReadingOptions = Annotated[Reading, Flattened]
SegmentationOptions = Annotated[Segmentation, Flattened]
WorkerOptions = Annotated[Workers, Flattened]
Methods = Annotated[
    list[str],
    Parameter(
        alias="-m",
        help="Method, as `sds:window=0.2`; of your own, `module:Class`. Repeatable. See `tvsysid "
        "methods`.",
    ),
]


def use_saved_settings(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Take options that were not typed from FILE.toml beside the recording, and say so."""
    tokens = {argument.name: argument.tokens for argument in arguments}
    if "--angle" not in tokens:
        return
    from cyclopts.config import Dict

    from tvsysid.recordings import recordings_in
    from tvsysid.recordings.saved import saved_settings, settings_file

    typed = [Path(token.value) for name in FILES for token in tokens.get(name, ())]
    found = {settings_file(file): saved_settings(file) for file in recordings_in(typed)}
    known = [(source, settings) for source, settings in found.items() if settings]
    if not known:
        return
    source, saved = known[0]
    for other, settings in known:
        if settings != saved:
            raise InputError(
                f"{source} and {other} differ; identify these recordings one at a time"
            )
    channels = named_channels(saved.get("channels", ()))
    options = {option_name(name): value for name, value in saved.items()}
    options["channel"] = [f"{own}={name}" for own, name in channels.items()]
    Dict(options, source=str(source), use_commands_as_keys=False)(app, commands, arguments)
    remark("note", f"settings of {source}; options override them")


def suggested_options(channels: Mapping[str, Channel]) -> dict[str, str]:
    """Return the options that identify a file with these channels, by the settings' names."""
    options = {}
    for own, pattern in {"angle": "angle|pos", "torque": "torque|tq"}.items():
        found = [name for name in channels if re.search(pattern, name, re.IGNORECASE)]
        chosen = own if own in channels else found[0] if len(found) == 1 else "CHANNEL"
        options[own] = f"--{own} {shlex.quote(chosen)}"
    rates = {each.sampling_rate for each in channels.values() if each.sampling_rate}
    rate = rates.pop() if len(rates) == 1 else None
    return options | {"sampling_rate": rate_options(rate), "period": "--period SECONDS"}


def rate_options(rate: float | None) -> str:
    """Return the options for a recording of this rate (Hz), and to identify it quickly."""
    from tvsysid.preprocess.trials import nearest_rate

    if rate is None:
        return f"--rate HZ --decimate {USUAL_RATE:g}"
    decimated = f" --decimate {nearest_rate(rate, USUAL_RATE):g}" if rate > SLOW_RATE else ""
    return f"--rate {rate:g}{decimated}"


def given(**options: object) -> dict[str, Any]:
    """Return the options that were given."""
    return {name: value for name, value in options.items() if value not in (None, [])}
