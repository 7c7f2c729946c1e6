"""`tvsysid benchmark`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import attrs

from tvsysid.cli.console import say
from tvsysid.cli.options import Flag, Flattened, Methods, WorkerOptions, Workers, given
from tvsysid.cli.results import write_study
from tvsysid.cli.running import command_line, opened, run_study, show_plan
from tvsysid.errors import InputError


@attrs.frozen
class Settings:
    """Settings of a simulation study, named as there.

    Parameters
    ----------
    system
        What is simulated: `joint`, `reflex`, `reflex-sine`, `reflex-square`, `compliant`, `loaded`,
        `scheduled` (see `tvsysid simulate`), or your own as `module:Object`; repeatable. [joint]
    stiffness
        Stiffness over time: `square`, `sine`, `constant`, or your own function of time as
        `module:Object`; repeatable. [square]
    perturbation
        Perturbation of the angle: `noise`, `prbs`, `pulses`, `multisine`, or your own as
        `module:Object`; repeatable. [noise and prbs]
    duration_s
        Seconds of data, a whole number of realizations; repeatable. [150]
    trials
        Monte-Carlo trials of each scenario. [20]
    seed
        Seed of the random numbers; the same seed gives the same results. [0]
    """

    system: list[str] | None = None
    stiffness: list[str] | None = None
    perturbation: list[str] | None = None
    duration_s: list[float] | None = None
    methods: Methods | None = None
    trials: int | None = None
    seed: int | None = None


def benchmark(
    study_toml: Path | None = None,
    /,
    *,
    preset: Literal["quick", "paper", "snr", "viscosity", "reflex", "closed-loop"] | None = None,
    settings: Annotated[Settings, Flattened] = Settings(),
    workers: WorkerOptions = Workers(),
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

    - `results.nc`: estimates, VAF, time taken and warnings of every trial; `xarray.open_dataset`
      reads it.

    Every trial is saved as soon as it is done. If the command is interrupted or killed, the same
    command resumes.

    Example: `tvsysid benchmark --method sds --method sds:window=0.2 --trials 50`

    Example: `tvsysid benchmark --preset paper --out paper`

    Parameters
    ----------
    study_toml
        TOML file with the study's settings: those below, `rate`, `period`, `snr_db`, `viscosity`.
    preset
        `quick` (the default), `paper` (van de Ruit et al. 2021: their five methods, 40 to 600 s,
        100 trials, and their sine), `snr` (0 to 30 dB), `viscosity` (constant, and rising with
        stiffness), `reflex` (a stretch reflex, by methods of one pathway and of two), `closed-loop`
        (a compliant actuator, by methods with and without a reference). The options below override
        its settings.
    dry_run
        Print what would be run, with an estimate of time, and stop.
    out
        Folder for the results.
    """
    from tvsysid.studies import preset as study_called
    from tvsysid.study import Study

    options = given(**attrs.asdict(settings))
    if study_toml and preset:
        raise InputError(f"{study_toml} and --preset {preset}: give one of them")
    if study_toml:
        study = Study.from_toml(study_toml, **options)
    else:
        study = study_called(preset or "quick", **options)
    if dry_run:
        for scenario in study.scenarios:
            say(scenario.label)
        count = len(study.scenarios)
        draws = f"{study.trials} trials of each of {count} scenarios, seed {study.seed}"
        return show_plan(study, workers, draws)
    with opened(workers) as executor:
        results = run_study(study, out, workers, executor)
        return write_study(results, out, command_line(), executor)
