"""Write an experiment's tables, ensembles, figures and pages to its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.figures import draw_all
from tvsysid.quality import diagnose
from tvsysid.recordings import write_ensemble
from tvsysid.report import write_diagnosis, write_experiment_report
from tvsysid.studies.claims import judge_claims
from tvsysid.studies.published_study import Written, write_tables
from tvsysid.studies.van_de_ruit_2021.experiment import CLAIMS, COUNTS, experiment_evidence
from tvsysid.studies.van_de_ruit_2021.experiment_figures import (
    experiment_figures,
    participant_figures,
    representative,
)
from tvsysid.study import (
    Prepared,
    exclusions,
    stiffness_over_time,
    summarize,
)

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
    excluded = exclusions(prepared)
    tables = {
        "summary.csv": summarize(results),
        "claims.csv": judge_claims(CLAIMS, experiment_evidence(results)),
        "stiffness.csv": stiffness_over_time(results),
        **({"exclusions.csv": excluded} if prepared else {}),
    }
    write_tables(folder, tables)
    summary, claims = tables["summary.csv"], tables["claims.csv"]
    who, excerpts, preparations, diagnoses = representative(results, summary), {}, {}, {}
    for each in prepared:
        if each.ensemble and each.excerpt and each.preparation:
            label = each.recorded.label
            write_ensemble(folder / "prepared" / f"{label}.nc", each.ensemble)
            diagnoses[label] = diagnose(each.ensemble, each.reference)
            if each.recorded.participant == who:
                excerpts[label], preparations[label] = each.excerpt, each.preparation
    figures = experiment_figures(results, summary, excerpts, preparations)
    pictures = draw_all(figures | participant_figures(results), folder / "figures")
    files = ["report.html", *tables, "prepared/", f"figures/ ({len(pictures)})"]
    if diagnoses:
        write_diagnosis(folder / "diagnosis.html", diagnoses, command)
        files.insert(1, "diagnosis.html")
    write_experiment_report(
        folder / "report.html",
        results,
        summary,
        claims,
        excluded,
        {name: pictures[name] for name in figures},
        command,
        COUNTS,
    )
    return Written(summary, claims, tuple(files), diagnoses)
