"""What the page's tables hold, as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tvsysid.figures.words import TRAITS, described, trait
from tvsysid.methods.plugins import METHODS

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

RANKED = {
    "bias_error": ("bias error", "N·m/rad", 2),
    "random_error": ("random error", "N·m/rad", 2),
    "total_error": ("total error", "N·m/rad", 2),
    "rise_time": ("rise time", "s", 3),
    "vaf": ("VAF", "%", 2),
    "bandpassed_vaf": ("VAF 1-10 Hz", "%", 2),
    "coverage": ("in 95 % band", "%", 1),
    "seconds": ("time", "ms", 1),
}
"""Heading, unit and decimals of each column of the ranking."""
SYMBOLS = {"holds": "✓", "does not hold": "✗", "undecided": "?", "not studied": "–"}
TRAIT_HEADINGS = {
    "profile": "stiffness",
    "perturbation": "perturbation",
    "duration_s": "data (s)",
    "snr_db": "signal-to-noise (dB)",
    "viscosity": "viscosity",
}
AMOUNTS = ("duration_s", "snr_db")
USUAL = {"profile": "square", "duration_s": 150.0, "snr_db": 10.0, "viscosity": "constant"}


@dataclass(frozen=True)
class Cell:
    """A number as text, and for sorting; ``value`` is None where there is none."""

    text: str
    value: float | None


def scenarios(results: xr.Dataset) -> dict[str, dict[str, Any]]:
    """Traits of each scenario by its label."""
    return {
        str(label): {name: results[name].sel(scenario=label).item() for name in TRAITS}
        for label in results.scenario.values
    }


def main_scenario(traits: dict[str, dict[str, Any]]) -> str:
    """Label of the scenario to look at first: the one most like the paper's."""
    return max(traits, key=lambda label: sum(traits[label][name] == usual for name, usual in USUAL.items()))


def number(value: float, error: float = math.nan, decimals: int | None = None) -> Cell:
    """Value ± standard error with so many decimals, or to three digits.

    Examples
    --------
    >>> number(9.8765, 0.1234, 2).text, number(1234.5).text, number(float("nan")).text
    ('9.88 ± 0.12', '1230', '–')
    """
    if not math.isfinite(value):
        return Cell("–", None)
    if decimals is None:
        decimals = 2 - math.floor(math.log10(abs(value))) if value else 0
    told = [f"{round(each, decimals):.{max(decimals, 0)}f}" for each in (value, error) if math.isfinite(each)]
    return Cell(" ± ".join(told).replace("-", "−"), value)


def trait_text(name: str, value: Any) -> str:
    """Trait as it stands under its heading."""
    return f"{value:g}" if name in AMOUNTS else trait(name, value).removeprefix("b ")


def ranking(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Any]:
    """Rows of the ranking, those with the lowest total error first within a scenario, and the columns' headings."""
    traits = scenarios(results)
    varying = [name for name in TRAITS if len({each[name] for each in traits.values()}) > 1]
    table = summary.set_index(["scenario", "method", "metric"]).sort_index()
    there = [name for name in RANKED if summary.value[summary.metric == name].notna().any()]
    rows = []
    for label, each in traits.items():
        mine = []
        for method in map(str, results.method_key.values):
            cells = {name: _cell(table, label, method, name) for name in there}
            mine.append(
                {
                    "scenario": label,
                    "method": method,
                    "traits": [
                        Cell(trait_text(name, each[name]), each[name] if name in AMOUNTS else None) for name in varying
                    ],
                    "cells": list(cells.values()),
                    "order": cells["total_error"].value if "total_error" in cells else None,
                }
            )
        rows += sorted(mine, key=lambda row: math.inf if row["order"] is None else row["order"])
    return {
        "rows": rows,
        "traits": [{"heading": TRAIT_HEADINGS[name], "numeric": name in AMOUNTS} for name in varying],
        "metrics": [RANKED[name] for name in there],
        "scenarios": {label: described(each) for label, each in traits.items()},
        "main": main_scenario(traits),
        "shared": described(traits[next(iter(traits))], [name for name in TRAITS if name not in varying]),
    }


def _cell(table: pd.DataFrame, *key: str) -> Cell:
    """A metric of one scenario and method, times in ms."""
    if key not in table.index:
        return number(math.nan)
    value, error = table[["value", "standard_error"]].to_numpy(dtype=float)[table.index.get_loc(key)]
    factor = 1000 if key[-1] == "seconds" else 1
    return number(factor * value, factor * error, RANKED[key[-1]][2])


def outcome(results: xr.Dataset, summary: pd.DataFrame, claims: pd.DataFrame) -> list[str]:
    """The main outcome in sentences."""
    traits = scenarios(results)
    label = main_scenario(traits)
    here = summary[summary.scenario == label]
    sentences = []
    told = []
    for name, words in (
        ("bias_error", "lowest bias error"),
        ("random_error", "lowest random error"),
        ("total_error", "lowest total error"),
        ("rise_time", "shortest rise time"),
        ("vaf", "highest VAF"),
    ):
        rows = here[(here.metric == name) & here.value.notna()].sort_values("value", ascending=name != "vaf")
        if len(rows) > 1:
            told.append(f"{rows.method.iloc[0]} has the {words} ({_figure(rows.iloc[0])}){_runner_up(rows)}")
    if told:
        sentences.append(f"With {described(traits[label])}: {'; '.join(told)}.")
    total = summary[(summary.metric == "total_error") & summary.value.notna()]
    if len(traits) > 1 and len(total):
        best = total.loc[total.groupby("scenario", sort=False).value.idxmin()].method.value_counts()
        wins = ", ".join(f"{method} in {count}" for method, count in best.items())
        sentences.append(f"Of all {len(traits)} scenarios the total error is lowest for {wins}.")
    return [*sentences, *verdicts(claims)]


def verdicts(claims: pd.DataFrame) -> list[str]:
    """How many claims hold, in a sentence; none if there are no claims."""
    if not len(claims):
        return []
    counts = claims.verdict.value_counts()
    told = ", ".join(f"{verdict}: {counts[verdict]}" for verdict in SYMBOLS if verdict in counts)
    return [f"Of {len(claims)} claims of the paper: {told}."]


def _figure(row: Any) -> str:
    return f"{number(float(row.value), float(row.standard_error), RANKED[row.metric][2]).text} {row.unit}"


def _runner_up(rows: pd.DataFrame) -> str:
    first, second = rows.iloc[0], rows.iloc[1]
    noise = math.hypot(*(float(error) if math.isfinite(error) else 0.0 for error in rows.standard_error[:2]))
    if abs(float(second.value) - float(first.value)) <= 2 * noise:
        return f", though not clearly {'lower' if first.value <= second.value else 'higher'} than {second.method}"
    return ""


def claim_rows(claims: pd.DataFrame) -> list[dict[str, Any]]:
    """Claims with their limits as text and a symbol beside the verdict."""
    rows = []
    for row in claims.fillna({"remark": "", "finding": "", "source": "", "unit": ""}).to_dict("records"):
        estimate, limits = number(float(row["estimate"])).text, ""
        if all(math.isfinite(float(row[name])) for name in ("low", "high")):
            limits = f"{number(float(row['low'])).text} to {number(float(row['high'])).text}"
        rows.append({**row, "symbol": SYMBOLS.get(row["verdict"], ""), "estimate": estimate, "limits": limits})
    return [{str(key): value for key, value in row.items()} for row in rows]


def methods(labels: Iterable[str]) -> list[dict[str, Any]]:
    """What each method is called and assumes; nothing is known of those that are not this package's."""
    told = []
    for label in labels:
        method = METHODS.get(label.partition(":")[0])
        told.append(
            {
                "label": label,
                "title": method.title if method else None,
                "assumptions": method.assumptions if method else (),
            }
        )
    return told


def troubles(results: xr.Dataset) -> list[dict[str, Any]]:
    """Methods with failures or doubts: how many trials, and the first reason."""
    there = int(results.checksums.any("variable").sum())
    found = []
    for label in map(str, results.method_key.values):
        for name, words in (("failure", "failed"), ("doubts", "doubtful")):
            told = [str(text) for text in results[name].sel(method_key=label).values.ravel() if text]
            if told:
                found.append({"method": label, "kind": words, "count": len(told), "trials": there, "first": told[0]})
    return found
