"""Write an experiment's tables, ensembles, figures and pages to its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

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
from tvsysid.quality import diagnose
from tvsysid.recordings import write_ensemble
from tvsysid.report import write_diagnosis, write_experiment_report
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
    files, diagnoses = ["report.html", "figures/"], {}
    if prepared:
        tables["exclusions.csv"] = exclusions(prepared)
        for each in prepared:
            if each.ensemble:
                label = each.recorded.label
                write_ensemble(folder / "prepared" / f"{label}.nc", each.ensemble)
                diagnoses[label] = diagnose(each.ensemble, each.reference)
        write_diagnosis(folder / "diagnosis.html", diagnoses, command)
        files += ["prepared/", "diagnosis.html"]
    pictures = write_outcome(folder, tables, experiment_figures(results, summary, prepared))
    write_experiment_report(folder / "report.html", results, summary, claims, pictures, command)
    return Written(summary, claims, [*files, *tables], diagnoses)


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
