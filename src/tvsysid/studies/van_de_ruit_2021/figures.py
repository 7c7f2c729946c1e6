"""All figures of a simulation study, and the impulse responses that one of them shows."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import Illustration, error_against_amount, impulse_responses
from tvsysid.figures.results import covered, scenario_traits, unique
from tvsysid.figures.words import perturbation_name, profile_name
from tvsysid.methods import BasisIRF, EnsembleIRF, ShortDataSegments
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.preprocess import decimate, segment
from tvsysid.studies.pictures import comparison, coverage, in_words
from tvsysid.study.scenarios import PERIOD, RATE, Scenario, Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SCENARIO = Scenario("square", "prbs", 150.0, 10.0)
INSTANTS = (0.25, 1.0)  # times in s, half-way between two switches: low and high stiffness
# Seconds of data and signal-to-noise ratio in dB that the paper shows over time
USUAL = (150.0, 10.0)


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
    traits = scenario_traits(results)
    shown: dict[str, Illustration] = {}
    for (profile, viscosity), rows in traits.groupby(["profile", "viscosity"], sort=False):
        covaries = viscosity == "covarying"
        stem = f"{profile}{'-covarying' if covaries else ''}"
        name = profile_name(profile if profile != "own" else rows.system.iloc[0])
        name = name if ":" in name else name[:1].upper() + name[1:]
        also = ", viscosity varies with stiffness" if covaries else ""
        every = unique(rows.perturbation)
        for group in [every] if profile == "sine" else [[each] for each in every]:
            mine = rows[rows.perturbation.isin(group)]
            at, _ = _usual(mine)
            bars = mine.sort_values(["perturbation", "snr_db", "duration_s"], kind="stable")
            perturbations = " and ".join(map(perturbation_name, at.perturbation))
            words = [str(profile), *(group if len(group) == 1 else []), *(["covarying"] * covaries)]
            shown["-".join(["comparison", *words])] = comparison(
                results, summary, list(at.index), list(bars.index), f"{name}, {perturbations}{also}"
            )
        at, (duration, snr) = _usual(rows)
        here = summary[summary.scenario.isin(rows.index)]
        for column, fixed, against, ending in (
            ("duration_s", here.snr_db == snr, f"the amount of data, {snr:g} dB", ""),
            ("snr_db", here.duration_s == duration, f"noise, {duration:g} s of data", "-snr"),
        ):
            amounts = here[fixed & np.isfinite(here[column])]
            if amounts[column].nunique() > 1:
                title = f"{name}: errors against {against}"
                shown[f"amount-{stem}{ending}"] = _amount(amounts, column, title)
        if np.isfinite(covered(results.sel(scenario=list(at.index))).values).any():
            title = f"{name}: how often the bands hold the truth, {at.duration_s.iloc[0]:g} s{also}"
            shown[f"coverage-{stem}"] = coverage(results, summary, list(at.index), title)
    if responses is not None:
        shown["impulse-responses"] = _responses(responses)
    return shown


def _usual(rows: pd.DataFrame) -> tuple[pd.DataFrame, tuple[float, float]]:
    """Return the scenarios to show and their duration and noise: the paper's, or the middle."""
    pairs = sorted(set(zip(rows.duration_s.tolist(), rows.snr_db.tolist(), strict=True)))
    duration, snr = USUAL if USUAL in pairs else pairs[len(pairs) // 2]
    return rows[(rows.duration_s == duration) & (rows.snr_db == snr)], (duration, snr)


def _amount(rows: pd.DataFrame, column: str, title: str) -> Illustration:
    total = rows.assign(size=rows[column]).sort_values("size", kind="stable")
    text = (
        "Debiased bias error, random error and total error of each method in N·m/rad, with "
        f"standard errors. {in_words(total, ['perturbation', 'method'], ['total_error'])}"
    )
    return Illustration(partial(error_against_amount, rows, title), title, text)


def _responses(responses: xr.Dataset) -> Illustration:
    data = (
        f"{perturbation_name(SCENARIO.perturbation)}, {SCENARIO.duration_s:g} s, "
        f"{SCENARIO.snr_db:g} dB"
    )
    title = f"Impulse responses at a low and a high stiffness: {data}"
    rows = responses.distance.to_dataframe("value").reset_index()
    rows = rows.assign(metric="root mean square distance from the truth", unit=" N·m/(rad·s)")
    text = (
        "Impulse responses over lags in N·m/(rad·s), identified by the methods that find one from "
        f"the first trial of the square wave ({data}), with the paper's settings, drawn over the "
        "true one in the band of the data, at a low and a high stiffness in N·m/rad. "
        f"{in_words(rows, ['stiffness', 'method_key'], set(rows.metric))}"
    )
    return Illustration(partial(impulse_responses, responses, title), title, text)


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
    system, perturbation = study.simulated(SCENARIO)
    simulation = system.simulate(
        SCENARIO.duration_s,
        perturbation=perturbation,
        snr_db=SCENARIO.snr_db,
        seed=study.seed_of(SCENARIO, 0),
    )
    ensemble = segment(decimate(simulation.recording, RATE), PERIOD)
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
