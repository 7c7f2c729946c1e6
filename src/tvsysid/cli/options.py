"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Columns(StrEnum):
    """What the columns of a matrix are."""

    contiguous = "contiguous"
    trials = "trials"


class AngleUnit(StrEnum):
    """Unit of the angle in the file."""

    rad = "rad"
    deg = "deg"


MethodOption = Annotated[
    list[str],
    typer.Option(
        "--method",
        "-m",
        metavar="KEY[:SETTING=VALUE,…]",
        help="Method, with settings after a colon if you wish: `sds:window=0.2`. A method of your own is "
        "`module:Class`, where the module is in the current folder or installed. Repeatable; `tvsysid methods` lists "
        "the methods.",
    ),
]

# How a recording is read and cut: `identify` and `inspect --diagnose`.
ANGLE = typer.Option(metavar="NAME", help="Name of the variable or column with the angle.")
TORQUE = typer.Option(metavar="NAME", help="Name of the variable or column with the torque, in N·m.")
RATE = typer.Option(metavar="HZ", help="Sampling rate of the recording.")
PERIOD = typer.Option(metavar="S", help="Duration of one realization, that is, of one repetition of the behaviour.")
DecimateOption = Annotated[
    float | None,
    typer.Option(
        metavar="HZ", help="Low-pass filter and decimate to this rate first; 100 Hz is usual, and much faster."
    ),
]
ColumnsOption = Annotated[
    Columns,
    typer.Option(
        help="What the columns of a matrix are: parts of one recording, in order of time, or separate trials."
    ),
]
TorqueSignOption = Annotated[
    int,
    typer.Option(
        metavar="1|-1",
        help="Give -1 if the file's torque has the opposite sign: torque must rise with the angle (torque = stiffness "
        "x angle, with positive stiffness).",
    ),
]
AngleUnitOption = Annotated[AngleUnit, typer.Option(help="Unit of the angle in the file.")]
StartOption = Annotated[
    float, typer.Option(metavar="S", help="Time of the first sample; realizations begin at multiples of the period.")
]
ChannelOption = Annotated[
    list[str],
    typer.Option(
        "--channel",
        metavar="NAME=CHANNEL",
        help="Read a further channel for methods that need one, and give it the name that the method expects: "
        "`emg=EMG_SIGNAL` reads EMG_SIGNAL as emg. Repeatable.",
    ),
]
ContextOption = Annotated[
    float,
    typer.Option(
        metavar="S", help="Seconds kept before and after each realization, which lags and windows need at its ends."
    ),
]

# How a study is run: `benchmark` and `experiment`.
SeedOption = Annotated[
    int | None, typer.Option(metavar="N", help="Seed of the random numbers; the same seed gives the same results. [0]")
]
WorkersOption = Annotated[int | None, typer.Option(metavar="N", help="Number of processes. [one for each core]")]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Run on a Dask cluster instead: address of its scheduler, such as tcp://host:8786; needs `tvsysid[dask]`.",
    ),
]
OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")]
