"""Figures of a simulation study, and of an experiment."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from tvsysid.figures import (
    Illustration,
    error_against_amount,
    error_against_truth,
    impulse_responses,
    participant_in_detail,
    preparation_steps,
    recorded_signals,
    stiffness_of_participants,
    variance_and_spread,
)
from tvsysid.figures.results import headings, is_known, of_least_data, scenario_traits, unique
from tvsysid.figures.words import described, perturbation_name
from tvsysid.methods import BasisIRF, EnsembleIRF, ShortDataSegments
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.studies.pictures import differing_in, illustrated, scenario_figures
from tvsysid.study import Prepared
from tvsysid.study.scenarios import RATE, Scenario, Study
from tvsysid.study.trials import draw

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SCENARIO = Scenario("square", "prbs", 150.0, 10.0)
INSTANTS = (0.25, 1.0)  # times in s, half-way between two switches: low and high stiffness
AMOUNTS = {"duration_s": ("the amount of data", ""), "snr_db": ("noise", "-snr")}
"""Words for the title of a figure, and ending of the file's stem, by what varies."""
FIXED = ("system", "profile", "viscosity")
PAPER = "van de Ruit et al. 2021"


def study_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a simulation study.

    By the stem of a file's name: those of :func:`scenario_figures`, such as
    ``"comparison-square-noise"``; ``"amount-square"`` (errors against seconds of data) and
    ``"amount-square-snr"``; ``"impulse-responses"``; with ``-covarying`` where the viscosity varies
    with stiffness.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    """
    shown: dict[str, Illustration] = {}
    traits = scenario_traits(results)
    for (profile, viscosity), rows in traits.groupby(["profile", "viscosity"], sort=False):
        stem = f"{profile}-covarying" if viscosity == "covarying" else str(profile)
        for perturbation, mine in rows.groupby("perturbation", sort=False):
            own = f"{stem}-{perturbation}"
            shown |= scenario_figures(results, summary, own, list(mine.index))
        for size, (against, ending) in AMOUNTS.items():
            amounts = differing_in(rows, rows.index[len(mine) // 2], size, "perturbation")
            if amounts[size].nunique() > 1:
                same = described(amounts.iloc[0].to_dict(), FIXED)
                shown[f"amount-{stem}{ending}"] = illustrated(
                    error_against_amount,
                    summary[summary.scenario.isin(amounts.index)],
                    title=f"Errors against {against}: {same}",
                    text="Debiased bias error, random error and total error of each method in "
                    "N·m/rad, with standard errors.",
                )
    if "square" in results.profile:
        shown["impulse-responses"] = illustrated(
            draw_responses,
            json.loads(results.attrs["study"])["seed"],
            title="Impulse responses at a low and a high stiffness: PRBS, 150 s, 10 dB",
            text="Impulse responses over lags in N·m/(rad·s), identified by the methods that find "
            "one from the first trial of the square wave, with the paper's settings, drawn over "
            "the true one in the band of the data, at a low and a high stiffness in N·m/rad.",
        )
    return shown


def draw_responses(seed: int, title: str = "") -> Figure:
    """Draw impulse responses of a study's first trial, as :func:`example_responses` has them."""
    return impulse_responses(example_responses(seed), title)


def example_responses(seed: int) -> xr.Dataset:
    r"""Return impulse responses of the first trial of 150 s (square wave, PRBS), like figure 2.

    The true one is that of :math:`I s^2 + b s + k` in the band of the data (up to 80 % of the
    Nyquist frequency), for a response that holds all frequencies has no finite values.

    ``impulse_response`` over (method_key, instant, lag) and ``true_impulse_response`` over
    (instant, lag) are in N·m/(rad·s), with the coordinate ``stiffness`` in N·m/rad over (instant).
    The seed is that of the study.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    study = Study(seed=seed)
    ensemble, truth = draw(study, SCENARIO, 0)
    methods: dict[str, Any] = {
        "eirf": EnsembleIRF(), "sds": ShortDataSegments(), "birf": BasisIRF(model="irf")
    }  # fmt: skip
    rows = [round(instant * RATE) for instant in INSTANTS]
    found = [each.identify(ensemble).impulse_response[rows] for each in methods.values()]
    names = "stiffness", "viscosity", "inertia"
    true = np.stack([truth.quantities[name][rows] for name in names], -1)
    # Discrete weights of a derivative of order m are those for unit sample time, times the rate to
    # the power m; a response is per second, which is once more the rate.
    weights = derivative_weights(HALF_WIDTH) * RATE ** np.array([[1.0], [2.0], [3.0]])
    return xr.Dataset(
        {
            "impulse_response": (("method_key", "instant", "lag"), np.stack(found)),
            "true_impulse_response": (("instant", "lag"), true @ weights),
        },
        coords={
            "method_key": list(methods),
            "instant": list(INSTANTS),
            "stiffness": ("instant", true[:, 0]),
            "lag": np.arange(-HALF_WIDTH, HALF_WIDTH + 1) / RATE,
        },
    )


def experiment_figures(
    results: xr.Dataset, summary: pd.DataFrame, prepared: Sequence[Prepared]
) -> dict[str, Illustration]:
    """Return all figures of an experiment's page.

    By the stem of a file's name: ``"participants"`` (the paper's figure 8), ``"participant"``
    (figure 9), ``"variance-and-spread"`` (figure 10), ``"error-against-truth"`` where the truth is
    known, ``"recorded-signals"`` (figure 6) and ``"preparation"`` (figure 7).

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
            own,
            one,
            title=f"Participant {one} in detail",
            text=f"Like figure 9 of {PAPER}: stiffness and time-varying VAF of participant {one}, "
            "whose VAF is in the middle of all: mean and two standard deviations over bootstraps, "
            f"{drawn}",
        ),
        "variance-and-spread": illustrated(
            variance_and_spread,
            summary,
            title="VAF and random error of all methods",
            text=f"Like figure 10 of {PAPER}. Bars: mean over participants of the VAF of the whole "
            "torque, of that between 1 and 10 Hz, and of the random error, with two standard "
            "deviations over participants; dots: single participants. VAF is that of the "
            "realizations that the model was identified from.",
        ),
    }
    if is_known(own):
        shown["error-against-truth"] = illustrated(
            error_against_truth,
            own,
            summary,
            title="Error against the truth",
            text="How far the mean estimate over bootstraps is from the true stiffness of virtual "
            "participants: above over time, a thin line for each participant and a thick one for "
            "their mean; below as bars with two standard deviations over participants.",
        )
    mine: dict[str, Any] = {
        perturbation_name(each.recorded.perturbation): each
        for each in prepared
        if each.ensemble and each.recorded.participant == one
    }
    if mine:
        first = next(iter(mine.values()))
        shown["recorded-signals"] = illustrated(
            recorded_signals,
            {name: each.excerpt for name, each in mine.items()},
            title=f"{first.excerpt.duration:.3g} s of what was recorded from {one}",
            text=f"Like figure 6 of {PAPER}: angle and torque at {first.excerpt.sampling_rate:g} "
            "Hz, and the torque to be followed if there is one, a row for each perturbation.",
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


def participant_figures(results: xr.Dataset) -> dict[str, Illustration]:
    """Return the detailed figures of every participant, by the stem of the file's name."""
    own = results.sel(quantity="stiffness")
    return {
        f"participants/{who}": illustrated(
            participant_in_detail, own, who, title=f"Participant {who} in detail"
        )
        for who in unique(own.participant.values)
    }


def representative(results: xr.Dataset) -> str:
    """Return the participant with a median mean VAF; one with a failed recording counts last."""
    vaf = results.vaf.mean(["analysis", "bootstrap"]).groupby("participant").mean(skipna=False)
    return str(vaf.participant[vaf.argsort()[(vaf.size - 1) // 2]].item())
