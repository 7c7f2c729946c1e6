"""Write an experiment's tables, ensembles, figures and pages to its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.quality import Diagnosis
from tvsysid.recordings import write_ensemble
from tvsysid.report import write_diagnosis, write_experiment_report
from tvsysid.report.experiment import experiment_figures, stiffness_to_report
from tvsysid.studies.published_study import Written, write_outcome
from tvsysid.studies.van_de_ruit_2021.experiment import judge_experiment
from tvsysid.study import Prepared, exclusions, stiffness_over_time, summarize

if TYPE_CHECKING:
    import xarray as xr


def write_experiment(
    results: xr.Dataset,
    prepared: Sequence[Prepared],
    folder: Path,
    command: str = "",
) -> Written:
    """Write tables, ensembles, figures and pages of an experiment.

    Parameters
    ----------
    results, folder, command
        As for :meth:`tvsysid.studies.published_study.PublishedStudy.write`.
    prepared
        The recordings; none, if they are gone: then ``answers.csv``, ``exclusions.csv`` and
        ``prepared/`` stay as they are.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    results = results.load()
    summary, claims = summarize(results), judge_experiment(results)
    tables = {"summary.csv": summary, "stiffness.csv": stiffness_over_time(results)}
    if len(claims):
        tables["claims.csv"] = claims
    files = ["report.html", "figures/"]
    diagnoses: dict[str, Diagnosis] = {}
    if prepared:
        tables["answers.csv"], diagnoses = stiffness_to_report(prepared, results)
        tables["exclusions.csv"] = exclusions(prepared)
        for each in prepared:
            if each.ensemble:
                file = folder / "prepared" / f"{each.recorded.label}.nc"
                write_ensemble(file, each.ensemble)
        write_diagnosis(folder / "diagnosis.html", diagnoses, command)
        files += ["prepared/", "diagnosis.html"]
    elif (file := folder / "answers.csv").exists():
        tables["answers.csv"] = pd.read_csv(file, keep_default_na=False)
    pictures = write_outcome(folder, tables, experiment_figures(results, summary, prepared))
    answers = tables.get("answers.csv")
    page = folder / "report.html"
    write_experiment_report(page, results, summary, claims, pictures, command, answers)
    return Written(summary, claims, [*files, *tables], diagnoses, answers)
