"""All figures of an experiment."""

from __future__ import annotations

from collections.abc import Container, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures.participants import (
    participant_in_detail,
    stiffness_of_participants,
    stiffness_with_bands,
)
from tvsysid.figures.recorded import preparation_steps, recorded_signals
from tvsysid.figures.results import (
    OVER_TIME,
    TORQUES,
    knows_truth,
    least_data,
    seconds_of_data,
    truth,
    unique,
)
from tvsysid.figures.saving import Illustration
from tvsysid.figures.spread import SPREAD, error_against_truth, variance_and_spread
from tvsysid.figures.words import count, perturbation_name
from tvsysid.preprocess import Preparation
from tvsysid.signals import Recording

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PAPER = "van de Ruit et al. 2021"
METRICS = {
    "mean_stiffness": "mean stiffness",
    "vaf": "VAF",
    "bandpassed_vaf": "VAF 1–10 Hz",
    "random_error": "random error",
    "bias_error": "bias error",
    "mean_bias": "mean bias",
}
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
    ``"recorded-signals"`` (figure 6) and ``"preparation"`` (figure 7). Where one participant stands
    for all, it is the one whose VAF is in the middle.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    excerpts, preparations
        By the recordings' labels, some seconds of them and how ensembles came about; those of one
        participant are drawn. May be empty.
    """
    one = representative(results, summary)
    shown = _stiffness(results, summary) | {"participant": _detail(results, summary, one)}
    if len(summary):
        shown |= _metrics(results, summary)
    if recorded := _of_one(excerpts, results, one):
        here = results.sel(recording=recorded)
        names = map(perturbation_name, here.perturbation.values)
        pieces = {name: excerpts[label] for name, label in zip(names, recorded, strict=True)}
        shown["recorded-signals"] = _signals(pieces, str(here.participant.values[0]))
    if prepared := _of_one(preparations, results, one):
        shown["preparation"] = _preparation(preparations[prepared[0]], results, prepared[0])
    return shown


def participant_figures(results: xr.Dataset) -> dict[str, Illustration]:
    """Return the detailed figures of every participant, by the stem of the file's name."""
    people = unique(results.participant.values)
    titles = {who: f"Participant {who} in detail" for who in people}
    return {
        f"participants/{who}": Illustration(
            partial(participant_in_detail, _of(results, who), who, titles[who]),
            titles[who],
            endings=("png", "pdf"),
        )
        for who in people
    }


def _of(results: xr.Dataset, participant: str) -> xr.Dataset:
    """Return the figures of one participant."""
    return (
        results[SHOWN]
        .sel(quantity="stiffness")
        .isel(recording=results.participant.values == participant)
    )


def _of_one(given: Container[str], results: xr.Dataset, preferred: str) -> list[str]:
    """Return labels of a participant's usable recordings, of the preferred perturbation if any."""
    people = {
        str(label): str(person)
        for label, person in zip(results.recording.values, results.participant.values, strict=True)
        if str(label) in given
    }
    who = preferred if preferred in people.values() else next(iter(people.values()), None)
    return [label for label, person in people.items() if person == who]


def representative(results: xr.Dataset, summary: pd.DataFrame) -> str:
    """Return the representative participant: most analyses with a VAF, and a median mean VAF."""
    participants = unique(results.participant.values)
    rows = summary[(summary.metric == "vaf") & np.isfinite(summary.value.astype(float))]
    if rows.empty:
        return participants[0]
    each = rows.groupby("participant", sort=False).value.agg(["count", "mean"])
    complete = each[each["count"] == each["count"].max()].sort_values("mean", kind="stable")
    return str(complete.index[(len(complete) - 1) // 2])


def _stiffness(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return the figure of all participants, or of the only recording."""
    shown, told = (
        results[SHOWN].sel(quantity="stiffness"),
        f"({_amounts(results)}){_truth(results)}. ",
    )
    if results.sizes["recording"] == 1:
        label = str(results.recording.values[0])
        title = f"Stiffness in {label}"
        text = (
            "Stiffness over one realization: mean and two standard deviations over bootstraps, a "
            f"column for each method {told}{_grey(results)}{_sentences(summary)}"
        )
        return {
            "stiffness": Illustration(
                partial(stiffness_with_bands, shown, label, title), title, text
            )
        }
    people = len(unique(results.participant.values))
    title = f"Stiffness of {'all participants' if people > 1 else 'the participant'}"
    text = (
        f"Like figure 8 of {PAPER}: stiffness over one realization, mean over bootstraps, of "
        f"{count(people, 'participant')}: a row for each perturbation, a line for each method "
        f"{told}{_torque(results)}{_sentences(summary)}"
    )
    return {
        "participants": Illustration(partial(stiffness_of_participants, shown, title), title, text)
    }


def _detail(results: xr.Dataset, summary: pd.DataFrame, participant: str) -> Illustration:
    title = f"Participant {participant} in detail"
    middle = (
        ", whose VAF is in the middle of all" if len(unique(results.participant.values)) > 1 else ""
    )
    rows = summary[summary.participant == participant]
    text = (
        f"Like figure 9 of {PAPER}: stiffness and time-varying VAF of participant "
        f"{participant}{middle}: mean and two standard deviations over bootstraps, a column for "
        f"each method ({_amounts(results)}){_truth(results)}. "
        f"{_grey(results)}{_sentences(rows, ('mean_stiffness', 'random_error', 'vaf'))}"
    )
    return Illustration(
        partial(participant_in_detail, _of(results, participant), participant, title), title, text
    )


def _metrics(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return the metrics of all participants, and errors where the truth is known."""
    title = "VAF and random error of all methods"
    text = (
        f"Like figure 10 of {PAPER}. Bars: mean over participants of the VAF of the whole torque, "
        "of that between 1 and 10 Hz, and of the random error, with two standard deviations over "
        "participants; dots: single participants. VAF is that of the realizations that the model "
        f"was identified from. {_sentences(summary, tuple(SPREAD), least=False)}"
    )
    shown = {
        "variance-and-spread": Illustration(
            partial(variance_and_spread, summary, title), title, text
        )
    }
    if knows_truth(results):
        title = "Error against the truth"
        people = unique(results.participant.values[np.isfinite(truth(results).values).any(axis=1)])
        text = (
            "How far the mean estimate over bootstraps is from the true stiffness of "
            f"{count(len(people), 'virtual participant')}: above over time, a thin line for each "
            f"and a thick one for their mean ({_amounts(results)}); below as bars with two "
            "standard deviations over participants. "
            f"{_sentences(summary, ('bias_error', 'mean_bias'))}"
        )
        drawing = partial(
            error_against_truth, results[SHOWN].sel(quantity="stiffness"), summary, title
        )
        shown["error-against-truth"] = Illustration(drawing, title, text)
    return shown


def _signals(pieces: Mapping[str, Recording], participant: str) -> Illustration:
    first = next(iter(pieces.values()))
    title = f"{first.duration:.3g} s of what was recorded from {participant}"
    target = ", and the torque to be followed" if "target" in first.channels else ""
    described = "; ".join(
        f"{words}: angle {1000 * float(np.std(each.angle)):.3g} mrad, torque "
        f"{float(np.std(each.torque)):.3g} N·m (SD)"
        for words, each in pieces.items()
    )
    like = f"Like figure 6 of {PAPER}"
    text = (
        f"{like}: angle and torque at {first.sampling_rate:g} Hz{target}, a row for each "
        f"perturbation. {described}."
    )
    return Illustration(partial(recorded_signals, pieces, title), title, text)


def _preparation(preparation: Preparation, results: xr.Dataset, label: str) -> Illustration:
    here = results.sel(recording=label)
    title = (
        f"Preparation of {here.participant.item()}, {perturbation_name(here.perturbation.item())}"
    )
    aligned = "aligned and with" if "alignment" in preparation.steps else "with"
    done = {
        "alignment": "each is aligned to the torque to be followed (black)",
        "task component": "the component at the task's frequency, with its mean and limits",
        "residual": "the low-passed residual, with its mean and limits",
    }
    steps = "; ".join(
        f"{done[name]}: {np.count_nonzero(~step.kept)} excluded"
        for name, step in preparation.steps.items()
    )
    below = f"Below, step by step: {steps}." if steps else "No step excluded realizations."
    text = (
        f"Like figure 7 of {PAPER}. Above: the torque of all {len(preparation.recorded)} "
        f"realizations as it was recorded, and that of the {len(preparation.ensemble)} that were "
        f"kept, {aligned} their mean subtracted. {below}"
    )
    return Illustration(partial(preparation_steps, preparation, title), title, text)


def _sentences(
    summary: pd.DataFrame, metrics: tuple[str, ...] = ("mean_stiffness", "vaf"), least: bool = True
) -> str:
    """Return the means over participants by method, with the least data or with every amount."""
    sentences = []
    for perturbation in unique(summary.perturbation.to_numpy()):
        parts = []
        for metric in metrics:
            rows = summary[(summary.perturbation == perturbation) & (summary.metric == metric)]
            rows = rows[np.isfinite(rows.value.astype(float))]
            values = []
            for method, mine in rows.groupby("method", sort=False):
                means = mine.groupby("realizations").value.mean()  # sorted by the amount of data
                numbers = " and ".join(
                    f"{each:.3g}".replace("-", "−") for each in (means[:1] if least else means)
                )
                values.append(f"{method} {numbers}")
            if values:
                parts.append(f"{METRICS[metric]} {', '.join(values)} {rows.unit.iloc[0]}")
        if parts:
            sentences.append(f"With {perturbation_name(perturbation)}: {'; '.join(parts)}.")
    order = (
        "Where two or more numbers follow a method, they are those from the least to the most "
        "data. "
    )
    return ("" if least or not sentences else order) + " ".join(sentences)


def _amounts(results: xr.Dataset) -> str:
    """Return the seconds of data that each method is shown with."""
    by_amount: dict[str, list[str]] = {}
    for method, label in least_data(results).items():
        by_amount.setdefault(seconds_of_data(results, label), []).append(method)
    if len(by_amount) == 1:
        return f"{next(iter(by_amount))} of data"
    return "; ".join(
        f"{', '.join(methods)} from {amount} of data" for amount, methods in by_amount.items()
    )


def _torque(results: xr.Dataset) -> str:
    target = (
        " and the torque to be followed" if np.isfinite(results.target_torque.values).any() else ""
    )
    return (
        f"Below, the mean torque{target}. " if np.isfinite(results.mean_torque.values).any() else ""
    )


def _grey(results: xr.Dataset) -> str:
    known = np.isfinite(results.target_torque.values).any()
    return "The grey line is the torque to be followed. " if known else ""


def _truth(results: xr.Dataset) -> str:
    return ", against the true stiffness" if knows_truth(results) else ""
