"""`tvsysid experiment`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.console import errors, remark, show_table, shown_progress, shown_warnings
from tvsysid.cli.options import Methods, Whole, WorkerOptions, Workers, given
from tvsysid.cli.running import command_line, run_study, show_claims, show_end
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from tvsysid.study import Experiment, Prepared


def experiment(
    study_toml: Path | None = None,
    /,
    *,
    virtual: list[Whole] | None = None,
    perturbation: list[str] | None = None,
    method: Methods | None = None,
    realizations: list[Whole] | None = None,
    bootstraps: Whole | None = None,
    seed: Whole | None = None,
    workers: WorkerOptions = Workers(),
    out: Path = Path("tvsysid-experiment"),
) -> int:
    """Identify the stiffness of several participants, with its variability over bootstraps.

    Reads each participant's trials, decimates them, cuts them into realizations, aligns these with
    the target torque, excludes realizations that differ too much from the others, and lets every
    method identify 100 bootstraps of 75 and 150 realizations, as van de Ruit et al. (2021) do.
    Without a file it runs their experiment on six virtual participants, whose true stiffness is
    known.

    Writes to the folder:

    - `report.html`: all results in one page;

    - `stiffness.csv`: stiffness over time, mean and standard deviation over bootstraps, for each
      participant, perturbation, method and number of realizations;

    - `summary.csv`: random error, VAF (share of the torque's variance that the model predicts), VAF
      after a 1-10 Hz band-pass, and further metrics;

    - `exclusions.csv`: for each realization, by how much it was shifted, and which step excluded it
      and why;

    - `alignment.csv`: for each recording, the stiffness with and without the shifts that align
      realizations to the target;

    - `diagnosis.html`: what is wrong with each recording, how it affects the result, and what to
      do;

    - `claims.csv`: the paper's claims about its experiment, with the values found here and a
      verdict;

    - `prepared/`: the ensembles that were identified (NetCDF; `tvsysid.recordings.load_ensemble`
      reads them);

    - `figures/`: each figure as PNG, PDF and SVG, and a figure of every participant as PNG and PDF;

    - `results.nc`: every bootstrap; `xarray.open_dataset` reads it.

    The bootstraps of a method are saved as soon as they are done. If the command is interrupted or
    killed, the same command resumes. A file that cannot be used is reported and left out.

    Example: `tvsysid experiment`

    Example: `tvsysid experiment study.toml --method sds --bootstraps 50`

    Parameters
    ----------
    study_toml
        TOML file with participants, files and channels; see docs/experiment.md.
    virtual
        Virtual participant number N; repeatable. [1 to 6]
    perturbation
        Perturbation to analyse; repeatable. [all]
    realizations
        Realizations in a bootstrap; repeatable. [75 and 150; for kbr 20 and 40]
    bootstraps
        Bootstrap samples for each method and number of realizations. [100]
    seed
        Seed of the random numbers; the same seed gives the same results. [0]
    out
        Folder for the results.
    """
    from tvsysid.study import Experiment, prepared_recordings, run

    settings = given(
        virtual=virtual,
        perturbation=perturbation,
        methods=method,
        realizations=realizations,
        bootstraps=bootstraps,
        seed=seed,
    )
    study = Experiment.from_toml(study_toml, **settings) if study_toml else Experiment(**settings)
    with shown_progress("preparing recordings") as advance:
        prepared = prepared_recordings(study, advance)
    for item in prepared:
        for text in item.remarks:
            remark("error" if text == item.failure else "warning", f"{item.recorded.label}: {text}")
    if all(item.failure for item in prepared):
        raise InputError("no recording can be used; correct the errors above")
    title = (
        f"{len(study.recordings)} recordings x {len(study.analyses)} analyses x "
        f"{study.bootstraps} bootstraps"
    )
    with shown_warnings():
        study_run = partial(run, study, prepared=prepared)
        results = run_study(study_run, out, title, workers)
    return 0 if write(study, results, prepared, out, command_line()) else 1


def write(
    experiment: Experiment,
    results: xr.Dataset,
    prepared: Sequence[Prepared],
    out: Path,
    command: str,
) -> bool:
    """Write tables, ensembles, figures and report, and print a summary.

    Return whether every analysis gave a result.
    """
    from tvsysid.report import problems
    from tvsysid.studies.van_de_ruit_2021 import write_experiment

    with errors.status("scoring and drawing"):
        written = write_experiment(experiment, results, prepared, out, command)
    for perturbation, summary in written.summary.groupby("perturbation", sort=False):
        _show_summary(str(perturbation), summary)
    if written.claims.verdict.isin(["holds", "does not hold"]).any():
        show_claims(written.claims, "experiment", "what the report says")
    for label, diagnosis in written.diagnoses.items():
        if names := ", ".join(finding.name for finding in diagnosis.findings):
            remark("warning", f"{label}: {names} (diagnosis.html says what to do)")
    if written.alignment:
        remark("warning", written.alignment)
    labels = set(results.recording.values.tolist())  # unusable recordings were reported before
    others = [problem for problem in problems(results) if problem["method"] not in labels]
    complete = show_end(out, written.files, others)
    return complete and not any(item.failure for item in prepared)


def _show_summary(perturbation: str, summary: pd.DataFrame) -> None:
    """Print the main results of one perturbation, mean and standard deviation over participants."""
    columns = {
        "method": "{method}",
        "drawn": "{realizations}",
        "stiffness": "{mean_stiffness}",
        "random": "{random_error}",
        "bias": "{mean_bias}",
        "VAF": "{vaf}",
        "VAF\n1-10 Hz": "{bandpassed_vaf}",
    }
    over_people = summary.groupby(["method", "realizations", "metric"], sort=False).value
    means, spreads = over_people.mean().map("{:.1f}".format), over_people.std().map("{:.1f}".format)
    texts = means + (" ± " + spreads).where(spreads != "nan", "")
    metrics = [form[1:-1] for form in columns.values()]
    table = texts.unstack(sort=False).reset_index().reindex(columns=metrics)
    people = summary.participant[(summary.metric == "vaf") & summary.value.notna()].nunique()
    show_table(
        f"{perturbation}: mean ± SD over participants ({people}), in N·m/rad and %",
        table.replace("nan", None).to_dict("records"),
        columns,
    )
