"""All figures of an experiment."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
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
    ``"recorded-signals"`` (figure 6) and ``"preparation"`` (figure 7). The figures of one
    participant show the representative one.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    excerpts, preparations
        By the recordings' labels, some seconds of them and how ensembles came about; those of one
        participant are drawn. May be empty.
    """
    one = representative(results, summary)
    data = results[[*OVER_TIME, *TORQUES]].sel(quantity="stiffness")
    stiffness = _in_words(summary, "mean_stiffness", "vaf")
    amounts = ", ".join(
        f"{method} {seconds_of_data(results, label)}"
        for method, label in least_data(results).items()
    )
    drawn = f"a line or a column for each method, from the least data ({amounts}){_beside(results)}"
    if results.sizes["recording"] == 1:
        label = str(results.recording.values[0])
        shown = {
            "stiffness": _illustration(
                f"Stiffness in {label}",
                "Stiffness over one realization: mean and two standard deviations over bootstraps, "
                f"{drawn}. {stiffness}",
                stiffness_with_bands, data, label,
            )
        }  # fmt: skip
    else:
        shown = {
            "participants": _illustration(
                "Stiffness of all participants",
                f"Like figure 8 of {PAPER}: stiffness over one realization, mean over bootstraps: "
                f"a row for each perturbation, {drawn}. {stiffness}",
                stiffness_of_participants, data,
            )
        }  # fmt: skip
    mine = summary[summary.participant == one]
    shown["participant"] = _illustration(
        f"Participant {one} in detail",
        f"Like figure 9 of {PAPER}: stiffness and time-varying VAF of participant {one}, whose VAF "
        "is in the middle of all: mean and two standard deviations over bootstraps, "
        f"{drawn}. {_in_words(mine, 'mean_stiffness', 'random_error', 'vaf')}",
        participant_in_detail, _of(data, one), one,
    )  # fmt: skip
    if len(summary):
        shown["variance-and-spread"] = _illustration(
            "VAF and random error of all methods",
            f"Like figure 10 of {PAPER}. Bars: mean over participants of the VAF of the whole "
            "torque, of that between 1 and 10 Hz, and of the random error, with two standard "
            "deviations over participants; dots: single participants. VAF is that of the "
            f"realizations that the model was identified from. {_in_words(summary, *SPREAD)}",
            variance_and_spread, summary,
        )  # fmt: skip
    if len(summary) and knows_truth(results):
        shown["error-against-truth"] = _illustration(
            "Error against the truth",
            "How far the mean estimate over bootstraps is from the true stiffness of virtual "
            f"participants, {drawn}: above over time, a thin line for each participant and a thick "
            "one for their mean; below as bars with two standard deviations over participants. "
            f"{_in_words(summary, 'bias_error', 'mean_bias')}",
            error_against_truth, data, summary,
        )  # fmt: skip
    if recorded := _of_one(excerpts, results, one):
        here = results.sel(recording=recorded)
        names = map(perturbation_name, here.perturbation.values)
        shown["recorded-signals"] = _signals(
            {name: excerpts[label] for name, label in zip(names, recorded, strict=True)},
            str(here.participant.values[0]),
        )
    if prepared := _of_one(preparations, results, one):
        shown["preparation"] = _preparation(
            preparations[prepared[0]], results.sel(recording=prepared[0])
        )
    return shown


def participant_figures(results: xr.Dataset) -> dict[str, Illustration]:
    """Return the detailed figures of every participant, by the stem of the file's name."""
    data = results[[*OVER_TIME, *TORQUES]].sel(quantity="stiffness")
    return {
        f"participants/{who}": attrs.evolve(
            _illustration(
                f"Participant {who} in detail", "", participant_in_detail, _of(data, who), who
            ),
            endings=("png", "pdf"),
        )
        for who in unique(results.participant.values)
    }


def representative(results: xr.Dataset, summary: pd.DataFrame) -> str:
    """Return the representative participant: most analyses with a VAF, and a median mean VAF."""
    rows = summary[summary.metric == "vaf"].dropna(subset=["value"])
    if rows.empty:
        return str(results.participant.values[0])
    each = rows.groupby("participant", sort=False).value.agg(["count", "mean"])
    complete = each[each["count"] == each["count"].max()].sort_values("mean", kind="stable")
    return str(complete.index[(len(complete) - 1) // 2])


def _illustration(title: str, text: str, draw: Callable[..., Figure], *data: Any) -> Illustration:
    return Illustration(partial(draw, *data, title), title, text)


def _in_words(summary: pd.DataFrame, *metrics: str) -> str:
    """Return means over participants, by perturbation, method and number of realizations."""
    by = ["perturbation", "method", "realizations"]
    means = summary.groupby([*by, "metric", "unit"], sort=False).value.mean().reset_index()
    return in_words(means, by, metrics)


def _beside(results: xr.Dataset) -> str:
    """Return what is drawn beside the estimates, in words."""
    target = np.isfinite(results.target_torque.values).any()
    return f"{', against the true stiffness' if knows_truth(results) else ''}" + (
        ", above the torque to be followed" if target else ""
    )


def _of(results: xr.Dataset, participant: str) -> xr.Dataset:
    return results.isel(recording=results.participant.values == participant)


def _of_one(given: Container[str], results: xr.Dataset, preferred: str) -> list[str]:
    """Return labels of the given recordings of a participant, the preferred one if there."""
    people = results.participant.to_series()
    people = people[[label in given for label in people.index]]
    chosen = people[people == preferred]
    return list(chosen.index if len(chosen) else people[people == people.iloc[:1].sum()].index)


def _signals(pieces: Mapping[str, Recording], participant: str) -> Illustration:
    first = next(iter(pieces.values()))
    target = ", and the torque to be followed" if "target" in first.channels else ""
    sizes = "; ".join(
        f"{words}: angle {1000 * float(np.std(each.angle)):.3g} mrad, torque "
        f"{float(np.std(each.torque)):.3g} N·m (SD)"
        for words, each in pieces.items()
    )
    return _illustration(
        f"{first.duration:.3g} s of what was recorded from {participant}",
        f"Like figure 6 of {PAPER}: angle and torque at {first.sampling_rate:g} Hz{target}, a row "
        f"for each perturbation. {sizes}.",
        recorded_signals, pieces,
    )  # fmt: skip


def _preparation(preparation: Preparation, here: xr.Dataset) -> Illustration:
    steps = "; ".join(
        f"{name}: {np.count_nonzero(~step.kept)} excluded"
        for name, step in preparation.steps.items()
    )
    return _illustration(
        f"Preparation of {here.participant.item()}, {perturbation_name(here.perturbation.item())}",
        f"Like figure 7 of {PAPER}. Above: the torque of all {len(preparation.recorded)} "
        f"realizations as it was recorded, and that of the {len(preparation.ensemble)} that were "
        "kept, aligned if there is a target, with their mean subtracted. Below, the signal that "
        f"each step compares, with its mean and limits. {steps or 'No step'}.",
        preparation_steps, preparation,
    )  # fmt: skip
