"""Figures of the closed-loop study: bias over the actuator's stiffness, methods, bands."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from tvsysid.figures import Illustration, coverage_over_time, error_against, method_comparison
from tvsysid.figures.results import OVER_TIME, scenario_traits, unique
from tvsysid.figures.words import count
from tvsysid.methods import from_text
from tvsysid.simulate import SYSTEMS, CompliantActuator
from tvsysid.studies.closed_loop.presets import IMPOSED

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SIZE = "stiffness of the actuator (N·m/rad)"


def loop_of(label: object) -> CompliantActuator | None:
    """Return the system of this label, if it is a closed loop of the package."""
    name, _, _ = str(label).partition(":")
    usual = SYSTEMS.get(name)
    if not isinstance(usual, CompliantActuator):
        return None
    found: CompliantActuator = from_text(str(label), "system", usual)
    return found


def loop_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, by the stem of the file's name.

    ``"bias-5Hz"``: mean bias of the stiffness against the stiffness of the actuator, for each
    noise; ``"comparison-5Hz"``: estimates over time, with bars of all scenarios of that noise;
    ``"coverage-5Hz"``: bands.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run`, and of these results, with full names
        (:func:`tvsysid.study.by_full_name`).
    """
    traits = scenario_traits(results)
    loops = {
        label: loop
        for label, system in traits.system.items()
        if (loop := loop_of(system)) is not None
    }
    traits = traits.loc[list(loops)].assign(
        size=[loop.actuator_stiffness for loop in loops.values()],
        noise=[loop.noise_bandwidth for loop in loops.values()],
    )
    shown: dict[str, Illustration] = {}
    for noise, rows in traits.groupby("noise"):
        usual = rows[
            (rows.profile == rows.profile.iloc[0]) & (rows.duration_s == rows.duration_s.min())
        ]
        soft = usual["size"][usual["size"] < IMPOSED]
        if soft.nunique() > 1:
            shown[f"bias-{noise:g}Hz"] = _bias(summary, soft, f"noise up to {noise:g} Hz")
        middle = usual.index[len(usual) // 3]
        title = f"Open and closed methods: noise up to {noise:g} Hz"
        labels, mine = list(usual.index), summary[summary.scenario.isin(usual.index)]
        data = results[OVER_TIME].sel(
            scenario=labels, quantity=["stiffness"], method_key=unique(mine.method)
        )
        text = (
            f"A column for each method. Upper rows, over one realization of {middle}: estimated "
            "stiffness, mean and "
            f"two standard deviations over {count(results.sizes['trial'], 'trial')}, against the "
            "truth, and "
            "time-varying VAF. Lower rows: bars of errors and VAF for "
            f"{count(len(labels), 'scenario')}: "
            f"{', '.join(labels)}."
        )
        drawing = partial(method_comparison, data, mine, [middle], labels, title)
        shown[f"comparison-{noise:g}Hz"] = Illustration(drawing, title, text)
        title = f"Coverage of the 95 % bands: noise up to {noise:g} Hz"
        drawing = partial(coverage_over_time, results, [middle], title)
        text = (
            "Share of trials whose 95 % band holds the true stiffness, over a realization of "
            f"{middle}, by method."
        )
        shown[f"coverage-{noise:g}Hz"] = Illustration(drawing, title, text)
    return shown


def _bias(summary: pd.DataFrame, sizes: pd.Series, what: str) -> Illustration:
    rows = summary[(summary.metric == "mean_bias") & summary.scenario.isin(sizes.index)].dropna(
        subset=["value"]
    )
    rows = rows.assign(size=rows.scenario.map(sizes)).sort_values("size", kind="stable")
    title = f"Stiffness on a compliant actuator, {what}"
    said = [
        f"{method}: "
        f"{', '.join(f'{each.value:.1f} at {each.size:g}' for each in line.itertuples())}."
        for method, line in rows.groupby("method", sort=False)
    ]
    text = f"Mean bias of the stiffness in N·m/rad against the {SIZE}; {what}. {' '.join(said)}"
    return Illustration(partial(error_against, SIZE, rows, title), title, text)
