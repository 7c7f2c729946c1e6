"""All figures of an experiment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import (
    Illustration,
    error_against_truth,
    participant_in_detail,
    preparation_steps,
    recorded_signals,
    stiffness_of_participants,
    stiffness_with_bands,
    variance_and_spread,
)
from tvsysid.figures.results import (
    OVER_TIME,
    TORQUES,
    knows_truth,
    least_data,
    seconds_of_data,
    unique,
)
from tvsysid.figures.spread import SPREAD
from tvsysid.figures.words import perturbation_name
from tvsysid.preprocess import Preparation
from tvsysid.signals import Recording
from tvsysid.studies.pictures import in_words

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

PAPER = "van de Ruit et al. 2021"
SHOWN = [*OVER_TIME, *TORQUES]


def experiment_figures(
    results: xr.Dataset,
    summary: pd.DataFrame,
    excerpts: Mapping[str, Recording],
    preparations: Mapping[str, Preparation],
) -> dict[str, Illustration]:
    """Return all figures of an experiment.

    By the stem of a file's name: ``"participants"`` (the paper's figure 8), ``"participant"``
    (figure 9), ``"variance-and-spread"`` (figure 10), ``"error-against-truth"`` where the truth is
    known, ``"stiffness"`` instead of the first where there is only one recording,
    ``"recorded-signals"`` (figure 6) and ``"preparation"`` (figure 7).

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    excerpts, preparations
        By the labels of one participant's recordings, some seconds of them and how ensembles came
        about. May be empty.
    """
    shown: dict[str, Illustration] = {}

    def add(stem: str, title: str, text: str, draw: Callable[..., Figure], *data: Any) -> None:
        shown[stem] = Illustration(partial(draw, *data, title), title, text)

    one, own = representative(results, summary), results.sel(quantity="stiffness")
    least = least_data(results).items()
    amounts = ", ".join(f"{method} {seconds_of_data(own, label)}" for method, label in least)
    drawn = (
        f"a line or a column for each method, from the least data ({amounts}), beside the truth "
        "and the torque to be followed where they are known"
    )
    if own.sizes["recording"] == 1:
        label = str(own.recording.values[0])
        add(
            "stiffness",
            f"Stiffness in {label}",
            "Stiffness over one realization: mean and two standard deviations over bootstraps, "
            f"{drawn}. {_means(summary, 'mean_stiffness', 'vaf')}",
            stiffness_with_bands, own[SHOWN], label,
        )  # fmt: skip
    else:
        add(
            "participants",
            "Stiffness of all participants",
            f"Like figure 8 of {PAPER}: stiffness over one realization, mean over bootstraps: "
            f"a row for each perturbation, {drawn}. {_means(summary, 'mean_stiffness', 'vaf')}",
            stiffness_of_participants, own[SHOWN],
        )  # fmt: skip
    mine = summary[summary.participant == one]
    add(
        "participant",
        f"Participant {one} in detail",
        f"Like figure 9 of {PAPER}: stiffness and time-varying VAF of participant {one}, whose VAF "
        "is in the middle of all: mean and two standard deviations over bootstraps, "
        f"{drawn}. {_means(mine, 'mean_stiffness', 'random_error', 'vaf')}",
        participant_in_detail, _of(own, one), one,
    )  # fmt: skip
    add(
        "variance-and-spread",
        "VAF and random error of all methods",
        f"Like figure 10 of {PAPER}. Bars: mean over participants of the VAF of the whole torque, "
        "of that between 1 and 10 Hz, and of the random error, with two standard deviations over "
        "participants; dots: single participants. VAF is that of the realizations that the model "
        f"was identified from. {_means(summary, *SPREAD)}",
        variance_and_spread, summary,
    )  # fmt: skip
    if knows_truth(own):
        add(
            "error-against-truth",
            "Error against the truth",
            "How far the mean estimate over bootstraps is from the true stiffness of virtual "
            f"participants, {drawn}: above over time, a thin line for each participant and a thick "
            "one for their mean; below as bars with two standard deviations over participants. "
            f"{_means(summary, 'bias_error', 'mean_bias')}",
            error_against_truth, own[SHOWN], summary,
        )  # fmt: skip
    if excerpts:
        perturbations = own.perturbation.to_series().map(perturbation_name)
        pieces = {perturbations[label]: each for label, each in excerpts.items()}
        first = next(iter(pieces.values()))
        sizes = "; ".join(
            f"{words}: angle {1000 * np.std(each.angle):.3g} mrad, torque "
            f"{np.std(each.torque):.3g} N·m (SD)"
            for words, each in pieces.items()
        )
        add(
            "recorded-signals",
            f"{first.duration:.3g} s of what was recorded from {one}",
            f"Like figure 6 of {PAPER}: angle and torque at {first.sampling_rate:g} Hz, and the "
            f"torque to be followed if there is one, a row for each perturbation. {sizes}.",
            recorded_signals, pieces,
        )  # fmt: skip
    for label, preparation in list(preparations.items())[:1]:
        steps = "; ".join(
            f"{name}: {np.count_nonzero(~step.kept)} excluded"
            for name, step in preparation.steps.items()
        )
        add(
            "preparation",
            f"Preparation of {label}",
            f"Like figure 7 of {PAPER}. Above: the torque of all {len(preparation.recorded)} "
            f"realizations as it was recorded, and that of the {len(preparation.ensemble)} that "
            "were kept, aligned if there is a target, with their mean subtracted. Below, the "
            f"signal that each step compares, with its mean and limits. {steps or 'No step'}.",
            preparation_steps, preparation,
        )  # fmt: skip
    return shown


def participant_figures(results: xr.Dataset) -> dict[str, Illustration]:
    """Return the detailed figures of every participant, by the stem of the file's name."""
    own, endings = results.sel(quantity="stiffness"), ("png", "pdf")
    titles = {who: f"Participant {who} in detail" for who in unique(own.participant.values)}
    return {
        f"participants/{who}": Illustration(
            partial(participant_in_detail, _of(own, who), who, title), title, endings=endings
        )
        for who, title in titles.items()
    }


def representative(results: xr.Dataset, summary: pd.DataFrame) -> str:
    """Return the representative participant: most analyses with a VAF, and a median mean VAF."""
    rows = summary[summary.metric == "vaf"].dropna(subset=["value"])
    if rows.empty:
        return str(results.participant.values[0])
    each = rows.groupby("participant", sort=False).value.agg(["count", "mean"])
    complete = each[each["count"] == each["count"].max()].sort_values("mean", kind="stable")
    return str(complete.index[(len(complete) - 1) // 2])


def _of(results: xr.Dataset, participant: str) -> xr.Dataset:
    return results[SHOWN].isel(recording=results.participant.values == participant)


def _means(summary: pd.DataFrame, *metrics: str) -> str:
    """Return means over participants, by perturbation, method and number of realizations."""
    by = ["perturbation", "method", "realizations"]
    means = summary.groupby([*by, "metric", "unit"], sort=False).value.mean().reset_index()
    return in_words(means, by, metrics)
