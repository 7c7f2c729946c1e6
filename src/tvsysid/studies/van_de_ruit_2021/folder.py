"""Write a study's tables, figures and pages to its folder, with tests of the paper's claims."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from tvsysid.errors import InputError
from tvsysid.figures import Illustration, Picture, draw_all, helpers, share_out
from tvsysid.quality import Diagnosis, diagnose
from tvsysid.recordings import whole_file, write_ensemble
from tvsysid.report import CLAIMS, alignment, write_diagnosis, write_experiment_report, write_report
from tvsysid.signals import Ensemble
from tvsysid.studies.claims import Published
from tvsysid.studies.van_de_ruit_2021.experiment import COUNTS, judge_experiment
from tvsysid.studies.van_de_ruit_2021.experiment_figures import (
    experiment_figures,
    participant_figures,
    representative,
)
from tvsysid.studies.van_de_ruit_2021.figures import example_responses, study_figures
from tvsysid.studies.van_de_ruit_2021.simulations import judge_simulations
from tvsysid.study import (
    Experiment,
    Prepared,
    alignments,
    by_full_name,
    cores,
    exclusions,
    of_quantity,
    score,
    shown,
    stiffness_over_time,
    summarize,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


class Written(NamedTuple):
    """What was written to a folder, and its essence."""

    summary: pd.DataFrame
    """A row for each metric, as of :func:`tvsysid.study.summarize`.

    Of an experiment, those of the stiffness alone.
    """
    claims: pd.DataFrame
    """A row for each claim of the paper, with its verdict."""
    files: tuple[str, ...]
    """Names in the folder."""
    diagnoses: Mapping[str, Diagnosis] = MappingProxyType({})
    """Of an experiment: by recording."""
    alignment: str = ""
    """Of an experiment whose alignment changes the stiffness much: by how much, and what to do."""


def judge(found: xr.Dataset) -> pd.DataFrame:
    """Test every claim of the paper on its simulations, or on its experiment, against a study.

    Parameters
    ----------
    found
        Of a simulation study its scores, as of :func:`tvsysid.study.score`; of an experiment its
        results, as of
        :func:`tvsysid.study.run`.

    Returns
    -------
    pandas.DataFrame
        A row for each claim. ``finding`` names the comparison that decides, with its figures;
        ``estimate``, ``low`` and ``high`` are its margin and 95 % limits (from drawing trials; of
        an experiment, over participants), in ``unit``: a difference speaks for the claim above 0, a
        ratio above 1. ``verdict`` is "holds", "does not hold", "undecided" or "not studied".
    """
    return judge_simulations(found) if "scenario" in found.dims else judge_experiment(found)


def _paper_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    seed = json.loads(results.attrs["study"])["seed"]
    square = bool((results.profile == "square").any())
    return study_figures(results, summary, example_responses(seed) if square else None)


PAPER = Published(judge, _paper_figures, CLAIMS, ("paper", "snr", "viscosity"))


def write_study(
    results: xr.Dataset, folder: Path, command: str = "", published: Published = PAPER
) -> Written:
    """Write tables, figures and page of a simulation study.

    Parameters
    ----------
    results, folder
        As of :func:`tvsysid.study.run`, finished or not, and where to write.
    command
        What was typed to run the study; the page does not mention it if it is empty.
    published
        Whose claims are held against it, and how it is drawn.
    """
    with helpers(cores()) as pool:
        scores = score(results)
        summary, claims = summarize(scores), published.judge(scores)
        _write_tables(folder, {"summary.csv": summary, "claims.csv": claims})
        summary = by_full_name(summary)
        pictures = draw_all(published.figures(results, summary), folder / "figures", pool)
        write_report(
            folder / "report.html", results, summary, claims, pictures, command, published.about
        )
    return Written(
        summary, claims, ("report.html", "summary.csv", "claims.csv", f"figures/ ({len(pictures)})")
    )


def write_experiment(
    experiment: Experiment,
    results: xr.Dataset,
    prepared: Sequence[Prepared],
    folder: Path,
    command: str = "",
) -> Written:
    """Write tables, ensembles, figures and pages of an experiment.

    Parameters
    ----------
    experiment, results, folder, command
        What was studied; others as for :func:`write_study`.
    prepared
        The recordings; none, if they are gone: then ``exclusions.csv`` and ``prepared/`` stay as
        they are.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    with helpers(cores()) as pool:
        results = results.load()
        summary, claims = summarize(results), judge(results)
        tables = {
            "summary.csv": summary,
            "claims.csv": claims,
            "stiffness.csv": stiffness_over_time(results),
        }
        aligned = tables["alignment.csv"] = alignments(results)
        changed = alignment.notable(aligned)
        kept = folder / "exclusions.csv"
        if prepared or not kept.is_file():
            excluded = tables["exclusions.csv"] = exclusions(prepared)
        else:
            excluded = pd.read_csv(
                kept, keep_default_na=False, na_values={"reached": [""], "limit": [""]}
            )
        _write_tables(folder, tables)
        summary = of_quantity(summary)
        ensembles = {
            item.recorded.label: item.ensemble for item in prepared if item.ensemble is not None
        }
        for label, ensemble in ensembles.items():
            write_ensemble(folder / "prepared" / f"{label}.nc", ensemble)
        pictures = _experiment_pictures(
            experiment, results, summary, prepared, folder / "figures", pool
        )
        jobs = {label: (each, _reference(experiment, each)) for label, each in ensembles.items()}
        diagnoses = share_out(diagnose, jobs, pool)
        if diagnoses:
            each = changed.groupby("recording", sort=False)
            beside = {
                str(name): f"{alignment.sentence(one)} {alignment.REMEDY}" for name, one in each
            }
            write_diagnosis(folder / "diagnosis.html", diagnoses, command, pool, beside)
        page = folder / "report.html"
        write_experiment_report(
            page, results, summary, claims, excluded, pictures, command, COUNTS, aligned
        )
    pages = ["report.html", "diagnosis.html"] if diagnoses else ["report.html"]
    files = (*pages, *tables, "prepared/", f"figures/ ({len(pictures)})")
    told = (
        f"{', '.join(changed.recording)}: {alignment.sentence(changed)} {alignment.REMEDY}"
        if len(changed)
        else ""
    )
    return Written(summary, claims, files, diagnoses, told)


def _reference(experiment: Experiment, ensemble: Ensemble) -> str | None:
    """Return the recorded channel that a method takes as the applied disturbance, if any."""
    every = (item for method in experiment.named_methods.values() for item in method.inputs)
    return next(
        (
            item.name
            for item in every
            if item.kind == "reference" and item.name in ensemble.channels
        ),
        None,
    )


def _write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    for name, table in tables.items():
        with whole_file(folder / name) as file:
            table.to_csv(file, index=False, float_format="%.6g")


def _experiment_pictures(
    experiment: Experiment,
    results: xr.Dataset,
    summary: pd.DataFrame,
    prepared: Sequence[Prepared],
    folder: Path,
    pool: Executor | None,
) -> dict[str, Picture]:
    """Draw and save everything; returns those of the page, by the stems of their files."""
    excerpts, preparations = {}, {}
    who = representative(results, summary)
    for item in prepared:
        if item.recorded.participant == who and item.ensemble is not None:
            with suppress(InputError):  # a file that is gone since
                excerpts[item.recorded.label], preparations[item.recorded.label] = shown(
                    experiment, item.recorded
                )
    illustrations = experiment_figures(results, summary, excerpts, preparations)
    pictures = draw_all(illustrations | participant_figures(results), folder, pool)
    return {name: pictures[name] for name in illustrations}
