"""All figures of a simulation study, and the impulse responses that one of them shows."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import Illustration, error_against_amount, impulse_responses
from tvsysid.figures.results import of_quantity, scenario_traits, unique
from tvsysid.figures.words import perturbation_name, profile_name
from tvsysid.methods import BasisIRF, EnsembleIRF, ShortDataSegments
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.studies.pictures import comparison, coverage
from tvsysid.study.scenarios import RATE, Scenario, Study
from tvsysid.study.trials import cut, simulate

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SCENARIO = Scenario("square", "prbs", 150.0, 10.0)
INSTANTS = (0.25, 1.0)  # times in s, half-way between two switches: low and high stiffness
# Seconds of data and signal-to-noise ratio in dB that the paper shows over time
USUAL = (150.0, 10.0)
AMOUNT = (
    "Debiased bias error, random error and total error of each method in N·m/rad, with standard "
    "errors."
)


def study_figures(
    results: xr.Dataset, summary: pd.DataFrame, responses: xr.Dataset | None = None
) -> dict[str, Illustration]:
    """Return all figures of a study.

    By the stem of a file's name: ``"comparison-square-noise"``, ``"comparison-sine"`` (both
    perturbations), ``"amount-square"`` (errors against seconds of data), ``"amount-square-snr"``,
    ``"coverage-square"`` (how often the bands hold the truth), ``"impulse-responses"``; with
    ``-covarying`` where the viscosity varies with stiffness.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    responses
        As :func:`tvsysid.figures.impulse_responses` takes them; None leaves that figure out.
    """
    shown: dict[str, Illustration] = {}
    groups = scenario_traits(results).groupby(["profile", "viscosity"], sort=False)
    for (profile, viscosity), rows in groups:
        ending = "-covarying" if viscosity == "covarying" else ""
        also = ", viscosity varies with stiffness" if ending else ""
        name = rows.system.iloc[0] if profile == "own" else profile_name(profile)
        name = name if ":" in name else name[:1].upper() + name[1:]
        every = unique(rows.perturbation)
        for group in [every] if profile == "sine" else [[each] for each in every]:
            mine = rows[rows.perturbation.isin(group)]
            bars = mine.sort_values(["perturbation", "snr_db", "duration_s"], kind="stable")
            labels, perturbations = usual(mine), " and ".join(map(perturbation_name, group))
            stem = f"comparison-{profile}" + (f"-{group[0]}" if len(group) == 1 else "") + ending
            shown[stem] = comparison(
                results, summary, labels, list(bars.index), f"{name}, {perturbations}{also}"
            )
        labels = usual(rows)
        duration, noise = rows.loc[labels[0], ["duration_s", "snr_db"]]
        here = summary[summary.scenario.isin(rows.index)]
        for column, fixed, against, by in (
            ("duration_s", here.snr_db == noise, f"the amount of data, {noise:g} dB", ""),
            ("snr_db", here.duration_s == duration, f"noise, {duration:g} s of data", "-snr"),
        ):
            amounts = here[fixed & np.isfinite(here[column])]
            if amounts[column].nunique() > 1:
                title = f"{name}: errors against {against}"
                shown[f"amount-{profile}{ending}{by}"] = Illustration(
                    partial(error_against_amount, amounts, title), title, AMOUNT
                )
        if np.isfinite(of_quantity(results).covered.sel(scenario=labels).values).any():
            title = f"{name}: how often the bands hold the truth, {duration:g} s{also}"
            shown[f"coverage-{profile}{ending}"] = coverage(results, labels, title)
    if responses is not None:
        shown["impulse-responses"] = responses_illustration(responses)
    return shown


def usual(rows: pd.DataFrame) -> list[str]:
    """Return the scenarios of one duration and noise to show: the paper's, or the middle."""
    pairs = rows.set_index(["duration_s", "snr_db"]).index
    several = sorted(set(pairs))
    pair = USUAL if USUAL in several else several[len(several) // 2]
    return list(rows.index[pairs == pair])


def responses_illustration(responses: xr.Dataset) -> Illustration:
    """Return the figure of :func:`example_responses`."""
    data = (
        f"{perturbation_name(SCENARIO.perturbation)}, {SCENARIO.duration_s:g} s, "
        f"{SCENARIO.snr_db:g} dB"
    )
    title = f"Impulse responses at a low and a high stiffness: {data}"
    far = responses.distance.mean("instant").to_series()
    text = (
        "Impulse responses over lags in N·m/(rad·s), identified by the methods that find one from "
        f"the first trial of the square wave ({data}), with the paper's settings, drawn over the "
        "true one in the band of the data, at a low and a high stiffness in N·m/rad. Root mean "
        "square distance from the truth, mean of both: "
        f"{', '.join(f'{name} {each:.3g}' for name, each in far.items())} N·m/(rad·s)."
    )
    return Illustration(lambda: impulse_responses(responses, title), title, text)


def example_responses(seed: int = 0) -> xr.Dataset:
    r"""Return impulse responses of the first trial of 150 s (square wave, PRBS), like figure 2.

    The true one is that of :math:`I s^2 + b s + k` in the band of the data (up to 80 % of the
    Nyquist frequency), for a response that holds all frequencies has no finite values.

    ``impulse_response`` over (method_key, instant, lag), ``true_impulse_response`` over
    (instant, lag), and ``distance`` between them (root mean square over lags) over (method_key,
    instant), in N·m/(rad·s), with the coordinate ``stiffness`` in N·m/rad over (instant). The
    seed is that of the study.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    study = Study(seed=seed)
    simulation = simulate(study, SCENARIO, 0)
    ensemble = cut(study, simulation.recording)
    methods = {
        "eirf": EnsembleIRF(), "sds": ShortDataSegments(), "birf": BasisIRF(model="irf")
    }  # fmt: skip
    rows = [round(instant * RATE) for instant in INSTANTS]
    models: list[Any] = [method.identify(ensemble) for method in methods.values()]
    found = [model.impulse_response[rows] for model in models]
    truth = simulation.truth_of(ensemble)
    true = np.stack([truth[name][0, rows] for name in ("stiffness", "viscosity", "inertia")], -1)
    # Discrete weights of a derivative of order m are those for unit sample time, times the rate to
    # the power m; a response is per second, which is once more the rate.
    weights = derivative_weights(HALF_WIDTH) * RATE ** np.array([[1.0], [2.0], [3.0]])
    responses = xr.Dataset(
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
    error = responses.impulse_response - responses.true_impulse_response
    return responses.assign(distance=np.sqrt((error**2).mean("lag")))
