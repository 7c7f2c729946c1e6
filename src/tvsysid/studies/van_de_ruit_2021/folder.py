"""Write an experiment's tables, ensembles, figures and pages to its folder."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.comparison import compare
from tvsysid.errors import DataQualityWarning
from tvsysid.figures import (
    Illustration,
    participant_in_detail,
    preparation_steps,
    recorded_signals,
    stiffness_of_participants,
    variance_and_spread,
)
from tvsysid.figures.results import headings, of_least_data
from tvsysid.figures.words import perturbation_name
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Diagnosis
from tvsysid.recordings import write_ensemble
from tvsysid.report import write_diagnosis, write_experiment_report
from tvsysid.report.page import in_text
from tvsysid.studies.published_study import Written, illustrated, write_outcome
from tvsysid.studies.van_de_ruit_2021.experiment import judge_experiment
from tvsysid.study import Prepared, exclusions, stiffness_over_time, summarize

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PAPER = "van de Ruit et al. 2021"


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


def stiffness_to_report(
    prepared: Sequence[Prepared], results: xr.Dataset
) -> tuple[pd.DataFrame, dict[str, Diagnosis]]:
    """Return the answer for each recording, as :func:`tvsysid.compare` gives it, and its faults.

    Methods with a reference channel take the place of the usual ones, if the experiment has any.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    methods = [each for each in dict.fromkeys(results.method_key.values) if "reference=" in each]
    rows, diagnoses = [], {}
    for item in prepared:
        label, stiffness, method, why = item.recorded.label, "none", "", item.failure
        if item.ensemble:
            with warnings.catch_warnings(action="ignore", category=DataQualityWarning):
                found = compare(item.ensemble, methods)
            answer, diagnosis = found.answer, found.recommendation.diagnosis
            method, why = answer.label, " ".join(answer.reasons)
            if answer.is_stated:
                stiffness = in_text(mean_of(answer.stiffness), answer.half_band, 1)
            if isinstance(diagnosis, Diagnosis):
                diagnoses[label] = diagnosis
        rows.append((label, stiffness, method, why))
    columns = ["recording", "stiffness (N·m/rad)", "method", "doubts"]
    return pd.DataFrame(rows, columns=columns), diagnoses


def experiment_figures(
    results: xr.Dataset, summary: pd.DataFrame, prepared: Sequence[Prepared]
) -> dict[str, Illustration]:
    """Return all figures of an experiment's page.

    By the stem of a file's name: ``"participants"`` (the paper's figure 8), ``"participant"``
    (figure 9), ``"variance-and-spread"`` (figure 10), ``"recorded-signals"`` (figure 6) and
    ``"preparation"`` (figure 7).

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    prepared
        Recordings whose signals can be drawn; those of one participant are.
    """
    one, own = representative(results), results.sel(quantity="stiffness")
    drawn = (
        "a line or a column for each method, from the least data "
        f"({'; '.join(headings(of_least_data(results), 60))}), beside the truth and the torque to "
        "be followed where they are known. The table of metrics has the numbers."
    )
    shown = {
        "participants": illustrated(
            stiffness_of_participants,
            own,
            title="Stiffness of all participants",
            text=f"Like figure 8 of {PAPER}: stiffness over one realization, mean over bootstraps: "
            f"a row for each participant, a column for each perturbation, {drawn}",
        ),
        "participant": illustrated(
            participant_in_detail,
            *(own, one),
            title=f"Participant {one} in detail",
            text=f"Like figure 9 of {PAPER}: stiffness and time-varying VAF of participant {one}, "
            "whose VAF is in the middle of all: mean and two standard deviations over bootstraps, "
            f"{drawn}",
        ),
        "variance-and-spread": illustrated(
            variance_and_spread,
            summary,
            title="VAF and errors of all methods",
            text=f"Like figure 10 of {PAPER}. Bars: mean over participants of the VAF of the whole "
            "torque, of that between 1 and 10 Hz, of the random error and, where the truth is "
            "known, of both biases, with two standard deviations over participants; dots: single "
            "participants.",
        ),
    }
    mine = {
        perturbation_name(each.recorded.perturbation): each
        for each in prepared
        if each.ensemble and each.recorded.participant == one
    }
    if mine:
        first, excerpts = next(iter(mine.values())), {name: mine[name].excerpt for name in mine}
        shown["recorded-signals"] = illustrated(
            recorded_signals,
            excerpts,
            title=f"What was recorded from {one}",
            text=f"Like figure 6 of {PAPER}: angle and torque, and the torque to be followed if "
            "there is one, a row for each perturbation.",
        )
        shown["preparation"] = illustrated(
            preparation_steps,
            first.preparation,
            title=f"Preparation of {first.recorded.label}",
            text=f"Like figure 7 of {PAPER}. Above: the torque of all realizations as it was "
            "recorded, and that of those that were kept, aligned if there is a target, with their "
            "mean subtracted. Below, the signal that each step compares, with its mean and limits.",
        )
    return shown


def representative(results: xr.Dataset) -> str:
    """Return the participant with a median mean VAF; one with a failed recording counts last."""
    vaf = results.vaf.mean(["analysis", "bootstrap"]).groupby("participant").mean(skipna=False)
    return str(vaf.participant[vaf.argsort()[(vaf.size - 1) // 2]].item())
