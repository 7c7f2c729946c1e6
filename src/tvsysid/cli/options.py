"""Options that several commands share, and the recording that they describe."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from tvsysid.signals import Recording

Columns = Literal["contiguous", "trials"]
AngleUnit = Literal["rad", "deg"]
TorqueUnit = Literal["Nm", "Nmm"]


def option(metavar: str | None, text: str, *names: str) -> Any:
    """Option with a placeholder for its value and a help text, which is of this name or of the parameter's."""
    return typer.Option(*names, metavar=metavar, help=text)


def given(**options: object) -> dict[str, Any]:
    """The options that were given."""
    return {name: value for name, value in options.items() if value not in (None, [])}


MethodOption = Annotated[
    list[str],
    option(
        "KEY[:SETTING=VALUE,…]",
        "Method, with settings after a colon if you wish: `sds:window=0.2`. A method of your own "
        "is `module:Class`, "
        "where the module is in the current folder or installed. Repeatable; `tvsysid methods` "
        "lists the methods.",
        "--method",
        "-m",
    ),
]

FileArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="MAT, CSV, TSV, NPZ, HDF5, NetCDF, NWB, Motion-BIDS, Parquet, C3D or EDF file.",
    ),
]

# How a recording is read and cut: `identify` and `inspect --diagnose`.
ANGLE = option("NAME", "Name of the variable or column with the angle.")
TORQUE = option("NAME", "Name of the variable or column with the torque.")
RATE = option("HZ", "Sampling rate of the recording.")
PERIOD = option("S", "Duration of one realization, that is, of one repetition of the behaviour.")
DecimateOption = Annotated[
    float | None,
    option(
        "HZ",
        "Low-pass filter and decimate to this rate first; 100 Hz is usual, and makes it much "
        "faster.",
    ),
]
ColumnsOption = Annotated[
    Columns,
    option(
        None,
        "What the columns of a matrix are: parts of one recording, in order of time, or separate "
        "trials.",
    ),
]
TorqueSignOption = Annotated[
    int,
    option(
        "1|-1",
        "Give -1 if the file's torque has the opposite sign: torque must rise with the angle "
        "(torque = stiffness x "
        "angle, with positive stiffness).",
    ),
]
AngleUnitOption = Annotated[AngleUnit, option(None, "Unit of the angle in the file.")]
TorqueUnitOption = Annotated[
    TorqueUnit,
    option(
        None, "Unit of the torque in the file; N·mm is what C3D files have in most laboratories."
    ),
]
StartOption = Annotated[
    float, option("S", "Time of the first sample; realizations begin at multiples of the period.")
]
HeaderOption = Annotated[
    bool,
    typer.Option(
        "--header/--no-header",
        metavar="",
        help="Whether the first line of a text table (CSV, TSV) has names; if not, columns are "
        "called 1, 2, ...",
    ),
]
ChannelOption = Annotated[
    list[str],
    option(
        "NAME=CHANNEL",
        "Read a further channel for methods that need one, and give it the name that the method "
        "expects: "
        "`emg=EMG_SIGNAL` reads EMG_SIGNAL as emg. Repeatable.",
        "--channel",
    ),
]
ContextOption = Annotated[
    float,
    option(
        "S",
        "Seconds kept before and after each realization, because lags and windows reach beyond "
        "its ends.",
    ),
]

# How a study is run: `benchmark` and `experiment`.
SeedOption = Annotated[
    int | None, option("N", "Seed of the random numbers; the same seed gives the same results. [0]")
]
WorkersOption = Annotated[int | None, option("N", "Number of processes. [one for each core]")]
SchedulerOption = Annotated[
    str | None,
    option(
        "ADDRESS",
        "Run on a Dask cluster instead: address of its scheduler, such as tcp://host:8786; needs "
        "`tvsysid[dask]`.",
    ),
]
OutOption = Annotated[Path, option("DIR", "Folder for the results.", "--out")]


def read(
    file: Path,
    angle: str,
    torque: str,
    rate: float,
    columns: Columns,
    torque_sign: int,
    angle_unit: AngleUnit,
    start: float,
    header: bool = True,
    torque_unit: TorqueUnit = "Nm",
    channel: Iterable[str] = (),
) -> Recording:
    """Recording as the options say; each of the further channels as NAME=CHANNEL."""
    from tvsysid.recordings.reading import named_channels, read_recording

    return read_recording(
        file,
        angle=angle,
        torque=torque,
        sampling_rate=rate,
        angle_unit=angle_unit,
        torque_sign=torque_sign,
        columns=columns,
        start=start,
        channels=named_channels(channel),
        header=header,
        torque_unit=torque_unit,
    )
