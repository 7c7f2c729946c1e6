"""`tvsysid experiment`."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tvsysid.cli.console import progress, remark, say_written, show_table, shown_warnings, waiting
from tvsysid.cli.options import MethodOption, OutOption, SchedulerOption, SeedOption, WorkersOption
from tvsysid.cli.running import STORE, check_folder, command_line, print_met, run_in, show_claims
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

MOST_RECORDINGS = 24
"""Recordings whose numbers of realizations are printed."""


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
    out: OutOption = Path("tvsysid-experiment"),
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
    from tvsysid.study import Experiment

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
    check_folder(out)
    results, prepared = _run(what, out, workers, scheduler)
    if not write_experiment(what, results, prepared, out, command_line()):
        raise typer.Exit(1)


def _run(experiment: Any, out: Path, workers: int | None, scheduler: str | None) -> tuple[Any, Any]:
    """Results and what they are of, with progress; what ends it early says how to go on."""
    from tvsysid.study import prepared_recordings, run

    with progress("preparing recordings") as advance:
        prepared = prepared_recordings(experiment, advance)
    for item in prepared:
        for text in item.remarks:
            remark("error" if text == item.failure else "warning", f"{item.recorded.label}: {text}")
    if all(item.failure for item in prepared):
        raise InputError("no recording can be used; mend what is said above")
    title = (
        f"{len(experiment.recordings)} recordings x {len(experiment.analyses)} analyses x "
        f"{experiment.bootstraps} bootstraps"
    )
    with shown_warnings():
        results = run_in(out, partial(run, experiment, prepared=prepared), title, "analyses", workers, scheduler)
    return results, prepared


def write_experiment(experiment: Any, results: Any, prepared: Any, out: Path, command: str) -> bool:
    """Write tables, ensembles, figures and report, and print the essence; whether every analysis gave a result."""
    import pandas as pd

    from tvsysid.figures import helpers, share_out
    from tvsysid.quality import diagnose
    from tvsysid.recordings import whole_file, write_ensemble
    from tvsysid.report import problems, write_diagnosis, write_experiment_report
    from tvsysid.studies.van_de_ruit_2021 import COUNTS, judge
    from tvsysid.study import cores, exclusions, stiffness_over_time, summarize

    with waiting("scoring and drawing"), helpers(cores()) as pool:
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
        pictures = _experiment_pictures(experiment, results, summary, prepared, out / "figures", pool)
        ensembles = {item.recorded.label: (item.ensemble,) for item in prepared if item.ensemble is not None}
        diagnoses = share_out(diagnose, ensembles, pool)
        if diagnoses:
            write_diagnosis(out / "diagnosis.html", diagnoses, command, pool)
        write_experiment_report(out / "report.html", results, summary, claims, excluded, pictures, command, COUNTS)
    for perturbation in dict.fromkeys(summary.perturbation):
        _show_summary(summary[summary.perturbation == perturbation], str(perturbation))
    _show_realizations(results)
    if claims.verdict.isin(["holds", "does not hold"]).any():
        show_claims(claims, "experiment", "what the report says")
    labels = set(results.recording.values.tolist())  # those that failed altogether were told before
    met = [problem for problem in problems(results) if problem["method"] not in labels]
    complete = print_met(results, met, "analyses", "recordings") and not any(item.failure for item in prepared)
    for label, diagnosis in diagnoses.items():
        if diagnosis.findings:
            found = ", ".join(finding.name for finding in diagnosis.findings)
            remark("warning", f"{label}: {found}: what it does to the result, and what to do, is in diagnosis.html")
    pages = ["report.html", *(["diagnosis.html"] if diagnoses else [])]
    names = [*pages, *tables, "prepared/", f"figures/ ({len(pictures)})", STORE]
    say_written(out, names)
    return complete


def _experiment_pictures(experiment: Any, results: Any, summary: Any, prepared: Any, folder: Path, pool: Any) -> Any:
    """Draw and save everything; those of the page, by the stems of their files."""
    from tvsysid.figures import draw_all
    from tvsysid.studies.van_de_ruit_2021 import experiment_figures, participant_figures, representative
    from tvsysid.study import shown

    excerpts, preparations = {}, {}
    who = representative(results, summary)
    for item in prepared:
        if item.recorded.participant == who and item.ensemble is not None:
            with suppress(InputError):  # a file that is gone since
                excerpts[item.recorded.label], preparations[item.recorded.label] = shown(experiment, item.recorded)
    illustrations = experiment_figures(results, summary, excerpts, preparations)
    pictures = draw_all(illustrations | participant_figures(results), folder, pool)
    return {name: pictures[name] for name in illustrations}


def _show_summary(summary: pd.DataFrame, perturbation: str) -> None:
    """Main figures under one perturbation, mean and standard deviation over participants."""
    shown = {
        "mean_stiffness": "stiffness\n(N·m/rad)",
        "random_error": "random\n(N·m/rad)",
        "mean_bias": "bias\n(N·m/rad)",
        "vaf": "VAF\n(%)",
        "bandpassed_vaf": "VAF 1-10 Hz\n(%)",
    }
    known = summary[(summary.metric == "vaf") & summary.value.notna()]
    people = known.participant.nunique()
    spread = ", mean ± SD over participants" if people > 1 else ""
    present = [name for name in shown if (summary.metric == name).any()]
    rows = []
    for (method, count), group in summary.groupby(["method", "realizations"], sort=False):
        texts = []
        for name in present:
            values = group.value[group.metric == name].dropna()
            deviation = f"±{values.std():.1f}" if len(values) > 1 else ""
            texts.append(f"{values.mean():.1f}{deviation}" if len(values) else "-")
        rows.append((str(method), str(count), *texts))
    title = f"{perturbation}: {people} participant{'s' if people > 1 else ''}{spread}"
    show_table(title, ["method", "drawn", *(shown[name] for name in present)], rows)


def _show_realizations(results: Any) -> None:
    """What became of the realizations of each recording."""
    names = {
        "recorded": "recorded",
        "excluded_alignment": "shifted\ntoo far",
        "excluded_task": "task\ncomponent",
        "excluded_residual": "residual",
        "survivors": "kept",
        "trials_left_out": "trials\nleft out",
    }
    rows = [
        (str(label), *(str(int(results[name].values[number])) for name in names))
        for number, label in enumerate(results.recording.values[:MOST_RECORDINGS])
    ]
    more = results.sizes["recording"] - MOST_RECORDINGS
    caption = f"and {more} more in report.html" if more > 0 else None
    show_table("realizations", ["recording", *names.values()], rows, caption=caption)
