"""`tvsysid benchmark`."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tvsysid.cli.console import remark, say, say_written, show_records, waiting
from tvsysid.cli.options import Flag, Methods, Scheduler, Seed, Whole, Workers, given
from tvsysid.cli.running import (
    STORE,
    command_line,
    print_problems,
    run_in,
    show_claims,
)
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from tvsysid.study import Study

MAX_TABLES = 4  # scenarios whose table is printed; the report has all


def benchmark(
    study_toml: Path | None = None,
    /,
    *,
    preset: Literal["quick", "paper", "snr", "viscosity", "reflex", "closed-loop"] | None = None,
    system: list[str] | None = None,
    stiffness: list[str] | None = None,
    perturbation: list[str] | None = None,
    duration: list[float] | None = None,
    rate: float | None = None,
    period: float | None = None,
    snr: list[float] | None = None,
    viscosity: list[Literal["constant", "covarying"]] | None = None,
    method: Methods | None = None,
    trials: Whole = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    dry_run: Flag = False,
    out: Path = Path("tvsysid-benchmark"),
) -> int:
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

    Parameters
    ----------
    study_toml
        TOML file with the study's settings.
    preset
        `quick` (the default), `paper` (van de Ruit et al. 2021: 40 to 600 s, 100 trials, and their
        sine), `snr` (0 to 30 dB), `viscosity` (constant, and rising with stiffness), `reflex` (a
        stretch reflex, by methods of one pathway and of two), `closed-loop` (a compliant actuator,
        by methods with and without a reference). The options below override its settings.
    system
        What is simulated: `joint`, `reflex`, `reflex-sine`, `reflex-square`, `compliant`, `loaded`,
        `scheduled` (see `tvsysid simulate`), or your own as `module:Object`; repeatable. [joint]
    stiffness
        Stiffness over time: `square`, `sine`, `constant`, or your own function of time as
        `module:Object`; repeatable. [square]
    perturbation
        Perturbation of the angle: `noise`, `prbs`, `pulses`, `multisine`, or your own as
        `module:Object`; repeatable. [noise and prbs]
    duration
        Seconds of data, a whole number of realizations; repeatable. [150]
    rate
        Rate in Hz to which data are decimated. [100]
    period
        Duration of a realization in s. [2]
    snr
        Signal-to-noise ratio of the torque in dB; repeatable. [10]
    viscosity
        `constant`: 2.2 N·m·s/rad; `covarying`: 1 to 3 with the stiffness; repeatable. [constant]
    trials
        Monte-Carlo trials of each scenario. [20]
    dry_run
        Print what would be run, with an estimate of time and size, and stop.
    out
        Folder for the results.
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
        viscosity=viscosity,
        rate=rate,
        period=period,
        trials=trials,
        seed=seed,
        methods=list(dict.fromkeys(method or ())),
    )
    if study_toml is not None and preset is not None:
        raise InputError(f"{study_toml} and --preset {preset}: give one of them")
    if study_toml is not None:
        study = Study.from_toml(study_toml, **settings)
    else:
        study = study_called(preset or "quick", PRESETS, **settings)
    if dry_run:
        _print_plan(study, workers or cores())
        return 0
    title = (
        f"{len(study.scenarios)} scenarios x {study.trials} trials x "
        f"{len(study.named_methods)} methods"
    )
    results = run_in(out, partial(run, study), title, "trials", workers, scheduler)
    return 0 if write(results, out, command_line()) else 1


def _print_plan(study: Study, workers: int) -> None:
    """Print the scenarios of a study, and how long it will take."""
    from tvsysid.study import plan

    with waiting("timing a trial of the shortest and the longest scenario"):
        taken = plan(study)
    columns = {
        "system": "{system}",
        "stiffness": "{stiffness}",
        "perturbation": "{perturbation}",
        "duration (s)": "{duration_s:g}",
        "SNR (dB)": "{snr_db:g}",
        "viscosity": "{viscosity}",
    }
    show_records("the study", [each._asdict() for each in study.scenarios], columns, "llllll")
    say(
        f"methods: {', '.join(study.named_methods)}\n"
        f"{study.trials} trials of each of {len(study.scenarios)} scenarios, seed {study.seed}: "
        f"{taken.trials} trials, {taken.simulated_s:,.0f} s of data\n"
        f"about {_duration_text(taken.work_s / workers)} with {workers} "
        f"process{'es' if workers > 1 else ''}, beside the start and the figures, and "
        f"{taken.size_bytes / 1e6:,.1f} MB of results; nothing was run"
    )
    for label, reason in taken.failures.items():
        remark("error", f"{label} fails: {reason}")


def write(results: xr.Dataset, out: Path, command: str) -> bool:
    """Write tables, figures and report, and print a summary.

    Return whether every method gave a result in every trial.
    """
    from tvsysid.report import problems
    from tvsysid.studies import published
    from tvsysid.studies.van_de_ruit_2021 import write_study

    literature = published(results)
    with waiting("scoring and drawing"):
        summary, claims, files, *_ = write_study(results, out, command, literature)
    labels = list(summary.scenario.unique())
    for label in labels[:MAX_TABLES]:
        _show_scores(summary[summary.scenario == label])
    if len(labels) > MAX_TABLES:
        say(f"and {len(labels) - MAX_TABLES} more scenarios in summary.csv and report.html")
    if (claims.verdict != "not studied").any():
        show_claims(
            claims, "simulations", f"other scenarios: --preset {', '.join(literature.presets)}"
        )
    _show_times(results)
    complete = print_problems(results, problems(results), "trials", "trials")
    say_written(out, [*files, STORE])
    return complete


def _show_scores(summary: pd.DataFrame) -> None:
    """Print the main metrics of one scenario."""
    from tvsysid.figures.words import count, described

    columns = {
        "bias\n(N·m/rad)": "{bias_error:.1f}",
        "random\n(N·m/rad)": "{random_error:.1f}",
        "total\n(N·m/rad)": "{total_error:.1f}",
        "rise\n(s)": "{rise_time:.2f}",
        "VAF\n(%)": "{vaf:.1f}",
        "reflex gain\n(N·m·s/rad)": "{reflex_gain total_error:.1f}",
        "VAF\nreflex\n(%)": "{reflex pathway_vaf:.1f}",
        "VAF\n1-10 Hz\n(%)": "{bandpassed_vaf:.1f}",
        "time\n(ms)": "{seconds:.0f}",
    }
    table = summary.pivot_table("value", "method", "metric", sort=False, dropna=False)
    table["seconds"] *= 1000
    if "reflex pathway_vaf" in table:  # there is no room for all
        table = table.drop(columns=["random_error", "bandpassed_vaf"])
    largest: Any = summary.iloc[int(summary.trials.argmax())]
    if largest.trials == 1 and "random_error" in table:
        table["random_error"] = math.nan  # one trial has no spread
    present = {
        heading: form for heading, form in columns.items() if form[1:].partition(":")[0] in table
    }
    records = table.reset_index().to_dict("records")
    scenario = described({**largest, "profile": largest.stiffness})
    title = f"{scenario}, {count(largest.trials, 'trial')}"
    show_records(title, records, {"method": "{method}", **present})


def _show_times(results: xr.Dataset) -> None:
    """Print how long each stage of the trials took, and how much data it got through per second."""
    from tvsysid.study import time_spent

    done = results.checksums.values.any(axis=-1)
    simulated = float((results.duration_s.values * done.sum(axis=1)).sum())
    spent = time_spent(results)
    total = sum(spent.values())
    records = [
        {"stage": name, "time": time, "share": 100 * time / total, "rate": simulated / time}
        for name, time in spent.items()
        if time
    ]
    columns = {
        "stage": "{stage}",
        "time (s)": "{time:.1f}",
        "share (%)": "{share:.0f}",
        "s of data per s": "{rate:,.0f}",
    }
    title = f"computing time by stage: {_duration_text(total)} in all workers"
    show_records(title, records, columns)


def _duration_text(seconds: float) -> str:
    """Return a duration in s, min or h."""
    minutes = seconds / 60
    if minutes < 2:
        return f"{seconds:.0f} s"
    return f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"
