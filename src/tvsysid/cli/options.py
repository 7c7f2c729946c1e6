"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated, Any

import attrs
from cyclopts import Parameter

from tvsysid.recordings.reading import OPTION_NAMES, Reading, Segmentation

NAMES = {**OPTION_NAMES, "methods": "method", "duration_s": "duration", "snr_db": "snr"}
"""Names of options that differ from the names of the settings."""
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


Flag = Annotated[bool, Parameter(negative=())]
Flattened = Parameter(name="*")  # each field of a class is an option
ReadingOptions = Annotated[Reading, Flattened]
SegmentationOptions = Annotated[Segmentation, Flattened]
WorkerOptions = Annotated[Workers, Flattened]
Methods = Annotated[
    list[str],
    Parameter(
        alias="-m",
        help="Method, with settings after a colon if you wish: `sds:window=0.2`. A method of your "
        "own is `module:Class`, where the module is in the current folder or installed. "
        "Repeatable; `tvsysid methods` lists the methods.",
    ),
]


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
