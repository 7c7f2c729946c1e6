"""`tvsysid benchmark`."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tvsysid.cli.console import duration_text, remark, say, say_written, show_table, waiting
from tvsysid.cli.options import (
    MethodOption,
    OutOption,
    SchedulerOption,
    SeedOption,
    WorkersOption,
    given,
    option,
)
from tvsysid.cli.running import STORE, check_folder, command_line, print_met, run_in, show_claims
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from tvsysid.study import Study

MOST_TABLES = 4  # scenarios whose table is printed; the report has all


class Viscosity(StrEnum):  # typer takes no list of literals
    """Viscosities that can be simulated."""

    constant = "constant"
    covarying = "covarying"


def benchmark(
    study_file: Annotated[
        Path | None,
        typer.Argument(metavar="[STUDY.toml]", help="TOML file with the study's settings."),
    ] = None,
    preset: Annotated[
        Literal["quick", "paper", "snr", "viscosity", "reflex", "closed-loop"] | None,
        option(
            None,
            "`quick` (the default), `paper` (van de Ruit et al. 2021: 40 to 600 s, 100 trials, "
            "and their sine), `snr` "
            "(0 to 30 dB), `viscosity` (constant, and rising with stiffness), `reflex` (a stretch "
            "reflex, by methods "
            "of one pathway and of two), `closed-loop` (an actuator that gives way, by methods "
            "with and without a "
            "reference). The options below override its settings.",
        ),
    ] = None,
    system: Annotated[
        list[str] | None,
        option(
            "NAME",
            "What is simulated: `joint`, `reflex`, `reflex-sine`, `reflex-square`, `compliant`, "
            "`loaded`, `scheduled` "
            "(see `tvsysid simulate`), or your own as `module:Object`; repeatable. [joint]",
        ),
    ] = None,
    stiffness: Annotated[
        list[str] | None,
        option(
            "NAME",
            "Stiffness over time: `square`, `sine`, `constant`, or your own function of time as "
            "`module:Object`; "
            "repeatable. [square]",
        ),
    ] = None,
    perturbation: Annotated[
        list[str] | None,
        option(
            "NAME",
            "Perturbation of the angle: `noise`, `prbs`, `pulses`, `multisine`, or your own as "
            "`module:Object`; "
            "repeatable. [noise and prbs]",
        ),
    ] = None,
    duration: Annotated[
        list[float] | None,
        option("S", "Seconds of data, a whole number of realizations; repeatable. [150]"),
    ] = None,
    rate: Annotated[float | None, option("HZ", "Rate to which data are decimated. [100]")] = None,
    period: Annotated[float | None, option("S", "Duration of a realization. [2]")] = None,
    snr: Annotated[
        list[float] | None,
        option("DB", "Signal-to-noise ratio of the torque in dB; repeatable. [10]"),
    ] = None,
    viscosity: Annotated[
        list[Viscosity] | None,
        option(
            "NAME",
            "`constant`: 2.2 N·m·s/rad; `covarying`: 1 to 3 with the stiffness; repeatable. "
            "[constant]",
        ),
    ] = None,
    method: MethodOption = [],
    trials: Annotated[int | None, option("N", "Monte-Carlo trials of each scenario. [20]")] = None,
    seed: SeedOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    dry_run: Annotated[
        bool,
        option(
            "", "Print what would be run, with an estimate of time and size, and stop.", "--dry-run"
        ),
    ] = False,
    out: OutOption = Path("tvsysid-benchmark"),
) -> None:
    """Compare methods on simulated data with known stiffness.

    Simulates a joint (inertia 0.02 kg·m², viscosity 2.2 N·m·s/rad) whose stiffness follows the
    profile, lets every method identify the same data, and scores them against the truth, as van de
    Ruit et al. (2021) do: bias (error of the mean over trials), random error (standard deviation
    over trials), total error (both), rise time (from 10 to 90 % of the step), VAF (share of the
    noiseless torque's variance that the model predicts), and VAF after a 1-10 Hz band-pass.

    Writes to the folder:

    - `report.html`: all results in one page: ranking, figures, and published claims compared with
      the results;

    - `summary.csv`: a row for each scenario, method and metric, with value, standard error and
      unit;

    - `claims.csv`: each published claim, with the values found here and a verdict;

    - `figures/`: each figure as PNG, PDF and SVG;

    - `results.zarr`: estimates, VAF, time taken and warnings of every trial; `xarray.open_zarr`
      reads it.

    Every trial is saved as soon as it is done. If the command is interrupted or killed, the same
    command resumes.

    Example: `tvsysid benchmark --method sds --method sds:window=0.2 --trials 50`

    Example: `tvsysid benchmark --preset paper --out paper`
    """
    from tvsysid.studies import PRESETS
    from tvsysid.studies.van_de_ruit_2021 import preset as study_called
    from tvsysid.study import Study, cores, run

    settings = given(
        system=system,
        stiffness=stiffness,
        perturbation=perturbation,
        duration_s=duration,
        snr_db=snr,
    )
    settings |= given(
        viscosity=list(map(str, viscosity or ())),
        rate=rate,
        period=period,
        trials=trials,
        seed=seed,
    )
    settings |= given(methods=list(dict.fromkeys(method)))
    if study_file is not None and preset is not None:
        raise InputError(f"{study_file} and --preset {preset}: give one of them")
    if study_file is not None:
        study = Study.from_toml(study_file, **settings)
    else:
        study = study_called(preset or "quick", PRESETS, **settings)
    if dry_run:
        _print_plan(study, workers or cores())
        return
    count = len(study.scenarios)
    title = (
        f"{count} scenario{'s' if count > 1 else ''} x {study.trials} trials x "
        f"{len(study.named_methods)} methods"
    )
    check_folder(out)
    results = run_in(out, partial(run, study), title, "trials", workers, scheduler)
    if not write(results, out, command_line()):
        raise typer.Exit(1)


def _print_plan(study: Study, workers: int) -> None:
    from tvsysid.study import plan

    with waiting("timing a trial of the shortest and the longest scenario"):
        taken = plan(study)
    rows = [
        (
            each.system,
            each.stiffness,
            each.perturbation,
            f"{each.duration_s:g}",
            f"{each.snr_db:g}",
            each.viscosity,
        )
        for each in study.scenarios
    ]
    headings = ["system", "stiffness", "perturbation", "duration (s)", "SNR (dB)", "viscosity"]
    show_table("the study", headings, rows, "llllll")
    say(
        f"methods: {', '.join(study.named_methods)}\n"
        f"{study.trials} trials of each of {len(study.scenarios)} scenarios, seed {study.seed}: "
        f"{taken.trials} trials, "
        f"{taken.simulated_s:,.0f} s of data\n"
        f"about {duration_text(taken.work_s / workers)} with {workers} "
        f"process{'es' if workers > 1 else ''}, beside "
        f"the start and the figures, and {taken.size_bytes / 1e6:,.1f} MB of results; nothing was "
        "run"
    )
    for label, reason in taken.failures.items():
        remark("error", f"{label} fails: {reason}")


def write(results: xr.Dataset, out: Path, command: str) -> bool:
    """Write tables, figures and report, and print the essence.

    Whether every method gave a result in every trial.
    """
    from tvsysid.report import problems
    from tvsysid.studies import published
    from tvsysid.studies.van_de_ruit_2021 import write_study

    literature = published(results)
    with waiting("scoring and drawing"):
        summary, claims, files, *_ = write_study(results, out, command, literature)
    labels = list(dict.fromkeys(summary.scenario))
    for label in labels[:MOST_TABLES]:
        _show_scores(summary[summary.scenario == label])
    if len(labels) > MOST_TABLES:
        say(f"and {len(labels) - MOST_TABLES} more scenarios in summary.csv and report.html")
    if (claims.verdict != "not studied").any():
        show_claims(
            claims, "simulations", f"other scenarios: --preset {', '.join(literature.presets)}"
        )
    _show_times(results)
    complete = print_met(results, problems(results), "trials", "trials")
    say_written(out, [*files, STORE])
    return complete


def _scenario_title(row: Any) -> str:
    profile = {"square": "square wave", "sine": "sine wave"}.get(row.stiffness, row.stiffness)
    profile = (
        row.system
        if profile == "own"
        else profile
        if row.system == "joint"
        else f"{row.system}, {profile}"
    )
    perturbation = {"noise": "filtered noise", "prbs": "PRBS"}.get(
        row.perturbation, row.perturbation
    )
    repeats = "1 trial" if row.trials == 1 else f"{row.trials} trials"
    covarying = ", viscosity covarying" if row.viscosity == "covarying" else ""
    return (
        f"{profile}, {perturbation}, {row.duration_s:g} s, {row.snr_db:g} dB{covarying}, {repeats}"
    )


def _show_scores(summary: pd.DataFrame) -> None:
    """Main metrics of one scenario."""
    shown = {
        "bias_error": ("bias\n(N·m/rad)", "{:.1f}"),
        "random_error": ("random\n(N·m/rad)", "{:.1f}"),
        "total_error": ("total\n(N·m/rad)", "{:.1f}"),
        "rise_time": ("rise\n(s)", "{:.2f}"),
        "vaf": ("VAF\n(%)", "{:.1f}"),
        "reflex_gain total_error": ("reflex gain\n(N·m·s/rad)", "{:.1f}"),
        "reflex pathway_vaf": ("VAF reflex\n(%)", "{:.1f}"),
        "bandpassed_vaf": ("VAF 1-10 Hz\n(%)", "{:.1f}"),
        "seconds": ("time\n(ms)", "{:.0f}"),
    }
    present = [name for name in shown if (summary.metric == name).any()]
    if "reflex pathway_vaf" in present:  # for which there would be no room
        present = [name for name in present if name not in ("random_error", "bandpassed_vaf")]
    most: Any = summary.iloc[int(summary.trials.argmax())]
    rows = []
    for method, group in summary.groupby("method", sort=False):
        values = dict.fromkeys(present, float("nan")) | dict(
            zip(group.metric, group.value, strict=True)
        )
        values["seconds"] *= 1000
        if most.trials == 1:
            values["random_error"] = float("nan")  # one trial has no spread
        texts = [
            shown[name][1].format(values[name]) if values[name] == values[name] else "-"
            for name in present
        ]
        rows.append((str(method), *texts))
    show_table(_scenario_title(most), ["method", *(shown[name][0] for name in present)], rows)


def _show_times(results: xr.Dataset) -> None:
    """Where the time of the trials went, and how much data each stage gets through."""
    from tvsysid.study import time_spent

    there = results.checksums.values.any(axis=-1)
    simulated = float((results.duration_s.values * there.sum(axis=1)).sum())
    spent = time_spent(results)
    total = sum(spent.values())
    rows = []
    for name, seconds in spent.items():
        rate = f"{simulated / seconds:,.0f}" if seconds else "-"
        rows.append((name, f"{seconds:.1f}", f"{100 * seconds / total if total else 0:.0f}", rate))
    title = f"computing time by stage: {duration_text(total)} in all workers"
    show_table(title, ["stage", "time (s)", "share (%)", "s of data per s"], rows)
