"""The command line: parses, calls, prints; no science."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tvsysid.errors import DataQualityWarning, InputError

if TYPE_CHECKING:
    import pandas as pd

    from tvsysid.check import Check
    from tvsysid.methods import Method
    from tvsysid.models import Model
    from tvsysid.quality import Diagnosis
    from tvsysid.signals import Ensemble, Recording

app = typer.Typer(
    name="tvsysid",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="How stiff a human joint is while it moves: time-varying identification of joint impedance.\n\n"
    "All units are SI: rad, N·m, s, Hz, N·m/rad, N·m·s/rad, kg·m².",
)
output = Console()
errors = Console(stderr=True)

DEFAULT_METHODS = ["eirf", "sds", "birf", "esm", "kbr"]  # those of tvsysid.methods.names(), which takes long to import
MOST_TABLES = 4
"""Scenarios whose table is printed; the report has all."""
MOST_RECORDINGS = 24
"""Recordings whose numbers of realizations are printed."""
MOST_DRAWN = 12
"""Channels of a file that are drawn."""
MOST_COLUMNS = 20
"""Columns of a matrix that are drawn."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
STORE = "results.zarr"
"""Where a benchmark keeps its trials, in its folder."""
SLOW_RATE = 250.0
"""Hz from which on identifying without decimation takes minutes."""


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


class Preset(StrEnum):
    """Studies by name."""

    quick = "quick"
    paper = "paper"
    snr = "snr"
    viscosity = "viscosity"


class Viscosity(StrEnum):
    """Viscosities that can be simulated."""

    constant = "constant"
    covarying = "covarying"


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


# What tells how a file is read; `identify` and `inspect --diagnose` share it.
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


SeedOption = Annotated[int | None, typer.Option(metavar="N", help="Seed; the same seed gives the same numbers. [0]")]
WorkersOption = Annotated[
    int | None, typer.Option(metavar="N", help="Processes; as many as there are cores by default.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Run on a Dask cluster instead, such as tcp://host:8786 (tvsysid[dask])."),
]


@app.callback(invoke_without_command=True)
def tvsysid(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Parse what stands before the command."""
    if version:
        from tvsysid import __version__

        output.print(f"tvsysid {__version__}", highlight=False)
        raise typer.Exit


@app.command()
def benchmark(
    study_file: Annotated[
        Path | None, typer.Argument(metavar="[STUDY.toml]", help="TOML file with the study's settings.")
    ] = None,
    preset: Annotated[
        Preset | None,
        typer.Option(
            help="`quick` (the default), `paper` (van de Ruit et al. 2021: 40 to 600 s, 100 trials, and their sine), "
            "`snr` (0 to 30 dB), `viscosity` (constant, and rising with stiffness). Options below take the place of "
            "its settings."
        ),
    ] = None,
    stiffness: Annotated[
        list[Profile] | None, typer.Option(help="Stiffness profile of the simulated joint; repeatable. [square]")
    ] = None,
    perturbation: Annotated[
        list[Perturbation] | None, typer.Option(help="Angular perturbation; repeatable. [noise and prbs]")
    ] = None,
    duration: Annotated[
        list[float] | None,
        typer.Option(metavar="S", help="Seconds of data, a whole number of 2-s realizations; repeatable. [150]"),
    ] = None,
    snr: Annotated[
        list[float] | None,
        typer.Option("--snr", metavar="DB", help="Signal-to-noise ratio of the torque in dB; repeatable. [10]"),
    ] = None,
    viscosity: Annotated[
        list[Viscosity] | None,
        typer.Option(help="2.2 N·m·s/rad, or from 1 to 3 N·m·s/rad with the stiffness; repeatable. [constant]"),
    ] = None,
    method: MethodOption = [],
    trials: Annotated[int | None, typer.Option(metavar="N", help="Monte-Carlo trials of each scenario. [20]")] = None,
    seed: SeedOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would be run, with an estimate of time and size, and stop.")
    ] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("tvsysid-benchmark"),
) -> None:
    """Compare methods on simulated data with known stiffness.

    Simulates a joint (inertia 0.02 kg·m², viscosity 2.2 N·m·s/rad) whose stiffness follows the profile, lets every
    method identify the same data, and scores them against the truth, as van de Ruit et al. (2021) do: bias (error of
    the mean over trials), random error (spread about that mean), total error (both), rise time (from 10 to 90 % of the
    step), VAF (share of the noiseless torque that the model predicts), and VAF after a 1-10 Hz band-pass.

    Writes to the folder:

    - `report.html`: everything below in one page: ranking, figures, the paper's claims held against the figures;

    - `summary.csv`: a row for each scenario, method and metric, with value, standard error and unit;

    - `claims.csv`: each claim of the paper, with figures and verdict;

    - `figures/`: each as PNG, PDF and SVG;

    - `results.zarr`: stiffness, VAF, time taken and warnings of every trial; `xarray.open_zarr` reads it.

    Every trial is kept when it is done. If the command is interrupted or killed, the same command goes on from there.

    Example: `tvsysid benchmark --method sds --method sds:window=0.2 --trials 50`

    Example: `tvsysid benchmark --preset paper --out paper`
    """
    from tvsysid.benchmark import Study
    from tvsysid.execution import cores

    options: dict[str, Any] = {
        "stiffness": [item.value for item in stiffness or ()],
        "perturbation": [item.value for item in perturbation or ()],
        "duration_s": duration,
        "snr_db": snr,
        "viscosity": [item.value for item in viscosity or ()],
        "methods": list(dict.fromkeys(method)),
        "trials": trials,
        "seed": seed,
    }
    given = {name: value for name, value in options.items() if value not in (None, [])}
    if study_file is not None and preset is not None:
        raise InputError(f"{study_file} and --preset {preset}: give one of them")
    study = Study.from_toml(study_file, **given) if study_file else Study.preset(preset or "quick", **given)
    if dry_run:
        _print_plan(study, workers or cores())
        return
    _check_folder(out)
    results = _run_study(study, out, workers, scheduler)
    complete = _write_study(results, out, _command_line())
    if not complete:
        sys.exit(1)


@app.command()
def experiment(
    study_file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[STUDY.toml]",
            help="TOML file that names participants, files and channels; see docs/experiment.md.",
        ),
    ] = None,
    virtual: Annotated[
        list[int] | None, typer.Option(metavar="N", help="Number of a virtual participant; repeatable. [1 to 6]")
    ] = None,
    perturbation: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Perturbation to study; repeatable. [all there are]")
    ] = None,
    method: MethodOption = [],
    realizations: Annotated[
        list[int] | None,
        typer.Option(metavar="N", help="Realizations in a bootstrap; repeatable. [75 and 150; 20 and 40 for kbr]"),
    ] = None,
    bootstraps: Annotated[int | None, typer.Option(metavar="N", help="Bootstraps of each. [100]")] = None,
    seed: SeedOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("tvsysid-experiment"),
) -> None:
    """Identify the stiffness of several participants, and how much it varies.

    Reads each participant's trials, decimates and cuts them into realizations, aligns these to the target torque,
    excludes what is unlike the rest, and lets every method identify 100 bootstraps of 75 and 150 realizations, as
    van de Ruit et al. (2021) do. Without a file it runs their experiment on six virtual participants, of whom the true
    stiffness is known.

    Writes to the folder:

    - `report.html`: everything below in one page;

    - `stiffness.csv`: stiffness over time, mean and standard deviation over bootstraps, for each participant,
    perturbation, method and number of realizations;

    - `summary.csv`: random error, VAF, VAF after a 1-10 Hz band-pass and the rest;

    - `exclusions.csv`: what became of each realization: by how much it was shifted, which step excluded it and why;

    - `diagnosis.html`: what is doubtful about each recording, what it does to the result, and what to do;

    - `claims.csv`: what the paper says of its experiment, with figures and verdict;

    - `prepared/`: the ensembles that were identified (NetCDF; `tvsysid.recordings.load_ensemble` reads them);

    - `figures/`: each as PNG, PDF and SVG, and every participant in detail as PNG and PDF;

    - `results.zarr`: every bootstrap; `xarray.open_zarr` reads it.

    All bootstraps of a method are kept when they are done. If the command is interrupted or killed, the same command
    goes on from there. A file that cannot be used is told and left out, and the others go on.

    Example: `tvsysid experiment`

    Example: `tvsysid experiment study.toml --method sds --bootstraps 50`
    """
    from tvsysid.experiment import Experiment

    options: dict[str, Any] = {
        "virtual": virtual,
        "perturbation": perturbation,
        "methods": list(dict.fromkeys(method)),
        "realizations": realizations,
        "bootstraps": bootstraps,
        "seed": seed,
    }
    given = {name: value for name, value in options.items() if value not in (None, [])}
    what = Experiment.from_toml(study_file, **given) if study_file else Experiment(**given)
    _check_folder(out)
    results, prepared = _run_experiment(what, out, workers, scheduler)
    if not _write_experiment(what, results, prepared, out, _command_line()):
        sys.exit(1)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that a benchmark or an experiment wrote.")],
) -> None:
    """Write report, tables and figures anew from the results of a benchmark or an experiment.

    Reads `results.zarr` in the folder, finished or not, and writes `report.html`, the tables and `figures/` beside it.
    Of an experiment, the recordings are read and prepared again.

    Example: `tvsysid report tvsysid-benchmark`
    """
    from tvsysid.benchmark import read_results
    from tvsysid.execution import title_of
    from tvsysid.experiment import TITLE, Experiment, prepared_recordings
    from tvsysid.experiment import read_results as read_experiment

    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give the one that a benchmark or an experiment wrote")
    _check_folder(folder)
    if title_of(folder / STORE) != TITLE:
        _write_study(read_results(folder / STORE), folder, "")
        return
    results = read_experiment(folder / STORE)
    settings = {name: each for name, each in json.loads(results.attrs["experiment"]).items() if name != "methods"}
    what = Experiment(**settings)
    with _progress("preparing recordings") as advance:
        prepared = prepared_recordings(what, advance)
    if {item.recorded.label: item.digest for item in prepared} != json.loads(results.attrs["data"]):
        errors.print(
            "[yellow]note:[/] the recordings are not there, or not as they were: exclusions.csv, prepared/ and the "
            "figures of recording and preparation stay as they are, and the page is without these figures",
            highlight=False,
            soft_wrap=True,
        )
        prepared = ()
    _write_experiment(what, results, prepared, folder, "")


@app.command()
def identify(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="MAT, CSV, TSV, NPZ, HDF5, NetCDF, Parquet or C3D file.")
    ],
    angle: Annotated[str, ANGLE],
    torque: Annotated[str, TORQUE],
    rate: Annotated[float, RATE],
    period: Annotated[float, PERIOD],
    decimate: DecimateOption = None,
    columns: ColumnsOption = Columns.contiguous,
    torque_sign: TorqueSignOption = 1,
    angle_unit: AngleUnitOption = AngleUnit.rad,
    start: StartOption = 0.0,
    context: ContextOption = 0.5,
    method: MethodOption = DEFAULT_METHODS,
    tune: Annotated[bool, typer.Option("--tune", help="Choose each method's settings from the data.")] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("tvsysid-identify"),
) -> None:
    """Identify stiffness over time from a recording.

    Reads angle and torque (`tvsysid inspect FILE` shows the names in a file), decimates, cuts the record into
    realizations of one period, subtracts the mean over realizations, and identifies by each method.

    A band holds the truth 95 times in 100 as far as noise goes; what a method smooths away is not in it.

    VAF is the share of the recorded torque that the model predicts for the very data it was identified from: a method
    with many parameters has a high one even where its stiffness is noise.

    Writes to the folder:

    - `stiffness.csv`: time_s, method, stiffness (N·m/rad), viscosity (N·m·s/rad) and inertia (kg·m²), each with its
    95 % band (`stiffness_lower`, `stiffness_upper`, …), and time_varying_vaf (%);

    - `models.nc`: all that was identified, a group for each method (NetCDF; `xarray.open_datatree` reads it);

    - `stiffness.png` and `.pdf`: the same over time, bands as shades;

    - with `--tune`, `tuning.csv`, `.png` and `.pdf`: the settings that were tried, and how each did.

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period 2 --torque-sign -1`
    """
    from threadpoolctl import threadpool_limits

    from tvsysid import preprocess
    from tvsysid.figures import identified_impedance, save
    from tvsysid.methods import Tuned, parse
    from tvsysid.metrics import time_varying_vaf, vaf
    from tvsysid.recordings import whole_file, write_models

    chosen = {label: parse(label) for label in dict.fromkeys(method)}
    _check_folder(out)
    with _shown_warnings():
        recording = _recording(file, angle, torque, rate, decimate, columns, torque_sign, angle_unit, start)
        if recording.sampling_rate > SLOW_RATE:
            errors.print(
                f"[yellow]note:[/] identifying at {recording.sampling_rate:g} Hz may take minutes; "
                "--decimate 100 is usual, and enough for a joint",
                highlight=False,
                soft_wrap=True,
            )
        ensemble = preprocess.subtract_mean(preprocess.segment(recording, period, context))
        output.print(f"{file.name}: {ensemble!r}", highlight=False)
        models: dict[str, Model] = {}
        bands: dict[str, dict[str, Any]] = {}
        tuned: dict[str, Method] = {}
        # Small matrices: BLAS threads would only wait for each other.
        with _progress("identifying") as advance, threadpool_limits(1):
            for number, (label, item) in enumerate(chosen.items()):
                advance(number, len(chosen))
                if tune or isinstance(item, Tuned):
                    tuned[label] = _tuned(label, item, ensemble)
                models[label] = _identified(label, tuned.get(label, item), ensemble)
                bands[label] = _bands_of(label, models[label])
    measured = ensemble.torque[:, ensemble.core]
    predictions = {label: model.predict(ensemble) for label, model in models.items()}
    over_time = {label: time_varying_vaf(measured, predicted) for label, predicted in predictions.items()}
    shares = {label: vaf(measured, predicted) for label, predicted in predictions.items()}
    with whole_file(out / "stiffness.csv") as table:
        _stiffness_table(models, bands, over_time).to_csv(table, index=False, float_format="%.6g")
    write_models(out / "models.nc", {label.replace("/", "_"): model for label, model in models.items()})
    title = f"{file.name}: {len(ensemble)} realizations of {period:g} s, with 95 % bands"
    figure = identified_impedance(models, bands, over_time, title)
    for ending in ("png", "pdf"):
        save(figure, out / f"stiffness.{ending}")
    output.print(_identification_table(models, bands, shares, ensemble))
    written = ["stiffness.csv", "models.nc", "stiffness.png", "stiffness.pdf"]
    if tuned:
        written += _write_tuning(tuned, out)
    _say_written(out, written)


@app.command()
def inspect(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="MAT (any version, with structures or nldat objects), CSV or TSV with a header line, NPZ, HDF5, "
            "NetCDF, Parquet (`tvsysid[parquet]`) or C3D (`tvsysid[c3d]`).",
        ),
    ],
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Picture to write, .png, .pdf or .svg. [tvsysid-inspect/FILE.png]"),
    ] = None,
    diagnose: Annotated[
        bool,
        typer.Option(
            "--diagnose",
            help="Also read and cut the recording as `tvsysid identify` does, and say what is wrong with it, before it "
            "is decimated. Takes the options below; --angle, --torque, --rate and --period are needed.",
        ),
    ] = False,
    angle: Annotated[str | None, ANGLE] = None,
    torque: Annotated[str | None, TORQUE] = None,
    rate: Annotated[float | None, RATE] = None,
    period: Annotated[float | None, PERIOD] = None,
    decimate: DecimateOption = None,
    columns: ColumnsOption = Columns.contiguous,
    torque_sign: TorqueSignOption = 1,
    angle_unit: AngleUnitOption = AngleUnit.rad,
    start: StartOption = 0.0,
    context: ContextOption = 0.5,
) -> None:
    """Show which channels a file holds, and with --diagnose what is wrong with a recording.

    Prints the name, shape and type of each, and unit and sampling rate where the file states them, and draws those
    that are signals, against time where the rate is stated and against samples where it is not. The names are what
    `--angle` and `--torque` of `tvsysid identify` take.

    With `--diagnose`, looks for what would spoil the result: units, signs, delays, lost or clipped signals, drift,
    misaligned realizations, a wrong period, feedback, reflexes; says what each does and what to do, and writes a page
    with pictures, `FILE.ANGLE-TORQUE.diagnosis.html` (the channels' names), beside the picture.

    Example: `tvsysid inspect ankle.mat`

    Example: `tvsysid inspect ankle.mat --plot ankle.pdf`

    Example: `tvsysid inspect ankle.mat --diagnose --angle pos --torque tq --rate 1000 --decimate 100 --period 2`
    """
    from threadpoolctl import threadpool_limits

    from tvsysid import preprocess
    from tvsysid.figures import recorded_channels, save
    from tvsysid.quality import diagnose as diagnosis_of
    from tvsysid.recordings import describe_file
    from tvsysid.report import write_diagnosis

    picture = plot or Path("tvsysid-inspect") / f"{file.name}.png"
    if picture.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(f"{picture}: unknown ending {picture.suffix!r}; give one of .png, .pdf, .svg")
    needed = {"--angle": angle, "--torque": torque, "--rate": rate, "--period": period}
    missing = [name for name, value in needed.items() if value is None]
    if diagnose and missing:
        raise InputError(f"--diagnose: {', '.join(missing)} missing; give them as to tvsysid identify")
    if not diagnose and len(missing) < len(needed):
        raise InputError(f"{next(name for name in needed if name not in missing)}: add --diagnose to have it used")
    channels = describe_file(file)
    table = Table(title=escape(file.name), title_justify="left")
    table.add_column("channel", overflow="fold")
    for heading in ("shape", "type", "unit", "rate (Hz)"):
        table.add_column(heading, overflow="fold", justify="right" if heading in ("shape", "rate (Hz)") else "left")
    for name, channel in channels.items():
        stated = "-" if channel.sampling_rate is None else f"{channel.sampling_rate:g}"
        shape = " x ".join(map(str, channel.shape)) or "one value"
        table.add_row(escape(name), shape, escape(channel.dtype), escape(channel.unit) or "-", stated)
    output.print(table)
    drawn = _outlines(channels)
    if drawn:
        save(recorded_channels(drawn, file.name), picture)
        output.print(f"wrote {picture}", highlight=False, soft_wrap=True)
    else:
        output.print("no signals to draw", highlight=False)
    if angle is None or torque is None or rate is None or period is None:
        return
    with _shown_warnings():
        recording = _recording(file, angle, torque, rate, None, columns, torque_sign, angle_unit, start)
        if decimate is not None:
            preprocess.decimate(recording, decimate)  # only to say if it cannot be done
        # Decimation would hide that a signal is clipped; what needs a low rate lowers it by itself.
        ensemble = preprocess.subtract_mean(preprocess.segment(recording, period, context))
    # Small matrices: BLAS threads would only wait for each other.
    with _waiting("diagnosing"), threadpool_limits(1):
        diagnosis = diagnosis_of(ensemble)
    # A file may hold several pairs of channels, each of which has a page of its own.
    page = picture.with_name(re.sub(r"[^\w.-]+", "_", f"{file.name}.{angle}-{torque}.diagnosis.html"))
    name = f"{file.name} ({angle}, {torque})"
    write_diagnosis(page, {name: diagnosis}, _command_line())
    _print_diagnosis(diagnosis, name)
    output.print(f"wrote {page}", highlight=False, soft_wrap=True)


@app.command()
def methods() -> None:
    """List the methods, what they assume, and their settings."""
    from rich.markup import escape

    from tvsysid.methods import clashes, describe, names

    table = Table(show_lines=True)
    for heading in ("key", "method", "assumes", "settings and defaults"):
        table.add_column(heading, overflow="fold")
    for key in names():
        try:
            title, assumptions, settings = describe(key)
        except InputError as error:
            table.add_row(escape(key), escape(str(error)))
            continue
        told = "\n".join(f"- {text}" for text in assumptions)
        table.add_row(*(escape(text) for text in (key, title, told, "\n".join(settings))))
    output.print(table)
    output.print(
        "Durations are in s, frequencies in Hz. Settings go behind the key: sds:window=0.2,max_lag=0.1\n"
        "kbr also takes preset=simulation (the default) or preset=experiment: the paper's settings for either study.\n"
        "A method of your own is module:Class or module:Class:setting=value; see tvsysid check-method --help.",
        highlight=False,
    )
    for text in clashes():
        errors.print(f"[yellow]note:[/] {escape(text)}", highlight=False, soft_wrap=True)


@app.command("check-method")
def check_method(
    name: Annotated[
        str,
        typer.Argument(
            metavar="MODULE:CLASS", help="Module in the current folder or installed, and the class in it; or any key."
        ),
    ],
) -> None:
    """Check a method of your own against all that is expected of a method.

    Lets it identify simulated joints, says in plain words what was expected and what came, and takes some seconds. The
    exit code is 0 if it passes all that is required, 1 if not, and 2 if it cannot be loaded.

    Example: `tvsysid check-method mymethod:SlidingFit`, or with settings `mymethod:SlidingFit:window=0.2`
    """
    checks = _checked_apart(name)
    for item in checks:
        sign = "[green]✓[/]" if item.passed else "[red]✗[/]" if item.required else "[yellow]✗[/]"
        advice = "" if item.required or item.passed else " (advice)"
        text = f"{sign} [bold]{escape(item.name)}[/]{advice}: {escape(item.message)}"
        output.print(text, highlight=False, soft_wrap=True)
    required, advised = (
        sum(1 for item in checks if not item.passed and item.required is kind) for kind in (True, False)
    )
    also = f"; {advised} of the advice given {'is' if advised == 1 else 'are'} not followed" if advised else ""
    if required:
        verdict = f"{name} does not pass: {required} of {len(checks)} checks failed or were not reached{also}"
    else:
        verdict = f"{name} passes{also}: enter it with tvsysid benchmark --method {name}"
    output.print(escape(verdict), highlight=False, soft_wrap=True)
    if required:
        raise typer.Exit(1)


@app.command()
def simulate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write: .mat, .csv or .tsv.")],
    stiffness: Annotated[Profile, typer.Option(help="Stiffness profile.")] = Profile.square,
    perturbation: Annotated[Perturbation, typer.Option(help="Angular perturbation.")] = Perturbation.noise,
    duration: Annotated[float, typer.Option(metavar="S", help="Seconds of data.")] = 150.0,
    snr: Annotated[
        float, typer.Option("--snr", metavar="DB", help="Signal-to-noise ratio of the torque in dB; inf for no noise.")
    ] = 10.0,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed.")] = 0,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Sampling rate.")] = 1000.0,
    participant: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Write the ten trials of the virtual participant with this number instead, to a .mat file that "
            "`tvsysid experiment` reads; of the options, --perturbation alone applies.",
        ),
    ] = None,
) -> None:
    """Write a simulated recording that `tvsysid identify` reads, or a virtual participant's trials.

    The file holds `angle` (rad), `torque` (N·m, with noise), and the truth: `noiseless_torque` (N·m) and
    `stiffness` (N·m/rad). The behaviour repeats every 2 s. A participant's file has a column for each trial of 70 s at
    1024 Hz, and besides `target` (N·m), the torque to be followed.

    Example: `tvsysid simulate joint.mat && tvsysid identify joint.mat --angle angle --torque torque --rate 1000
    --decimate 100 --period 2`

    Example: `tvsysid simulate P1-noise.mat --participant 1`
    """
    from tvsysid.recordings import write_simulation
    from tvsysid.simulate import PERTURBATIONS, PROFILES, Joint

    if participant is not None:
        _write_participant(file, participant, perturbation.value)
        return
    simulation = Joint(stiffness=PROFILES[stiffness.value]).simulate(
        duration, perturbation=PERTURBATIONS[perturbation.value], snr_db=snr, seed=seed, rate=rate
    )
    recording = simulation.recording
    first = round(-recording.start * rate)
    inner = slice(first, first + round(duration * rate))
    columns = {
        "angle": recording.angle[inner],
        "torque": recording.torque[inner],
        "noiseless_torque": simulation.noiseless.torque[inner],
        "stiffness": simulation.truth["stiffness"][inner],
    }
    write_simulation(file, columns, rate)
    decimate = " --decimate 100" if rate > 100 and rate % 100 == 0 else ""
    output.print(
        f"wrote {file}: {duration:g} s at {rate:g} Hz; identify it with\n"
        f"tvsysid identify {file} --angle angle --torque torque --rate {rate:g}{decimate} --period 2",
        highlight=False,
        soft_wrap=True,
    )


def _write_participant(file: Path, number: int, perturbation: str) -> None:
    from tvsysid.recordings import write_simulation
    from tvsysid.simulate import participant

    if file.suffix.lower() != ".mat":
        raise InputError(f"{file}: a participant's trials are matrices; give a file that ends in .mat")
    trials = getattr(participant(number), perturbation)
    recording = trials.recording
    signals = {
        "angle": recording.angle,
        "torque": recording.torque,
        "target": recording.channels["target"],
        "stiffness": trials.stiffness,
    }
    count = len(recording.trials)
    columns = {name: values.reshape(count, -1).T for name, values in signals.items()}
    write_simulation(file, columns, recording.sampling_rate)
    output.print(
        f"wrote {file}: angle, torque, target and the true stiffness, {count} trials of "
        f"{recording.duration / count:g} s at {recording.sampling_rate:g} Hz, a column each; a study of it:\n"
        f'\n[participants.P{number}]\n{perturbation} = "{file}"\n\n[reading]\nangle = "angle"\ntorque = "torque"\n'
        f'sampling_rate = {recording.sampling_rate:g}\ncolumns = "trials"\n',
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def main() -> None:
    """Run the command line; what the user can mend is one line on standard error, with exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a character shows another in its place
            stream.reconfigure(errors="replace")
    # What ends a job on a cluster ends it as cleanly as a key.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with suppress(OSError):  # the current folder may be gone
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # at the end, so that no file in it hides a module
    try:
        code = app(prog_name="tvsysid", standalone_mode=False)
    except InputError as error:
        _stop(str(error))
    except OSError as error:
        _stop(f"{error.filename or 'output'}: {error.strerror or error}; give another file or folder")
    except MemoryError:
        _stop("there is not enough memory for this; give a shorter duration, fewer trials or a lower rate")
    except Exception as error:
        # Usage errors come from the parser that typer carries within; they know how to say what is wrong.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        _stop(f"{message()} (see tvsysid --help)")
    else:
        if code == INTERRUPTED:
            errors.print(
                "tvsysid: interrupted; a file that is there is whole, the others were not written", highlight=False
            )
        sys.exit(code if isinstance(code, int) else 0)


def _stop(message: str) -> None:
    errors.print(f"tvsysid: {' '.join(message.split())}", highlight=False, markup=False, soft_wrap=True)
    sys.exit(2)


def _check_folder(out: Path) -> None:
    """Find out now, not after the work, whether the folder can be written to."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: a file is in the way; give a folder with --out")
    out.mkdir(parents=True, exist_ok=True)
    if not os.access(out, os.W_OK):
        raise InputError(f"{out}: this folder cannot be written to; give another with --out")


@contextmanager
def _progress(title: str) -> Iterator[Any]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    shown = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*shown, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task(title, total=None, rate="")

        def advance(done: int, total: int) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, rate=f"{speed:.1f}/s" if speed else "")

        yield advance


@contextmanager
def _waiting(title: str) -> Iterator[None]:
    """Show that something goes on whose end is not known."""
    if errors.is_terminal:
        with errors.status(title):
            yield
    else:
        yield


def _command_line() -> str:
    """The command as it may be typed again."""
    return shlex.join(["tvsysid", *sys.argv[1:]])


@contextmanager
def _shown_warnings() -> Iterator[None]:
    """Print the package's warnings as one line each when the block ends, however it ends."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            yield
        finally:
            for text in dict.fromkeys(str(warning.message) for warning in caught):
                errors.print(f"[yellow]warning:[/] {text}", highlight=False, soft_wrap=True)


def _print_plan(study: Any, workers: int) -> None:
    from tvsysid.benchmark import plan

    with _waiting("timing a trial of the shortest and the longest scenario"):
        taken = plan(study)
    table = Table(title="the study", title_justify="left")
    for heading in ("stiffness", "perturbation", "duration (s)", "SNR (dB)", "viscosity"):
        table.add_column(heading)
    for scenario in study.scenarios:
        table.add_row(
            scenario.stiffness,
            scenario.perturbation,
            f"{scenario.duration_s:g}",
            f"{scenario.snr_db:g}",
            scenario.viscosity,
        )
    output.print(table)
    output.print(
        f"methods: {', '.join(study.named_methods)}\n"
        f"{study.trials} trials of each of {len(study.scenarios)} scenarios, seed {study.seed}: {taken.trials} trials, "
        f"{taken.simulated_s:,.0f} s of data\n"
        f"about {_duration(taken.work_s / workers)} with {workers} process{'es' if workers > 1 else ''}, beside the "
        f"start and the figures, and {taken.size_bytes / 1e6:,.1f} MB of results; nothing was run",
        highlight=False,
        soft_wrap=True,
    )
    for label, reason in taken.failures.items():
        errors.print(f"[red]error:[/] {escape(f'{label} fails: {reason}')}", highlight=False, soft_wrap=True)


def _run_study(study: Any, out: Path, workers: int | None, scheduler: str | None) -> Any:
    """Results, with progress; what ends it early says how to go on."""
    from tvsysid.benchmark import run

    count = len(study.scenarios)
    title = f"{count} scenario{'s' if count > 1 else ''} x {study.trials} trials x {len(study.methods)} methods"

    def go(advance: Any, executor: Any, at_a_time: int | None) -> Any:
        return run(study, store=out / STORE, workers=at_a_time, executor=executor, progress=advance)

    return _going_on(go, title, "trials", out, workers, scheduler)


def _going_on(
    go: Callable[[Any, Any, int | None], Any],
    title: str,
    what: str,
    out: Path,
    workers: int | None,
    scheduler: str | None,
) -> Any:
    """What a run returns, with its progress shown; where it ends early, how to go on."""
    kept = [0, 0]
    try:
        with _progress(title) as advance, _executor(scheduler) as (executor, threads):

            def count_kept(done: int, total: int) -> None:
                if done and not kept[1]:
                    errors.print(f"going on: {done} of {total} {what} are there already", highlight=False)
                kept[:] = done, total
                advance(done, total)

            return go(count_kept, executor, threads if workers is None else workers)
    except KeyboardInterrupt:
        errors.print(
            f"tvsysid: interrupted; {kept[0]} of {kept[1]} {what} are in {out / STORE}, the same command goes on",
            highlight=False,
            soft_wrap=True,
        )
        sys.exit(INTERRUPTED)
    except OSError as error:
        raise InputError(
            f"{error.filename or out}: {error.strerror or error}; {kept[0]} of {kept[1]} {what} are kept: once this is "
            "mended, the same command goes on from there"
        ) from error


def _run_experiment(experiment: Any, out: Path, workers: int | None, scheduler: str | None) -> tuple[Any, Any]:
    """Results and what they are of, with progress; what ends it early says how to go on."""
    from tvsysid.experiment import prepared_recordings, run

    with _progress("preparing recordings") as advance:
        prepared = prepared_recordings(experiment, advance)
    for item in prepared:
        for text in item.remarks:
            sign = "[red]error:[/]" if text == item.failure else "[yellow]warning:[/]"
            errors.print(f"{sign} {escape(f'{item.recorded.label}: {text}')}", highlight=False, soft_wrap=True)
    if all(item.failure for item in prepared):
        raise InputError("no recording can be used; mend what is said above")

    def go(advance: Any, executor: Any, at_a_time: int | None) -> Any:
        return run(
            experiment,
            prepared=prepared,
            store=out / STORE,
            workers=at_a_time,
            executor=executor,
            progress=advance,
        )

    title = (
        f"{len(experiment.recordings)} recordings x {len(experiment.analyses)} analyses x "
        f"{experiment.bootstraps} bootstraps"
    )
    with _shown_warnings():
        return _going_on(go, title, "analyses", out, workers, scheduler), prepared


def _checked_apart(name: str) -> list[Check]:
    """Checks of a method in a process of its own, which it may end."""
    from concurrent.futures import BrokenExecutor

    from tvsysid.execution import processes
    from tvsysid.methods import parse

    parse(name)  # what is wrong with the name is told from here
    with processes(1) as pool:
        try:
            return pool.submit(_checks_of, name).result()
        except BrokenExecutor as error:
            raise InputError(
                f"method {name}: it ends the whole process, as os._exit or a crash in compiled code does; a method "
                "must return a model, or raise an error"
            ) from error


def _checks_of(name: str) -> list[Check]:
    from tvsysid.check import check_method as check
    from tvsysid.methods import parse

    return check(parse(name))


@contextmanager
def _executor(scheduler: str | None) -> Iterator[tuple[Any, int | None]]:
    """Executor of a Dask cluster and the number of its threads, or None twice."""
    if scheduler is None:
        yield None, None
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs Dask: pip install 'tvsysid[dask]'") from error
    try:
        client: Any = Client(scheduler, timeout="10s")  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--scheduler {scheduler}: no Dask scheduler answers there: {error}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"--scheduler {scheduler}: this cluster has no workers; start some with `dask worker`")
        yield client.get_executor(pure=False), threads


def _write_study(results: Any, out: Path, command: str) -> bool:
    """Write tables, figures and report, and print the essence; whether every method gave a result in every trial."""
    from tvsysid.benchmark import example_responses, judge, score, summarize
    from tvsysid.figures import save, study_figures
    from tvsysid.recordings import whole_file
    from tvsysid.report import write_report

    with _waiting("scoring and drawing"):
        for name in ("seconds", "stage_seconds", "doubts", "failure", "checksums"):
            results[name].load()  # small, and needed more than once
        scores = score(results)
        summary, claims = summarize(scores), judge(scores)
        for name, table in (("summary.csv", summary), ("claims.csv", claims)):
            with whole_file(out / name) as file:
                table.to_csv(file, index=False, float_format="%.6g")
        square = bool((results.profile == "square").any())
        seed = json.loads(results.attrs["study"])["seed"]
        illustrations = study_figures(results, summary, example_responses(seed) if square else None)
        for name, item in illustrations.items():
            for ending in ("png", "pdf", "svg"):
                save(item.figure, out / "figures" / f"{name}.{ending}")
        write_report(out / "report.html", results, summary, claims, illustrations, command)
    labels = list(dict.fromkeys(summary.scenario))
    for label in labels[:MOST_TABLES]:
        output.print(_benchmark_table(summary[summary.scenario == label]))
    if len(labels) > MOST_TABLES:
        output.print(f"and {len(labels) - MOST_TABLES} more scenarios in summary.csv and report.html", highlight=False)
    if (claims.verdict != "not studied").any():
        output.print(_claims_table(claims))
    output.print(_time_table(results))
    complete = _print_troubles(results)
    _say_written(out, ["report.html", "summary.csv", "claims.csv", f"figures/ ({len(illustrations)})", STORE])
    return complete


def _write_experiment(experiment: Any, results: Any, prepared: Any, out: Path, command: str) -> bool:
    """Write tables, ensembles, figures and report, and print the essence; whether every analysis gave a result."""
    import pandas as pd

    from tvsysid.experiment import exclusions, judge, stiffness_over_time, summarize
    from tvsysid.quality import diagnose
    from tvsysid.recordings import whole_file, write_ensemble
    from tvsysid.report import experiment_troubles, write_diagnosis, write_experiment_report

    with _waiting("scoring and drawing"):
        results = results.load()
        summary, claims = summarize(results), judge(results)
        tables = {"summary.csv": summary, "claims.csv": claims, "stiffness.csv": stiffness_over_time(results)}
        kept = out / "exclusions.csv"
        if prepared or not kept.is_file():
            excluded = tables["exclusions.csv"] = exclusions(prepared)
        else:
            excluded = pd.read_csv(kept, keep_default_na=False, na_values={"reached": [""], "limit": [""]})
        for name, table in tables.items():
            with whole_file(out / name) as file:
                table.to_csv(file, index=False, float_format="%.6g")
        for item in prepared:
            if item.ensemble is not None:
                write_ensemble(out / "prepared" / f"{item.recorded.label}.nc", item.ensemble)
        illustrations = _experiment_pictures(experiment, results, summary, prepared, out / "figures")
        diagnoses = {item.recorded.label: diagnose(item.ensemble) for item in prepared if item.ensemble is not None}
        if diagnoses:
            write_diagnosis(out / "diagnosis.html", diagnoses, command)
        write_experiment_report(out / "report.html", results, summary, claims, excluded, illustrations, command)
    for perturbation in dict.fromkeys(summary.perturbation):
        output.print(_experiment_table(summary[summary.perturbation == perturbation], str(perturbation)))
    output.print(_recordings_table(results))
    if claims.verdict.isin(["holds", "does not hold"]).any():
        output.print(_claims_table(claims, "experiment"))
    labels = set(results.recording.values.tolist())  # those that failed altogether were told before
    met = [trouble for trouble in experiment_troubles(results) if trouble["method"] not in labels]
    complete = _print_met(results, met, "analyses", "recordings") and not any(item.failure for item in prepared)
    for label, diagnosis in diagnoses.items():
        if diagnosis.findings:
            found = ", ".join(finding.name for finding in diagnosis.findings)
            text = f"{label}: {found}: what it does to the result, and what to do, is in diagnosis.html"
            errors.print(f"[yellow]warning:[/] {escape(text)}", highlight=False, soft_wrap=True)
    pages = ["report.html", *(["diagnosis.html"] if diagnoses else [])]
    names = [*pages, *tables, "prepared/", f"figures/ ({len(illustrations)})", STORE]
    _say_written(out, names)
    return complete


def _experiment_pictures(experiment: Any, results: Any, summary: Any, prepared: Any, folder: Path) -> Any:
    """Draw and save everything; those of the page, by the stems of their files."""
    from tvsysid.experiment import shown
    from tvsysid.figures import experiment_figures, participant_in_detail, representative, save

    excerpts, preparations = {}, {}
    who = representative(results, summary)
    for item in prepared:
        if item.recorded.participant == who and item.ensemble is not None:
            with suppress(InputError):  # a file that is gone since
                excerpts[item.recorded.label], preparations[item.recorded.label] = shown(experiment, item.recorded)
    illustrations = experiment_figures(results, summary, excerpts, preparations)
    for name, each in illustrations.items():
        for ending in ("png", "pdf", "svg"):
            save(each.figure, folder / f"{name}.{ending}")
    drawn = {who: illustrations["participant"].figure}
    for participant in dict.fromkeys(results.participant.values.tolist()):
        title = f"Participant {participant} in detail"
        figure = drawn.get(participant) or participant_in_detail(results, participant, title)
        for ending in ("png", "pdf"):
            save(figure, folder / "participants" / f"{participant}.{ending}")
    return illustrations


def _experiment_table(rows: pd.DataFrame, perturbation: str) -> Table:
    """Main figures under one perturbation, mean and standard deviation over participants."""
    shown = {
        "mean_stiffness": "stiffness\n(N·m/rad)",
        "random_error": "random\n(N·m/rad)",
        "mean_bias": "bias\n(N·m/rad)",
        "vaf": "VAF\n(%)",
        "bandpassed_vaf": "VAF 1-10 Hz\n(%)",
    }
    known = rows[(rows.metric == "vaf") & rows.value.notna()]
    people = known.participant.nunique()
    spread = ", mean ± SD over participants" if people > 1 else ""
    table = Table(
        title=f"{perturbation}: {people} participant{'s' if people > 1 else ''}{spread}", title_justify="left"
    )
    table.add_column("method", overflow="fold")
    table.add_column("drawn", justify="right")
    present = [name for name in shown if (rows.metric == name).any()]
    for name in present:
        table.add_column(shown[name], justify="right")
    for (method, count), group in rows.groupby(["method", "realizations"], sort=False):
        texts = []
        for name in present:
            values = group.value[group.metric == name].dropna()
            deviation = f"±{values.std():.1f}" if len(values) > 1 else ""
            texts.append(f"{values.mean():.1f}{deviation}" if len(values) else "-")
        table.add_row(escape(str(method)), str(count), *texts)
    return table


def _recordings_table(results: Any) -> Table:
    """What became of the realizations of each recording."""
    table = Table(title="realizations", title_justify="left")
    table.add_column("recording", overflow="fold")
    names = {
        "recorded": "recorded",
        "excluded_alignment": "shifted\ntoo far",
        "excluded_task": "task\ncomponent",
        "excluded_residual": "residual",
        "survivors": "kept",
        "trials_left_out": "trials\nleft out",
    }
    for heading in names.values():
        table.add_column(heading, justify="right")
    for number, label in enumerate(results.recording.values[:MOST_RECORDINGS]):
        table.add_row(escape(str(label)), *(str(int(results[name].values[number])) for name in names))
    if results.sizes["recording"] > MOST_RECORDINGS:
        table.caption = f"and {results.sizes['recording'] - MOST_RECORDINGS} more in report.html"
    return table


def _print_troubles(results: Any) -> bool:
    """Print doubts, failures and missing trials; whether no method failed."""
    from tvsysid.report import troubles

    return _print_met(results, troubles(results), "trials", "trials")


def _print_met(results: Any, met: list[dict[str, Any]], units: str, counted: str) -> bool:
    """Print what was met and what is missing; whether no method failed."""
    there = results.checksums.values.any(axis=-1)
    if not there.all():
        text = f"{there.sum()} of {there.size} {units} are there so far; the command that ran it goes on from there"
        errors.print(f"[yellow]warning:[/] {text}", highlight=False, soft_wrap=True)
    said = {
        "doubtful": ("[yellow]warning:[/]", "deserve doubt"),
        "failed": ("[red]error:[/]", "failed and are left out"),
    }
    for trouble in met:
        sign, what = said[trouble["kind"]]
        text = "{method}: {count} of {trials} {counted} {what}; the first: {first}".format(
            what=what, counted=counted, **trouble
        )
        errors.print(f"{sign} {escape(text)}", highlight=False, soft_wrap=True)
    return not any(trouble["kind"] == "failed" for trouble in met)


def _scenario_title(row: Any) -> str:
    profile = {"square": "square wave", "sine": "sine wave", "constant": "constant"}[row.stiffness]
    perturbation = {"noise": "filtered noise", "prbs": "PRBS"}[row.perturbation]
    repeats = "1 trial" if row.trials == 1 else f"{row.trials} trials"
    covarying = ", viscosity covarying" if row.viscosity == "covarying" else ""
    return f"{profile}, {perturbation}, {row.duration_s:g} s, {row.snr_db:g} dB{covarying}, {repeats}"


def _benchmark_table(rows: pd.DataFrame) -> Table:
    """Main metrics of one scenario."""
    shown = {
        "bias_error": ("bias\n(N·m/rad)", "{:.1f}"),
        "random_error": ("random\n(N·m/rad)", "{:.1f}"),
        "total_error": ("total\n(N·m/rad)", "{:.1f}"),
        "rise_time": ("rise\n(s)", "{:.2f}"),
        "vaf": ("VAF\n(%)", "{:.1f}"),
        "bandpassed_vaf": ("VAF 1-10 Hz\n(%)", "{:.1f}"),
        "seconds": ("time\n(ms)", "{:.0f}"),
    }
    present = [name for name in shown if (rows.metric == name).any()]
    most: Any = rows.iloc[int(rows.trials.argmax())]
    table = Table(title=_scenario_title(most), title_justify="left")
    table.add_column("method", overflow="fold")
    for name in present:
        table.add_column(shown[name][0], justify="right")
    for method, group in rows.groupby("method", sort=False):
        values = dict(zip(group.metric, group.value, strict=True))
        values["seconds"] *= 1000
        if most.trials == 1:
            values["random_error"] = float("nan")  # one trial has no spread
        texts = [shown[name][1].format(values[name]) if values[name] == values[name] else "-" for name in present]
        table.add_row(escape(str(method)), *texts)
    return table


def _claims_table(claims: pd.DataFrame, of: str = "simulations") -> Table:
    table = Table(title=f"what the paper says of its {of}", title_justify="left")
    table.add_column("claim", overflow="fold")
    table.add_column("verdict", overflow="fold")
    symbols = {"holds": "✓", "does not hold": "✗", "undecided": "?"}
    studied = claims[claims.verdict != "not studied"]
    for claim, verdict in zip(studied.claim.astype(str), studied.verdict.astype(str), strict=True):
        table.add_row(claim, f"{symbols[verdict]} {verdict}")
    if len(studied) < len(claims):
        need = "other scenarios: --preset paper, snr, viscosity" if of == "simulations" else "what the report says"
        table.caption = f"{len(claims) - len(studied)} more of its claims need {need}"
    return table


def _time_table(results: Any) -> Table:
    """Where the time of the trials went, and how much data each stage gets through."""
    from tvsysid.benchmark import time_spent

    there = results.checksums.values.any(axis=-1)
    simulated = float((results.duration_s.values * there.sum(axis=1)).sum())
    spent = time_spent(results)
    total = sum(spent.values())
    table = Table(title=f"where the time went: {_duration(total)} in all workers", title_justify="left")
    table.add_column("stage", overflow="fold")
    for heading in ("time (s)", "share (%)", "simulated s per s"):
        table.add_column(heading, justify="right")
    for name, seconds in spent.items():
        rate = f"{simulated / seconds:,.0f}" if seconds else "-"
        table.add_row(escape(name), f"{seconds:.1f}", f"{100 * seconds / total if total else 0:.0f}", rate)
    return table


def _duration(seconds: float) -> str:
    minutes = seconds / 60
    return f"{seconds:.0f} s" if minutes < 2 else f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"


def _identified(label: str, method: Any, ensemble: Ensemble) -> Model:
    """Model, whoever's the method is; an error of somebody else's is told with its place."""
    from tvsysid.errors import describe_error
    from tvsysid.methods import adopted

    try:
        return adopted(method.identify(ensemble), label, ensemble)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"method {label}: {describe_error(error)}") from error


def _tuned(label: str, method: Any, ensemble: Ensemble) -> Method:
    """Method with settings chosen from the data."""
    from tvsysid.methods import Method, Tuned

    if isinstance(method, Tuned):
        method = method.method
    if not isinstance(method, Method):
        raise InputError(
            f"--tune: settings of {label} cannot be chosen from data; leave out --tune, and write key:tuned=true for "
            "those methods whose settings can"
        )
    return method.tuned(ensemble)


def _write_tuning(tuned: dict[str, Method], out: Path) -> list[str]:
    """Print what was chosen, and write all that was tried; names of the files."""
    import pandas as pd

    from tvsysid.figures import save, tuning_curves
    from tvsysid.methods import typed
    from tvsysid.recordings import whole_file

    evidence = {label: method.evidence for label, method in tuned.items() if method.evidence is not None}
    for label, item in evidence.items():
        output.print(f"{label}: {item}", highlight=False, soft_wrap=True, markup=False)
    again = " ".join(f"--method {shlex.quote(typed(method))}" for method in tuned.values())
    output.print(f"the same again: {again}", highlight=False, soft_wrap=True, markup=False)
    tables = []
    for label, item in evidence.items():
        table = item.to_pandas()
        table.insert(0, "method", label)
        tables.append(table)
    with whole_file(out / "tuning.csv") as file:
        pd.concat(tables, ignore_index=True).to_csv(file, index=False, float_format="%.6g")
    figure = tuning_curves(evidence)
    for ending in ("png", "pdf"):
        save(figure, out / f"tuning.{ending}")
    return ["tuning.csv", "tuning.png", "tuning.pdf"]


def _bands_of(label: str, model: Model) -> dict[str, Any]:
    """Lower and upper 95 % band of each quantity; that a method that tells of its random error has none is told."""
    error = model.random_error
    if error is not None and error.absent:
        warnings.warn(f"{label}: no band: {error.absent}", DataQualityWarning, stacklevel=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return {
            "stiffness": model.stiffness_band(),
            "viscosity": model.viscosity_band(),
            "inertia": model.inertia_band(),
        }


def _identification_table(
    models: dict[str, Model], bands: dict[str, dict[str, Any]], shares: dict[str, Any], ensemble: Ensemble
) -> Table:
    import numpy as np

    title = f"stiffness, inertia and VAF: {len(ensemble)} realizations of {ensemble.duration:g} s"
    table = Table(title=title, title_justify="left")
    table.add_column("method", overflow="fold")
    for heading in (
        "mean\n(N·m/rad)",
        "95 % band\n(N·m/rad)",
        "lowest, at\n(N·m/rad,s)",
        "highest, at\n(N·m/rad,s)",
        "inertia\n(kg·m²)",
        "VAF\n(%)",
    ):
        table.add_column(heading, justify="right")
    for label, model in models.items():
        stiffness, time = model.stiffness, model.time
        extremes = []
        for place in (np.nanargmin(stiffness), np.nanargmax(stiffness)):
            extremes.append(f"{stiffness[place]:.1f}, {time[place]:.2f}")
        lower, upper = bands[label]["stiffness"]
        width = (upper - lower) / 2
        known = model.inertia[np.isfinite(model.inertia)]
        table.add_row(
            label,
            f"{np.nanmean(stiffness):.1f}",
            f"± {np.nanmean(width):.1f}" if np.isfinite(width).any() else "-",
            *extremes,
            f"{known.mean():.4f}" if len(known) else "-",
            f"{np.nanmean(shares[label]):.1f}",
        )
    return table


def _recording(
    file: Path,
    angle: str,
    torque: str,
    rate: float,
    decimate: float | None,
    columns: Columns,
    torque_sign: int,
    angle_unit: AngleUnit,
    start: float,
) -> Recording:
    """Recording as the options say, decimated if they say so."""
    from tvsysid import preprocess
    from tvsysid.recordings import read_recording

    recording = read_recording(
        file,
        angle=angle,
        torque=torque,
        sampling_rate=rate,
        angle_unit=angle_unit.value,
        torque_sign=-1 if torque_sign == -1 else 1 if torque_sign == 1 else torque_sign,  # type: ignore[arg-type]
        columns=columns.value,
        start=start,
    )
    return recording if decimate is None else preprocess.decimate(recording, decimate)


def _print_diagnosis(diagnosis: Diagnosis, name: str) -> None:
    output.print(escape(f"{name}: {diagnosis.ensemble}: {diagnosis.verdict}"), highlight=False, soft_wrap=True)
    for check in diagnosis.findings:
        lines = f"  seen: {check.what}\n  does: {check.fault.effect}\n  do:   {check.fault.remedy}"
        output.print(f"[bold]{check.name}[/] ({check.strength})\n{escape(lines)}", highlight=False, soft_wrap=True)
    for line in diagnosis.notes:
        output.print(escape(line), highlight=False, soft_wrap=True)


def _outlines(channels: dict[str, Any]) -> dict[str, Any]:
    """What is drawn of a file: the first of its signals that fit in memory, and of each at most so many columns."""
    import numpy as np

    from tvsysid.recordings import outline

    drawn: dict[str, Any] = {}
    signals = {
        name: channel
        for name, channel in channels.items()
        if channel.values is not None
        and len(channel.shape) in (1, 2)
        and max(channel.shape) > 1
        and 0 not in channel.shape
    }
    for name, channel in signals.items():
        if len(drawn) == MOST_DRAWN:
            text = f"{len(signals) - MOST_DRAWN} more channels are not drawn"
            errors.print(f"[yellow]note:[/] {text}", highlight=False)
            break
        try:
            values = channel.read(name)
        except InputError as error:
            errors.print(f"[yellow]note:[/] not drawn: {escape(str(error))}", highlight=False, soft_wrap=True)
            continue
        if np.iscomplexobj(values):
            continue
        values = values.ravel() if min(values.shape) == 1 else values
        columns = [values] if values.ndim == 1 else list(values.T[:MOST_COLUMNS])
        drawn[name] = (channel, [outline(np.asarray(column, dtype=float)) for column in columns])
    return drawn


def _stiffness_table(
    models: dict[str, Model], bands: dict[str, dict[str, Any]], over_time: dict[str, Any]
) -> pd.DataFrame:
    import pandas as pd

    tables = []
    for label, model in models.items():
        columns = {"time_s": model.time, "method": label}
        for name, (lower, upper) in bands[label].items():
            columns |= {name: getattr(model, name), f"{name}_lower": lower, f"{name}_upper": upper}
        tables.append(pd.DataFrame(columns | {"time_varying_vaf": over_time[label]}))
    return pd.concat(tables, ignore_index=True)


def _say_written(out: Path, names: list[str]) -> None:
    output.print(f"wrote {', '.join(names)} to {out}/", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
