"""All figures of an experiment."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from tvsysid.figures import (
    Illustration,
    error_against_truth,
    participant_in_detail,
    preparation_steps,
    recorded_signals,
    stiffness_of_participants,
    variance_and_spread,
)
from tvsysid.figures.results import headings, is_known, of_least_data, unique
from tvsysid.figures.words import perturbation_name
from tvsysid.preprocess import Preparation
from tvsysid.signals import Recording

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PAPER = "van de Ruit et al. 2021"
DETAIL = "Participant {} in detail"


def experiment_figures(
    results: xr.Dataset,
    summary: pd.DataFrame,
    excerpts: Mapping[str, Recording],
    preparations: Mapping[str, Preparation],
) -> dict[str, Illustration]:
    """Return all figures of an experiment.

    By the stem of a file's name: ``"participants"`` (the paper's figure 8), ``"participant"``
    (figure 9), ``"variance-and-spread"`` (figure 10), ``"error-against-truth"`` where the truth is
    known, ``"recorded-signals"`` (figure 6) and ``"preparation"`` (figure 7).

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    excerpts, preparations
        By the labels of one participant's recordings, some seconds of them and how ensembles came
        about. May be empty.
    """
    one, own = representative(results, summary), results.sel(quantity="stiffness")
    amounts = "; ".join(headings(of_least_data(results), 60))
    drawn = (
        f"a line or a column for each method, from the least data ({amounts}), beside the truth "
        "and the torque to be followed where they are known. The table of metrics has the numbers."
    )
    shown: dict[str, Illustration] = {}
    title = "Stiffness of all participants"
    shown["participants"] = Illustration(
        partial(stiffness_of_participants, own, title),
        title,
        f"Like figure 8 of {PAPER}: stiffness over one realization, mean over bootstraps: "
        f"a row for each participant, a column for each perturbation, {drawn}",
    )
    shown["participant"] = Illustration(
        partial(participant_in_detail, own, one, DETAIL.format(one)),
        DETAIL.format(one),
        f"Like figure 9 of {PAPER}: stiffness and time-varying VAF of participant {one}, whose VAF "
        f"is in the middle of all: mean and two standard deviations over bootstraps, {drawn}",
    )
    title = "VAF and random error of all methods"
    shown["variance-and-spread"] = Illustration(
        partial(variance_and_spread, summary, title),
        title,
        f"Like figure 10 of {PAPER}. Bars: mean over participants of the VAF of the whole torque, "
        "of that between 1 and 10 Hz, and of the random error, with two standard deviations over "
        "participants; dots: single participants. VAF is that of the realizations that the model "
        "was identified from.",
    )
    if is_known(own):
        title = "Error against the truth"
        shown["error-against-truth"] = Illustration(
            partial(error_against_truth, own, summary, title),
            title,
            "How far the mean estimate over bootstraps is from the true stiffness of virtual "
            "participants: above over time, a thin line for each participant and a thick one for "
            "their mean; below as bars with two standard deviations over participants.",
        )
    if excerpts:
        names = own.perturbation.to_series().map(perturbation_name)
        pieces = {names[label]: each for label, each in excerpts.items()}
        first = next(iter(pieces.values()))
        title = f"{first.duration:.3g} s of what was recorded from {one}"
        shown["recorded-signals"] = Illustration(
            partial(recorded_signals, pieces, title),
            title,
            f"Like figure 6 of {PAPER}: angle and torque at {first.sampling_rate:g} Hz, and the "
            "torque to be followed if there is one, a row for each perturbation.",
        )
    for label, preparation in list(preparations.items())[:1]:
        title = f"Preparation of {label}"
        shown["preparation"] = Illustration(
            partial(preparation_steps, preparation, title),
            title,
            f"Like figure 7 of {PAPER}. Above: the torque of all {len(preparation.recorded)} "
            f"realizations as it was recorded, and that of the {len(preparation.ensemble)} that "
            "were kept, aligned if there is a target, with their mean subtracted. Below, the "
            "signal that each step compares, with its mean and limits.",
        )
    return shown


def participant_figures(results: xr.Dataset) -> dict[str, Illustration]:
    """Return the detailed figures of every participant, by the stem of the file's name."""
    own = results.sel(quantity="stiffness")
    return {
        f"participants/{who}": Illustration(
            partial(participant_in_detail, own, who, DETAIL.format(who)),
            DETAIL.format(who),
            endings=("png", "pdf"),
        )
        for who in unique(own.participant.values)
    }


def representative(results: xr.Dataset, summary: pd.DataFrame) -> str:
    """Return the representative participant: most analyses with a VAF, and a median mean VAF."""
    rows = summary[summary.metric == "vaf"].dropna(subset=["value"])
    if rows.empty:
        return str(results.participant.values[0])
    each = rows.groupby("participant", sort=False).value.agg(["count", "mean"])
    complete = each[each["count"] == each["count"].max()].sort_values("mean", kind="stable")
    return str(complete.index[(len(complete) - 1) // 2])
