"""Write an experiment's tables, ensembles, figures and pages to its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.figures import draw_all
from tvsysid.quality import diagnose
from tvsysid.recordings import write_ensemble
from tvsysid.report import write_diagnosis, write_experiment_report
from tvsysid.studies.published_study import Written, write_tables
from tvsysid.studies.van_de_ruit_2021.experiment import judge_experiment
from tvsysid.studies.van_de_ruit_2021.figures import experiment_figures, participant_figures
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
        As for :func:`tvsysid.studies.write_study`.
    prepared
        The recordings; none, if they are gone: then ``exclusions.csv`` and ``prepared/`` stay as
        they are.
    """
    results = results.load()
    summary, claims = summarize(results), judge_experiment(results)
    tables = {
        "summary.csv": summary,
        "claims.csv": claims,
        "stiffness.csv": stiffness_over_time(results),
    }
    files, diagnoses = ["report.html", *tables, "figures/"], {}
    if prepared:
        tables["exclusions.csv"] = exclusions(prepared)
        for each in prepared:
            if each.ensemble:
                label = each.recorded.label
                write_ensemble(folder / "prepared" / f"{label}.nc", each.ensemble)
                diagnoses[label] = diagnose(each.ensemble, each.reference)
        write_diagnosis(folder / "diagnosis.html", diagnoses, command)
        files += ["exclusions.csv", "prepared/", "diagnosis.html"]
    write_tables(folder, tables)
    pictures = draw_all(experiment_figures(results, summary, prepared), folder / "figures")
    draw_all(participant_figures(results), folder / "figures")
    write_experiment_report(folder / "report.html", results, summary, claims, pictures, command)
    return Written(summary, claims, tuple(files), diagnoses)
