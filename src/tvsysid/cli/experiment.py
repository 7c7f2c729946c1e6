"""`tvsysid experiment`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import attrs

from tvsysid.cli.console import remark, shown_progress
from tvsysid.cli.options import Flag, Flattened, Methods, WorkerOptions, Workers, given
from tvsysid.cli.results import write_study
from tvsysid.cli.running import command_line, opened, run_study, show_plan
from tvsysid.errors import InputError


@attrs.frozen
class Settings:
    """Settings of an experiment, named as there.

    Parameters
    ----------
    virtual
        Virtual participant number N; repeatable. [1 to 6]
    perturbation
        Perturbation to analyse; repeatable. [all]
    realizations
        Realizations in a bootstrap sample; repeatable. [75 and 150; for kbr 20 and 40]
    bootstraps
        Bootstrap samples for each method and number of realizations. [100]
    seed
        Seed of the random numbers; the same seed gives the same results. [0]
    """

    virtual: list[int] | None = None
    perturbation: list[str] | None = None
    methods: Methods | None = None
    realizations: list[int] | None = None
    bootstraps: int | None = None
    seed: int | None = None


def experiment(
    study_toml: Path | None = None,
    /,
    *,
    settings: Annotated[Settings, Flattened] = Settings(),
    workers: WorkerOptions = Workers(),
    dry_run: Flag = False,
    out: Path = Path("tvsysid-experiment"),
) -> int:
    """Identify the stiffness of several participants, with its variability over bootstrap samples.

    Reads each participant's trials, corrects mains hum and a late torque, decimates the trials,
    cuts them into realizations, aligns these with the target torque, excludes realizations that
    differ too much from the others, and lets every method identify 100 bootstrap samples of 75 and
    150 realizations, as van de Ruit et al. (2021) do. Without a file it runs their experiment on
    six virtual participants, whose true stiffness is known.

    Writes to the folder:

    - `report.html`: all results in one page;

    - `stiffness.csv`: stiffness over time, mean and standard deviation over bootstrap samples, for
      each participant, perturbation, method and number of realizations;

    - `summary.csv`: random error, VAF (share of the torque's variance that the model predicts), VAF
      after a 1-10 Hz band-pass, and further metrics;

    - `exclusions.csv`: for each realization, by how much it was shifted, and which step excluded it
      and why;

    - `diagnosis.html`: what is wrong with each recording, how it affects the result, and what to
      do;

    - `claims.csv`: the paper's claims about its experiment, with the values found here and a
      verdict;

    - `prepared/`: the ensembles that were identified (NetCDF; `tvsysid.recordings.load_ensemble`
      reads them);

    - `figures/`: each figure as PNG, PDF and SVG;

    - `results.nc`: every bootstrap sample; `xarray.open_dataset` reads it.

    The samples of a method are saved as soon as they are identified. If the command is interrupted
    or killed, the same command resumes. A file that cannot be used is reported and left out.

    Example: `tvsysid experiment`

    Example: `tvsysid experiment study.toml --method sds --bootstraps 50`

    Parameters
    ----------
    study_toml
        TOML file with participants, files and channels; see docs/experiment.md.
    dry_run
        Prepare the recordings, print an estimate of time, and stop.
    out
        Folder for the results.
    """
    from tvsysid.study import Experiment, prepared_recordings

    options = given(**attrs.asdict(settings))
    study = Experiment.from_toml(study_toml, **options) if study_toml else Experiment(**options)
    with opened(Workers(workers=1) if dry_run else workers) as executor:
        with shown_progress("preparing recordings") as advance:
            prepared = prepared_recordings(study, advance)
        for item in prepared:
            for text in item.remarks:
                line = f"{item.recorded.label}: {text}"
                remark("error" if text == item.failure else "warning", line)
        if all(item.failure for item in prepared):
            raise InputError("no recording can be used; correct the errors above")
        if dry_run:
            draws = f"{study.bootstraps} draws, seed {study.seed}"
            return show_plan(study, workers, draws, prepared)
        results = run_study(study, out, workers, executor, prepared)
        return write_study(results, out, command_line(), executor, prepared)
