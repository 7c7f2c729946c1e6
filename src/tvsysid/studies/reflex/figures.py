"""Figures of the reflex study: both pathways over time, and the reflex's bias of stiffness."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from tvsysid.figures import BARS_OF_PATHWAYS, Illustration, error_against, method_comparison
from tvsysid.figures.results import OVER_TIME, scenario_traits, unique
from tvsysid.figures.words import TRAITS, count, perturbation_name, profile_name
from tvsysid.study.scores import asked

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

QUANTITIES = ["stiffness", "reflex_gain"]


def reflex_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, by the stem of the file's name.

    ``"pathways-reflex-sine-sine"``: stiffness and reflex gain over time of the first scenario of a
    system and a profile, with bars of all its scenarios; ``"bias-reflex-sine"``: bias of the
    stiffness against the gain, where several constant gains were simulated;
    ``"amount-reflex-sine"``: error of the gain against the data, where more than two durations
    were.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run`, and of these results, with full names
        (:func:`tvsysid.study.by_full_name`).
    """
    traits = scenario_traits(results)
    traits = traits.assign(
        kind=traits.system.str.partition(":")[0], methods=asked(results).sum(axis=1)
    )
    compared = traits[traits.methods >= min(2, traits.methods.max())]
    shown: dict[str, Illustration] = {}
    for (kind, profile), rows in compared.groupby(["kind", "profile"], sort=False):
        widest = rows[rows.methods == rows.methods.max()]
        own = widest.system.iloc[0] if widest.system.nunique() == 1 else kind
        what = ", ".join(
            [own, profile_name(profile), *map(perturbation_name, unique(widest.perturbation))]
        )
        shown[f"pathways-{kind}-{profile}"] = _pathways(results, summary, widest, what)
        gains = (
            results.truth.sel(scenario=list(rows.index), quantity="reflex_gain")
            .mean("time")
            .to_series()
        )
        if gains.nunique() > 2:
            shown[f"bias-{kind}-{profile}"] = _bias(
                summary, gains, f"{kind}, {profile_name(profile)}"
            )
    same = [name for name in TRAITS if name != "duration_s"]
    for _, rows in traits.groupby(same, sort=False):
        if rows.duration_s.nunique() > 2:
            system, profile = rows.system.iloc[0], rows.profile.iloc[0]
            shown[f"amount-{system}-{profile}"] = _amount(
                summary, rows.duration_s, f"{system}, {profile_name(profile)}"
            )
    return shown


def _pathways(
    results: xr.Dataset, summary: pd.DataFrame, rows: pd.DataFrame, what: str
) -> Illustration:
    labels, title = list(rows.index), f"Both pathways: {what}"
    mine = summary[summary.scenario.isin(labels)]
    methods = unique(mine.method)
    drawing = partial(
        method_comparison,
        results[OVER_TIME].sel(scenario=labels, quantity=QUANTITIES, method_key=methods),
        mine,
        labels[:1],
        labels,
        title,
        BARS_OF_PATHWAYS,
    )
    text = (
        f"A column for each of {count(len(methods), 'method')}. Upper rows, over one realization "
        f"of {labels[0]}: "
        "estimated stiffness and reflex gain, mean and two standard deviations over "
        f"{count(results.sizes['trial'], 'trial')}, against the truth, and time-varying VAF. "
        "Lower rows: bars of the "
        f"errors and of the VAF of each pathway for {count(len(labels), 'scenario')}: "
        f"{', '.join(labels)}."
    )
    return Illustration(drawing, title, text)


def _bias(summary: pd.DataFrame, gains: pd.Series, what: str) -> Illustration:
    title = f"What a reflex does to the stiffness: {what}"
    text = "Mean bias of the stiffness in N·m/rad against the gain of the reflex in N·m·s/rad."
    rows, said = _over(summary, "mean_bias", gains)
    return Illustration(
        partial(error_against, "gain of the reflex (N·m·s/rad)", rows, title),
        title,
        f"{text} {said}",
    )


def _amount(summary: pd.DataFrame, durations: pd.Series, what: str) -> Illustration:
    title = f"How much data a reflex needs: {what}"
    rows, said = _over(summary, "reflex_gain total_error", durations)
    drawing = partial(
        error_against, "data (s)", rows, title, "total error of the reflex gain (N·m·s/rad)"
    )
    text = "Total error of the reflex gain in N·m·s/rad against seconds of data."
    return Illustration(drawing, title, f"{text} {said}")


def _over(summary: pd.DataFrame, metric: str, sizes: pd.Series) -> tuple[pd.DataFrame, str]:
    """Return rows of a metric for scenarios of these sizes, of methods with several.

    And them in words.
    """
    rows = summary[(summary.metric == metric) & summary.scenario.isin(sizes.index)]
    rows = (
        rows.assign(size=rows.scenario.map(sizes))
        .dropna(subset=["value"])
        .sort_values("size", kind="stable")
    )
    rows = rows[rows.groupby("method")["size"].transform("nunique") > 1]
    said = (
        f"{method}: "
        f"{', '.join(f'{each.value:.3g} at {each.size:g}' for each in line.itertuples())}."
        for method, line in rows.groupby("method", sort=False)
    )
    return rows, " ".join(said)
