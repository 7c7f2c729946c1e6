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


class Perturbation(StrEnum):
    """Perturbations that can be simulated."""

    noise = "noise"
    prbs = "prbs"


class Profile(StrEnum):
    """Stiffness profiles that can be simulated."""

    square = "square"
    sine = "sine"
    constant = "constant"


MethodOption = Annotated[
    list[str],
    typer.Option(
        "--method",
        "-m",
        metavar="KEY[:SETTING=VALUE,…]",
        help="Method, with settings if need be, as in `sds:window=0.2`; one of your own as `module:Class`, the module "
        "being in the current folder or installed. Repeat it for more. See `tvsysid methods`.",
    ),
]

# How a recording is read and cut: `identify` and `inspect --diagnose`.
ANGLE = typer.Option(metavar="NAME", help="Variable or column that holds the angle.")
TORQUE = typer.Option(metavar="NAME", help="Variable or column that holds the torque, in N·m.")
RATE = typer.Option(metavar="HZ", help="Sampling rate of the file.")
PERIOD = typer.Option(metavar="S", help="Duration of one realization of the behaviour.")
DecimateOption = Annotated[
    float | None,
    typer.Option(metavar="HZ", help="Low-pass and decimate to this rate first; 100 Hz is usual, and much faster."),
]
ColumnsOption = Annotated[
    Columns, typer.Option(help="Whether the columns of a matrix follow each other in time or are trials of their own.")
]
TorqueSignOption = Annotated[
    int, typer.Option(metavar="1|-1", help="-1 if the file's torque assists where it should resist.")
]
AngleUnitOption = Annotated[AngleUnit, typer.Option(help="Unit of the angle in the file.")]
StartOption = Annotated[
    float, typer.Option(metavar="S", help="Time of the first sample; realizations begin at multiples of the period.")
]
ContextOption = Annotated[
    float, typer.Option(metavar="S", help="Record kept beside each realization, for lags and windows at its edges.")
]

# How a study is run: `benchmark` and `experiment`.
SeedOption = Annotated[int | None, typer.Option(metavar="N", help="Seed; the same seed gives the same numbers. [0]")]
WorkersOption = Annotated[
    int | None, typer.Option(metavar="N", help="Processes; as many as there are cores by default.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Run on a Dask cluster instead, such as tcp://host:8786 (tvsysid[dask])."),
]
OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")]
