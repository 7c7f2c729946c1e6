"""The command line: parses, calls, prints; no science."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from tvsysid.errors import DoubtfulWarning, InputError

if TYPE_CHECKING:
    import pandas as pd

    from tvsysid.models import Model
    from tvsysid.signals import Ensemble

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
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
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
    stiffness: Annotated[list[Profile], typer.Option(help="Stiffness profile of the simulated joint; repeatable.")] = [
        Profile.square
    ],
    perturbation: Annotated[list[Perturbation], typer.Option(help="Angular perturbation; repeatable.")] = [
        Perturbation.noise,
        Perturbation.prbs,
    ],
    duration: Annotated[
        list[float], typer.Option(metavar="S", help="Seconds of data, a whole number of 2-s realizations; repeatable.")
    ] = [150.0],
    snr: Annotated[
        list[float], typer.Option("--snr", metavar="DB", help="Signal-to-noise ratio of the torque in dB; repeatable.")
    ] = [10.0],
    method: MethodOption = DEFAULT_METHODS,
    trials: Annotated[int, typer.Option(metavar="N", help="Monte-Carlo trials of each scenario.")] = 20,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed; the same seed gives the same numbers.")] = 0,
    workers: Annotated[
        int | None, typer.Option(metavar="N", help="Processes; as many as there are cores by default.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("tvsysid-benchmark"),
) -> None:
    """Compare methods on simulated data with known stiffness.

    Simulates a joint (inertia 0.02 kg·m², viscosity 2.2 N·m·s/rad) whose stiffness follows the profile, lets every
    method identify the same data, and scores them against the truth, as van de Ruit et al. (2021) do: bias (error of
    the mean over trials), random error (spread about that mean), total error (both), rise time (from 10 to 90 % of the
    step), VAF (share of the noiseless torque that the model predicts), and VAF after a 1-10 Hz band-pass.

    Writes to the folder:

    - `summary.csv`: a row for each scenario, method and metric, with its value and unit;

    - `results.nc`: stiffness and VAF of every trial (NetCDF; open it with xarray);

    - `stiffness-PROFILE-PERTURBATION-….png` and `.pdf`: stiffness and time-varying VAF, mean ± 2 SD.

    Example: `tvsysid benchmark --method sds --method sds:window=0.2 --trials 50`
    """
    from tvsysid.benchmark import Study, run, summarize
    from tvsysid.figures import method_comparison, save
    from tvsysid.recordings import whole_file

    study = Study(
        stiffness=[str(item) for item in stiffness],
        perturbation=[str(item) for item in perturbation],
        duration_s=duration,
        snr_db=snr,
        methods=method,
        trials=trials,
        seed=seed,
    )
    _check_folder(out)
    count = sum(1 for _ in study.scenarios)
    with _progress(f"{count} scenarios x {trials} trials x {len(method)} methods") as advance:
        results = run(study, workers=workers, progress=advance)
    summary = summarize(results)
    with whole_file(out / "summary.csv") as file:
        summary.to_csv(file, index=False, float_format="%.6g")
    with whole_file(out / "results.nc") as file:
        results.to_netcdf(file, engine="h5netcdf")
    written = ["summary.csv", "results.nc"]
    for scenario in study.scenarios:
        cell = {
            "profile": scenario.stiffness,
            "perturbation": scenario.perturbation,
            "duration_s": scenario.duration_s,
            "snr_db": scenario.snr_db,
        }
        name = f"stiffness-{scenario.stiffness}-{scenario.perturbation}-{scenario.duration_s:g}s-{scenario.snr_db:g}dB"
        title = _scenario_title(scenario, trials)
        output.print(_benchmark_table(summary, cell, title))
        figure = method_comparison(results.sel(cell), title)
        for ending in ("png", "pdf"):
            save(figure, out / f"{name}.{ending}")
        written += [f"{name}.png", f"{name}.pdf"]
    for label in results.method_key.values:
        told = [text for text in results.doubts.sel(method_key=label).values.ravel() if text]
        if told:
            count = results.doubts.sel(method_key=label).size
            text = f"{label}: {len(told)} of {count} trials deserve doubt; the first: {told[0]}"
            errors.print(f"[yellow]warning:[/] {text}", highlight=False, soft_wrap=True)
    _say_written(out, written)


@app.command()
def identify(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="MAT (version 5 or 7), CSV or TSV file.")],
    angle: Annotated[str, typer.Option(metavar="NAME", help="Variable or column that holds the angle.")],
    torque: Annotated[str, typer.Option(metavar="NAME", help="Variable or column that holds the torque, in N·m.")],
    rate: Annotated[float, typer.Option(metavar="HZ", help="Sampling rate of the file.")],
    period: Annotated[float, typer.Option(metavar="S", help="Duration of one realization of the behaviour.")],
    decimate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Low-pass and decimate to this rate first; 100 Hz is usual, and much faster."),
    ] = None,
    columns: Annotated[
        Columns,
        typer.Option(help="Whether the columns of a matrix follow each other in time or are trials of their own."),
    ] = Columns.contiguous,
    torque_sign: Annotated[
        int, typer.Option(metavar="1|-1", help="-1 if the file's torque assists where it should resist.")
    ] = 1,
    angle_unit: Annotated[AngleUnit, typer.Option(help="Unit of the angle in the file.")] = AngleUnit.rad,
    start: Annotated[
        float,
        typer.Option(metavar="S", help="Time of the first sample; realizations begin at multiples of the period."),
    ] = 0.0,
    context: Annotated[
        float,
        typer.Option(metavar="S", help="Record kept beside each realization, for lags and windows at its edges."),
    ] = 0.5,
    method: MethodOption = DEFAULT_METHODS,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("tvsysid-identify"),
) -> None:
    """Identify stiffness over time from a recording.

    Reads angle and torque, decimates, cuts the record into realizations of one period, subtracts the mean over
    realizations, and identifies by each method.

    VAF is the share of the recorded torque that the model predicts for the very data it was identified from: a method
    with many parameters has a high one even where its stiffness is noise.

    Writes to the folder:

    - `stiffness.csv`: time_s, method, stiffness (N·m/rad), viscosity (N·m·s/rad), inertia (kg·m²) and
    time_varying_vaf (%);

    - `models.nc`: all that was identified, a group for each method (NetCDF; `xarray.open_datatree` reads it);

    - `stiffness.png` and `.pdf`: stiffness and time-varying VAF over time.

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period 2 --torque-sign -1`
    """
    from threadpoolctl import threadpool_limits

    from tvsysid import preprocess
    from tvsysid.figures import identified_stiffness, save
    from tvsysid.methods import parse
    from tvsysid.metrics import time_varying_vaf, vaf
    from tvsysid.recordings import read_recording, whole_file, write_models

    chosen = {label: parse(label) for label in dict.fromkeys(method)}
    _check_folder(out)
    with _shown_warnings():
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
        if decimate is not None:
            recording = preprocess.decimate(recording, decimate)
        if recording.sampling_rate > SLOW_RATE:
            errors.print(
                f"[yellow]note:[/] identifying at {recording.sampling_rate:g} Hz may take minutes; "
                "--decimate 100 is usual, and loses nothing of a joint",
                highlight=False,
                soft_wrap=True,
            )
        ensemble = preprocess.subtract_mean(preprocess.segment(recording, period, context))
        output.print(f"{file.name}: {ensemble!r}", highlight=False)
        models: dict[str, Model] = {}
        # Small matrices: BLAS threads would only wait for each other.
        with _progress("identifying") as advance, threadpool_limits(1):
            for number, (label, item) in enumerate(chosen.items()):
                advance(number, len(chosen))
                models[label] = item.identify(ensemble)
    measured = ensemble.torque[:, ensemble.core]
    predictions = {label: model.predict(ensemble) for label, model in models.items()}
    over_time = {label: time_varying_vaf(measured, predicted) for label, predicted in predictions.items()}
    shares = {label: vaf(measured, predicted) for label, predicted in predictions.items()}
    with whole_file(out / "stiffness.csv") as table:
        _stiffness_table(models, over_time).to_csv(table, index=False, float_format="%.6g")
    write_models(out / "models.nc", {label.replace("/", "_"): model for label, model in models.items()})
    figure = identified_stiffness(models, over_time, f"{file.name}: {len(ensemble)} realizations of {period:g} s")
    for ending in ("png", "pdf"):
        save(figure, out / f"stiffness.{ending}")
    output.print(_identification_table(models, shares, ensemble))
    _say_written(out, ["stiffness.csv", "models.nc", "stiffness.png", "stiffness.pdf"])


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
    from rich.markup import escape

    from tvsysid.benchmark import check_method as check
    from tvsysid.methods import parse

    checks = check(parse(name))
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
) -> None:
    """Write a simulated recording that `tvsysid identify` reads.

    The file holds `angle` (rad), `torque` (N·m, with noise), and the truth: `noiseless_torque` (N·m) and
    `stiffness` (N·m/rad). The behaviour repeats every 2 s.

    Example: `tvsysid simulate joint.mat && tvsysid identify joint.mat --angle angle --torque torque --rate 1000
    --decimate 100 --period 2`
    """
    from tvsysid.benchmark import PERTURBATIONS, PROFILES
    from tvsysid.recordings import write_simulation
    from tvsysid.simulate import joint

    simulation = joint(
        duration,
        stiffness=PROFILES[stiffness.value],
        perturbation=PERTURBATIONS[perturbation.value],
        snr_db=snr,
        seed=seed,
        rate=rate,
    )
    recording = simulation.recording
    first = round(-recording.start * rate)
    inner = slice(first, first + round(duration * rate))
    columns = {
        "angle": recording.angle[inner],
        "torque": recording.torque[inner],
        "noiseless_torque": simulation.noiseless_torque[inner],
        "stiffness": simulation.stiffness[inner],
    }
    write_simulation(file, columns, rate)
    decimate = " --decimate 100" if rate > 100 and rate % 100 == 0 else ""
    output.print(
        f"wrote {file}: {duration:g} s at {rate:g} Hz; identify it with\n"
        f"tvsysid identify {file} --angle angle --torque torque --rate {rate:g}{decimate} --period 2",
        highlight=False,
        soft_wrap=True,
    )


def main() -> None:
    """Run the command line; what the user can mend is one line on standard error, with exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a character shows another in its place
            stream.reconfigure(errors="replace")
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

    shown = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*shown, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task(title, total=None)

        def advance(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield advance


@contextmanager
def _shown_warnings() -> Iterator[None]:
    """Print the package's warnings as one line each when the block ends, however it ends."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DoubtfulWarning)
        try:
            yield
        finally:
            for text in dict.fromkeys(str(warning.message) for warning in caught):
                errors.print(f"[yellow]warning:[/] {text}", highlight=False, soft_wrap=True)


def _scenario_title(scenario: Any, trials: int) -> str:
    profile = {"square": "square wave", "sine": "sine wave", "constant": "constant"}[scenario.stiffness]
    perturbation = {"noise": "filtered noise", "prbs": "PRBS"}[scenario.perturbation]
    repeats = "1 trial" if trials == 1 else f"{trials} trials"
    return f"{profile}, {perturbation}, {scenario.duration_s:g} s, {scenario.snr_db:g} dB, {repeats}"


def _benchmark_table(summary: pd.DataFrame, cell: dict[str, Any], title: str) -> Table:
    rows = summary[
        (summary.stiffness == cell["profile"])
        & (summary.perturbation == cell["perturbation"])
        & (summary.duration_s == cell["duration_s"])
        & (summary.snr_db == cell["snr_db"])
    ]
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
    table = Table(title=title, title_justify="left")
    table.add_column("method", overflow="fold")
    for name in present:
        table.add_column(shown[name][0], justify="right")
    for method, group in rows.groupby("method", sort=False):
        values = dict(zip(group.metric, group.value, strict=True))
        values["seconds"] *= 1000
        texts = [shown[name][1].format(values[name]) if values[name] == values[name] else "-" for name in present]
        table.add_row(str(method), *texts)
    return table


def _identification_table(models: dict[str, Model], shares: dict[str, Any], ensemble: Ensemble) -> Table:
    import numpy as np

    table = Table(title=f"{len(ensemble)} realizations of {ensemble.duration:g} s", title_justify="left")
    table.add_column("method", overflow="fold")
    for heading in (
        "stiffness, mean\n(N·m/rad)",
        "lowest, at\n(N·m/rad, s)",
        "highest, at\n(N·m/rad, s)",
        "inertia\n(kg·m²)",
        "VAF\n(%)",
        "time\n(ms)",
    ):
        table.add_column(heading, justify="right")
    for label, model in models.items():
        stiffness, time = model.stiffness, model.time
        extremes = []
        for place in (np.nanargmin(stiffness), np.nanargmax(stiffness)):
            extremes.append(f"{stiffness[place]:.1f}, {time[place]:.2f}")
        known = model.inertia[np.isfinite(model.inertia)]
        table.add_row(
            label,
            f"{np.nanmean(stiffness):.1f}",
            *extremes,
            f"{known.mean():.4f}" if len(known) else "-",
            f"{np.nanmean(shares[label]):.1f}",
            f"{1000 * model.diagnostics.seconds:.0f}",
        )
    return table


def _stiffness_table(models: dict[str, Model], over_time: dict[str, Any]) -> pd.DataFrame:
    import pandas as pd

    tables = [
        pd.DataFrame(
            {
                "time_s": model.time,
                "method": label,
                "stiffness": model.stiffness,
                "viscosity": model.viscosity,
                "inertia": model.inertia,
                "time_varying_vaf": over_time[label],
            }
        )
        for label, model in models.items()
    ]
    return pd.concat(tables, ignore_index=True)


def _say_written(out: Path, names: list[str]) -> None:
    output.print(f"wrote {', '.join(names)} to {out}/", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
