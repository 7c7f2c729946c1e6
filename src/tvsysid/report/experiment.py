"""The page of an experiment, its figures, and its table of the stiffness to report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tvsysid.comparison import compare
from tvsysid.errors import without_quality_warnings
from tvsysid.figures import (
    Illustration,
    Picture,
    error_against_truth,
    participant_in_detail,
    preparation_steps,
    recorded_signals,
    stiffness_of_participants,
    variance_and_spread,
)
from tvsysid.figures.results import headings, is_known, of_least_data, unique
from tvsysid.figures.saving import illustrated
from tvsysid.figures.words import perturbation_name
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import Diagnosis
from tvsysid.report.diagnosis import diagnosis_picture
from tvsysid.report.page import in_text, render
from tvsysid.report.studies import best_methods, common, metric_columns, settings_of
from tvsysid.study import Prepared

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

# Figures shown in the section about the recordings
DETAILS = ("recorded-signals", "preparation")
COUNTS = {
    "recorded": "recorded",
    "excluded_alignment": "excluded: shift",
    "excluded_task": "excluded: task component",
    "excluded_residual": "excluded: residual",
    "survivors": "kept",
}
"""Column headings of the counts of realizations."""


def write_experiment_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    answers: pd.DataFrame | None = None,
) -> None:
    """Write one HTML file that holds all of an experiment's outcome and needs nothing else.

    The parameters are those of :func:`write_report`, and ``answers``: a row for each recording with
    the stiffness to report, if it is known.
    """
    summary = summary.assign(perturbation=summary.perturbation.map(perturbation_name))
    remarks = dict(zip(results.recording.values, map(str, results.remarks.values), strict=True))
    counts = results[list(COUNTS)].to_dataframe()
    render(
        path,
        "experiment.html",
        **common(results, claims, settings_of(results, "experiment")),
        participants=len(unique(results.participant.values)),
        is_known=is_known(results),
        kept=counts[counts.recorded > 0].groupby("perturbation")[["survivors", "recorded"]].mean(),
        best=best_by_perturbation(summary),
        perturbation_name=perturbation_name,
        metrics=metrics(summary),
        of_participants=metrics(summary, "participant"),
        recordings=counts[list(COUNTS)].rename(columns=COUNTS).reset_index(),
        remarks={label: text.splitlines() for label, text in remarks.items() if text},
        pictures={stem: each for stem, each in pictures.items() if stem not in DETAILS},
        details={stem: each for stem, each in pictures.items() if stem in DETAILS},
        command=command,
        answers=answers,
    )


def best_by_perturbation(summary: pd.DataFrame) -> dict[str, list[dict[str, str]]]:
    """Return the best methods by their means over participants, each from its least data."""
    least = summary.groupby("method").realizations.transform("min")
    groups = summary[summary.realizations == least].groupby(["perturbation", "method", "metric"])
    means = groups.value.agg(value="mean", standard_error="std").reset_index()
    return {str(name): best_methods(mine) for name, mine in means.groupby("perturbation")}


def metrics(summary: pd.DataFrame, *each: str) -> pd.DataFrame:
    """Return the metrics by method, perturbation and amount of data, and by ``each`` of others.

    Numbers are the mean ± standard deviation over participants.
    """
    by = [*each, "method", "perturbation", "realizations", "metric"]
    groups = summary.groupby(by, sort=False).value
    means, deviations = groups.mean().unstack(sort=False), groups.std().unstack(sort=False)
    table: pd.DataFrame = means[[]].assign(**metric_columns(means, deviations)).reset_index()
    return table


REPORTED = ["recording", "stiffness (N·m/rad)", "method", "reasons"]


class ReportedAnswer(NamedTuple):
    """Stiffness to report of a recording, in words (``REPORTED``), and its diagnosis if any."""

    recording: str
    stiffness: str = "none"
    method: str = ""
    reasons: str = ""
    diagnosis: Diagnosis | None = None
    picture: Picture | None = None


def stiffness_to_report(
    prepared: Sequence[Prepared],
    results: xr.Dataset,
    call_each: Callable[..., Iterator[ReportedAnswer]] = map,
) -> Iterator[ReportedAnswer]:
    """Find the answer for each recording, as :func:`tvsysid.compare` gives it.

    Methods with a reference channel take the place of the usual ones, if the experiment has any.
    ``call_each`` is as for :func:`tvsysid.figures.draw_all`.
    """
    methods = [each for each in dict.fromkeys(results.method_key.values) if "reference=" in each]
    return call_each(partial(_answer_for, methods=methods), prepared)


@single_thread()
def _answer_for(item: Prepared, methods: Sequence[str]) -> ReportedAnswer:
    label = item.recorded.label
    if not item.ensemble:
        return ReportedAnswer(label, reasons=item.failure)
    with without_quality_warnings():
        found = compare(item.ensemble, methods)
    answer, diagnosis = found.answer, found.recommendation.diagnosis
    stated = in_text(mean_of(answer.stiffness), answer.half_band, 1) if answer.is_stated else "none"
    reasons = " ".join(answer.reasons)
    if answer.trust == "doubtful":
        reasons = f"Doubtful. {reasons}"
    row = ReportedAnswer(label, stated, answer.label, reasons)
    if isinstance(diagnosis, Diagnosis):
        return row._replace(diagnosis=diagnosis, picture=diagnosis_picture(diagnosis, label))
    return row


def experiment_figures(
    results: xr.Dataset, summary: pd.DataFrame, prepared: Sequence[Prepared]
) -> dict[str, Illustration]:
    """Return all figures of an experiment's page.

    By the stem of a file's name: ``"participants"`` (figure 8 of the paper), ``"participant"``
    (figure 9), ``"variance-and-spread"`` (figure 10), ``"error-against-truth"`` if it is known,
    ``"recorded-signals"`` (figure 6) and ``"preparation"`` (figure 7).

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    prepared
        Recordings whose signals can be drawn; those of one participant are.
    """
    one, own = representative(results), results.sel(quantity=["stiffness"])
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
            text="Stiffness over one realization, mean over bootstraps: a row for each "
            f"participant, a column for each perturbation, {drawn}",
        ),
        "participant": illustrated(
            participant_in_detail,
            *(own, one),
            title=f"Participant {one} in detail",
            text=f"Stiffness and time-varying VAF of participant {one}, whose VAF is in the "
            f"middle of all: mean and two standard deviations over bootstraps, {drawn}",
        ),
        "variance-and-spread": illustrated(
            variance_and_spread,
            summary,
            title="VAF and errors of all methods",
            text="Bars: mean over participants of the VAF of the whole torque, of that between 1 "
            "and 10 Hz, of the random error and, where the truth is known, of both biases, with "
            "two standard deviations over participants. Dots: single participants.",
        ),
    }
    if is_known(results):
        shown["error-against-truth"] = illustrated(
            error_against_truth,
            own,
            title="Error against the truth",
            text="Mean estimate over bootstraps minus the true stiffness of virtual participants: "
            "mean and two standard deviations over participants.",
        )
    mine = [each for each in prepared if each.ensemble and each.recorded.participant == one]
    if mine:
        excerpts = {perturbation_name(each.recorded.perturbation): each.excerpt for each in mine}
        shown["recorded-signals"] = illustrated(
            recorded_signals,
            excerpts,
            title=f"What was recorded from {one}",
            text="Angle and torque, and the torque to be followed if there is one, a row for each "
            "perturbation.",
        )
        shown["preparation"] = illustrated(
            preparation_steps,
            mine[0].preparation,
            title=f"Preparation of {mine[0].recorded.label}",
            text="First, the torque of all realizations as it was recorded, and that of those that "
            "were kept, aligned if there is a target, with their mean subtracted. Then the signal "
            "that each step compares, with its mean and limits.",
        )
    return shown


def representative(results: xr.Dataset) -> str:
    """Return the participant with a median mean VAF; one with a failed recording counts last."""
    vaf = results.vaf.mean(["analysis", "bootstrap"]).groupby("participant").mean(skipna=False)
    ranked = vaf.to_series().sort_values().index
    return str(ranked[(len(ranked) - 1) // 2])
