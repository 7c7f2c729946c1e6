"""All figures of a study, and the impulse responses that one of them shows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures.comparison import method_comparison
from tvsysid.figures.results import BANDS, OVER_TIME, covered, scenario_traits
from tvsysid.figures.saving import Illustration
from tvsysid.figures.simulations import coverage_over_time, error_against_amount, impulse_responses
from tvsysid.figures.words import count, described, perturbation_name, profile_name
from tvsysid.methods import BasisIRF, EnsembleIRF, Method, ShortDataSegments
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.preprocess import decimate, segment
from tvsysid.simulate import PERTURBATIONS, PROFILES, Joint
from tvsysid.study.scenarios import PERIOD, RATE, Scenario, Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SCENARIO = Scenario("square", "prbs", 150.0, 10.0)
INSTANTS = (0.25, 1.0)  # times in s, half-way between two switches: low and high stiffness
# Seconds of data and signal-to-noise ratio in dB that the paper shows over time
USUAL = (150.0, 10.0)
METRICS = {
    "bias_error": "bias error",
    "random_error": "random error",
    "total_error": "total error",
    "rise_time": "rise time",
    "vaf": "VAF",
}


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
        ending = "-covarying" if viscosity == "covarying" else ""
        perturbations = list(rows.perturbation.unique())
        groups = [perturbations] if profile == "sine" else [[name] for name in perturbations]
        for group in groups:
            stem = f"comparison-{profile}" + ("" if len(group) > 1 else f"-{group[0]}") + ending
            shown[stem] = _comparison(results, summary, rows[rows.perturbation.isin(group)])
        here = summary[(summary.stiffness == profile) & (summary.viscosity == viscosity)]
        duration, snr = _middle(rows)
        name = _name(rows.iloc[0])
        at_snr, at_duration = here[here.snr_db == snr], here[here.duration_s == duration]
        if at_snr.duration_s.nunique() > 1:
            shown[f"amount-{profile}{ending}"] = _amount(
                at_snr, f"{name}: errors against the amount of data"
            )
        if at_duration.snr_db[at_duration.snr_db < float("inf")].nunique() > 1:
            shown[f"amount-{profile}{ending}-snr"] = _amount(
                at_duration, f"{name}: errors against noise"
            )
        at = rows[(rows.duration_s == duration) & (rows.snr_db == snr)]
        if np.isfinite(covered(results.sel(scenario=list(at.index))).values).any():
            shown[f"coverage-{profile}{ending}"] = _coverage(results, summary, at)
    if responses is not None:
        shown["impulse-responses"] = _responses(responses)
    return shown


def _name(traits: Any) -> str:
    name = profile_name(traits["profile"] if traits["profile"] != "own" else traits["system"])
    return name if ":" in name else name[:1].upper() + name[1:]


def _covarying(traits: Any) -> str:
    return ", viscosity varies with stiffness" if traits["viscosity"] == "covarying" else ""


def _middle(rows: pd.DataFrame) -> tuple[float, float]:
    """Return the duration and signal-to-noise ratio to show: the paper's, or the middle ones."""
    pairs = sorted(set(zip(rows.duration_s.astype(float), rows.snr_db.astype(float), strict=True)))
    return USUAL if USUAL in pairs else pairs[len(pairs) // 2]


def _comparison(results: xr.Dataset, summary: pd.DataFrame, rows: pd.DataFrame) -> Illustration:
    duration, snr = _middle(rows)
    shown = rows[(rows.duration_s == duration) & (rows.snr_db == snr)]
    bars = rows.sort_values(["perturbation", "snr_db", "duration_s"], kind="stable")
    scenarios: list[Any] = shown.to_dict("records")
    perturbations = " and ".join(map(perturbation_name, shown.perturbation))
    title = f"{_name(scenarios[0])}, {perturbations}{_covarying(scenarios[0])}"
    labels = list(dict.fromkeys([*shown.index, *bars.index]))
    drawing = partial(
        method_comparison,
        results[OVER_TIME].sel(scenario=labels, quantity="stiffness"),
        summary[summary.scenario.isin(labels)],
        list(shown.index),
        list(bars.index),
        title,
    )
    text = (
        f"A column for each of {results.sizes['method_key']} methods. Upper rows, over one "
        f"realization of {duration:g} s of data at {snr:g} dB: estimated stiffness, mean and two "
        f"standard deviations over {count(results.sizes['trial'], 'trial')}, against the true "
        "stiffness, and time-varying VAF. Lower rows: bars of the metrics for "
        f"{count(len(bars), 'scenario')}. "
    )
    return Illustration(
        drawing, title, text + " ".join(_figures(summary, list(shown.index), scenarios))
    )


def _figures(
    summary: pd.DataFrame, labels: Sequence[str], scenarios: Sequence[dict[str, object]]
) -> list[str]:
    """Return one sentence for each method in each scenario."""
    sentences = []
    for label, scenario in zip(labels, scenarios, strict=True):
        rows = summary[(summary.scenario == label) & summary.metric.isin(list(METRICS))].dropna(
            subset=["value"]
        )
        for method, mine in rows.groupby("method", sort=False):
            values = mine.set_index("metric")
            parts = [
                f"{words} {values.value[name]:.3g} {values.unit[name]}"
                for name, words in METRICS.items()
                if name in values.index
            ]
            sentences.append(f"{method} with {described(scenario)}: {', '.join(parts)}.")
    return sentences


def _coverage(results: xr.Dataset, summary: pd.DataFrame, rows: pd.DataFrame) -> Illustration:
    first: Any = rows.iloc[0]
    title = (
        f"{_name(first)}: how often the bands hold the truth, {first.duration_s:g} "
        f"s{_covarying(first)}"
    )
    labels = list(rows.index)
    chosen = results[BANDS].sel(scenario=labels, quantity="stiffness")
    missed = ": about a switch bands miss the truth." if first.profile == "square" else "."
    text = [
        "Share of trials in which the 95 % band of each method holds the true stiffness, over one "
        "realization, averaged over 0.05 s. A band covers the random error, not the bias of what a "
        f"method smooths{missed}"
    ]
    for label, row in rows.iterrows():
        mine = summary[(summary.scenario == label) & (summary.metric == "coverage")].dropna(
            subset=["value"]
        )
        shares = ", ".join(
            f"{method} {value:.0f} %" for method, value in zip(mine.method, mine.value, strict=True)
        )
        if shares:
            text.append(f"With {perturbation_name(row.perturbation)}: {shares} over all times.")
        without = summary[
            (summary.scenario == label) & (summary.metric == "without_band") & (summary.value > 0)
        ]
        missing = [
            f"{method} {'below 1' if value < 1 else f'{value:.0f}'} %"
            for method, value in zip(without.method, without.value, strict=True)
        ]
        if missing:
            text.append(
                f"Of these times and trials no band, and not counted: {', '.join(missing)}."
            )
    return Illustration(partial(coverage_over_time, chosen, labels, title), title, " ".join(text))


def _amount(rows: pd.DataFrame, title: str) -> Illustration:
    name = "duration_s" if rows.duration_s.nunique() > 1 else "snr_db"
    unit = "s" if name == "duration_s" else "dB"
    other = (
        f"{rows.snr_db.iloc[0]:g} dB"
        if name == "duration_s"
        else f"{rows.duration_s.iloc[0]:g} s of data"
    )
    title = f"{title}, {other}"
    known = rows[(rows.metric == "total_error") & (rows[name] < float("inf"))].dropna(
        subset=["value"]
    )
    sentences = [
        "Debiased bias error, random error and total error of each method in N·m/rad, with "
        "standard errors."
    ]
    for (perturbation, method), line in known.sort_values(name, kind="stable").groupby(
        ["perturbation", "method"], sort=False
    ):
        first, last = line.iloc[0], line.iloc[-1]
        sentences.append(
            f"{method} with {perturbation_name(perturbation)}: total error {first.value:.3g} at "
            f"{first[name]:g} {unit}, {last.value:.3g} at {last[name]:g} {unit}."
        )
    return Illustration(partial(error_against_amount, rows, title), title, " ".join(sentences))


def _responses(responses: xr.Dataset) -> Illustration:
    data = (
        f"{perturbation_name(SCENARIO.perturbation)}, {SCENARIO.duration_s:g} s, "
        f"{SCENARIO.snr_db:g} dB"
    )
    title = f"Impulse responses at a low and a high stiffness: {data}"
    sentences = [
        "Impulse responses over lags in N·m/(rad·s), identified by the methods that find one from "
        f"the first trial of the square wave ({data}), with the paper's settings, drawn over the "
        "true one in the band of the data."
    ]
    for instant in responses.instant.values:
        here = responses.distance.sel(instant=instant)
        parts = [
            f"{method} {float(here.sel(method_key=method)):.3g}"
            for method in here.method_key.values
        ]
        sentences.append(
            f"Where stiffness is {float(here.stiffness):.0f} N·m/rad the root mean square distance "
            f"from the truth is {', '.join(parts)}."
        )
    return Illustration(partial(impulse_responses, responses, title), title, " ".join(sentences))


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

    simulation = Joint(stiffness=PROFILES[SCENARIO.stiffness]).simulate(
        SCENARIO.duration_s,
        perturbation=PERTURBATIONS[SCENARIO.perturbation],
        snr_db=SCENARIO.snr_db,
        seed=Study(seed=seed).seed_of(SCENARIO, 0),
    )
    ensemble = segment(decimate(simulation.recording, RATE), PERIOD)
    methods: list[Method] = [EnsembleIRF(), ShortDataSegments(), BasisIRF(model="irf")]
    models: list[Any] = [method.identify(ensemble) for method in methods]
    stiffness = np.asarray(PROFILES[SCENARIO.stiffness](np.array(INSTANTS)))
    viscosity = float(simulation.truth["viscosity"][0])
    # Discrete weights of a derivative of order m are those for unit sample time, times the rate to
    # the power m; a
    # response is per second, which is once more the rate.
    weights = derivative_weights(HALF_WIDTH) * RATE ** np.array([[1.0], [2.0], [3.0]])
    inertia = float(simulation.truth["inertia"][0])
    truth = [k * weights[0] + viscosity * weights[1] + inertia * weights[2] for k in stiffness]
    rows = [round(instant * RATE) for instant in INSTANTS]
    dims = ("method_key", "instant", "lag")
    found = np.stack([model.impulse_response[rows] for model in models])
    distance = np.sqrt(np.mean((found - np.stack(truth)) ** 2, axis=-1))
    return xr.Dataset(
        {
            "impulse_response": (dims, found),
            "distance": (dims[:2], distance),
            "true_impulse_response": (dims[1:], np.stack(truth)),
        },
        coords={
            "method_key": ["eirf", "sds", "birf"],
            "instant": list(INSTANTS),
            "stiffness": ("instant", stiffness),
            "lag": np.arange(-HALF_WIDTH, HALF_WIDTH + 1) / RATE,
        },
    )
