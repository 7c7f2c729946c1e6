"""The page of a simulation study."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from tvsysid.figures import Picture
from tvsysid.figures.results import traits_of, unique
from tvsysid.figures.words import TRAITS, count, described, trait
from tvsysid.methods import names
from tvsysid.report import page, sections
from tvsysid.study.scenarios import KINDS, OWN

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OBJECT = re.compile(r"\w+\(.*\)")  # label of what was given as an object
SETTINGS = {
    "stiffness": "stiffness profiles",
    "perturbation": "perturbations",
    "duration_s": "data (s)",
    "snr_db": "signal-to-noise ratio of the torque (dB)",
    "methods": "methods",
    "trials": "trials of each scenario",
    "seed": "seed",
    "viscosity": "viscosity",
    "system": "system",
    "rate": "sampling rate after decimation (Hz)",
    "period": "duration of a realization (s)",
}
RANKED = {
    "bias_error": ("bias error", "N·m/rad", 2),
    "random_error": ("random error", "N·m/rad", 2),
    "total_error": ("total error", "N·m/rad", 2),
    "rise_time": ("rise time", "s", 3),
    "vaf": ("VAF", "%", 2),
    "bandpassed_vaf": ("VAF 1–10 Hz", "%", 2),
    "coverage": ("in 95 % band", "%", 1),
    "reflex_gain total_error": ("error of reflex gain", "N·m·s/rad", 2),
    "intrinsic pathway_vaf": ("VAF intrinsic", "%", 1),
    "reflex pathway_vaf": ("VAF reflex", "%", 1),
    "seconds": ("time", "ms", 1),
}
"""Heading, unit and decimals of each column of the ranking."""
BEST = {
    "bias_error": "lowest bias error",
    "random_error": "lowest random error",
    "total_error": "lowest total error",
    "rise_time": "shortest rise time",
    "vaf": "highest VAF",
}
TRAIT_COLUMNS = {
    "system": page.Column("system"),
    "profile": page.Column("stiffness"),
    "perturbation": page.Column("perturbation"),
    "duration_s": page.Column("data (s)", kind="number"),
    "snr_db": page.Column("signal-to-noise (dB)", kind="number"),
    "viscosity": page.Column("viscosity"),
}
USUAL = {"profile": "square", "duration_s": 150.0, "snr_db": 10.0, "viscosity": "constant"}
METRICS = (
    "Bias is the error of the mean estimate over trials, random error the spread about that mean, "
    "and total error both together. The mean of a finite number of trials still varies; the claims "
    "compare the bias without that part. Rise time is the time from 10 to 90 % of a step in "
    "stiffness. VAF (variance accounted for) is the share of the noiseless torque that the "
    "identified model predicts. “In 95 % band” is the share of times and trials at which the "
    "method’s own band holds the true stiffness: a band covers noise, not what a method smooths "
    "away, so it misses the truth near a switch. “Error of reflex gain” is its total error; the "
    "VAF of a pathway is that of its own torque. The value after ± is one standard error of the "
    "Monte-Carlo estimate."
)
CLAIMS = (
    "What van de Ruit et al. (2021) say, and whether this study finds it. Estimate and limits (95 "
    "%) are those of the comparison that decides: a difference above 0 or a ratio above 1 speaks "
    "for the claim. For “does not hold” the confidence is 95 % for all comparisons together."
)


def write_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    about: str = CLAIMS,
) -> None:
    """Write one HTML file that holds all of a study's outcome and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    results, summary
        As of :func:`tvsysid.study.run`, and of :func:`tvsysid.study.summarize`.
    claims
        What the papers say and whether it holds here; may have no rows.
    pictures
        As of :func:`tvsysid.figures.draw_all`.
    command
        What was typed to run the study, if it is to be mentioned.
    about
        What stands above the claims.
    """
    sizes, study = results.sizes, sections.settings_of(results, "study")
    failed = int(np.count_nonzero(results.failure.values != ""))
    tried = int(results.asked.sum()) * sizes["trial"]
    methods, scenarios = (
        count(sizes[dim], word)
        for dim, word in (("method_key", "method"), ("scenario", "scenario"))
    )
    done = (
        f"{methods} identified the same simulated data: {scenarios} with "
        f"{count(sizes['trial'], 'trial')} each, {count(tried, 'identification')} in all, of which "
        f"{failed or 'none'} failed."
    )
    # A system of one's own may have a stiffness that nobody can set.
    unused = [name for name in ("profile", "viscosity") if (results[name] == OWN).all()]
    said = {
        name: value
        for name, value in study.items()
        if {"stiffness": "profile"}.get(name, name) not in unused
    }
    settings = {SETTINGS.get(name, name.replace("_", " ")): value for name, value in said.items()}
    seconds = float(results.seconds.sum() + results.other_seconds.sum())
    main = main_scenario(traits_of(results))
    lines = [done, *outcome(results, summary, claims)]
    parts = [
        page.Section("outcome", "Outcome", [page.Box(lines), METRICS]),
        sections.run_section(results, settings, seconds, f"{failed} of {tried}"),
        page.Section("ranking", "Ranking", [ranking(results, summary)], wide=True),
        *([page.Section("figures", "Figures", sections.numbered(pictures))] if pictures else []),
        sections.claims_section(claims, about),
        sections.methods_section(map(str, results.method_key.values)),
        sections.problems_section(sections.problems(results), "method"),
        sections.again_section(
            command,
            f'results.estimate.sel(scenario="{main}", quantity="stiffness")  # over trial, '
            "method_key and time",
            "" if _nameless(study) else tomli_w.dumps(study),
        ),
    ]
    title = "Comparison of time-varying identification methods"
    subtitle = (
        f"How well {methods} found the stiffness of a simulated joint, whose true stiffness is "
        "known."
    )
    page.write_page(path, page.Page(title, subtitle, parts, sections.version_of(results)))


def _nameless(study: Mapping[str, Any]) -> bool:
    """Whether something was given as an object, which no file can name."""
    kinds = {"methods": names()} | {name: tuple(known) for name, (known, _, _) in KINDS.items()}
    return any(
        label not in known and (":" not in label or OBJECT.fullmatch(label))
        for settings in (study, *study.get("also", ()))
        for name, known in kinds.items()
        for label in settings.get(name, ())
    )


def main_scenario(traits: Mapping[str, Mapping[str, object]]) -> str:
    """Label of the scenario to look at first: the one most like the paper's."""
    return max(
        traits, key=lambda label: sum(traits[label][name] == usual for name, usual in USUAL.items())
    )


def ranking(results: xr.Dataset, summary: pd.DataFrame) -> page.Table:
    """Return the metrics of every method in every scenario, lowest total error first."""
    traits = traits_of(results)
    varying = [name for name in TRAITS if len({each[name] for each in traits.values()}) > 1]
    table = summary.set_index(["scenario", "method", "metric"]).sort_index()
    metrics = sections.metrics_there(summary, RANKED)
    rows = []
    for label, each in traits.items():
        mine = []
        for method in unique(summary.method[summary.scenario == label]):
            cells = {name: _cell(table, label, method, name) for name in metrics}
            total = cells.get("total_error", page.Cell("", None)).value
            texts = [
                page.Cell(f"{each[name]:g}", each[name])
                if TRAIT_COLUMNS[name].kind == "number"
                else trait(name, each[name]).removeprefix("b ")
                for name in varying
            ]
            mine.append(
                (
                    math.inf if total is None else total,
                    page.Row((method, *texts, *cells.values()), label),
                )
            )
        rows += [row for _, row in sorted(mine, key=lambda pair: pair[0])]
    shared = described(traits[next(iter(traits))], [name for name in TRAITS if name not in varying])
    caption = (
        "Metrics of each method, value ± standard error; the lowest total error comes first in "
        f"each scenario. Click a heading to sort.{f' The same in all: {shared}.' if shared else ''}"
    )
    columns = [
        page.Column("method", kind="label"),
        *(TRAIT_COLUMNS[name] for name in varying),
        *(
            page.Column(heading, unit, "number")
            for heading, unit, _ in (RANKED[name] for name in metrics)
        ),
    ]
    groups = {label: described(each) for label, each in traits.items()}
    return page.Table(
        "Ranking of methods",
        caption,
        columns,
        rows,
        "ranking-table",
        True,
        groups=groups,
        chosen=main_scenario(traits),
    )


def _cell(table: pd.DataFrame, *key: str) -> page.Cell:
    """Return a metric of one scenario and method, times in ms."""
    if key not in table.index:
        return page.number(math.nan)
    value, error = table[["value", "standard_error"]].to_numpy(dtype=float)[
        table.index.get_loc(key)
    ]
    factor = 1000 if key[-1] == "seconds" else 1
    return page.number(factor * value, factor * error, RANKED[key[-1]][2])


def outcome(results: xr.Dataset, summary: pd.DataFrame, claims: pd.DataFrame) -> list[str]:
    """Describe the main result in sentences."""
    traits = traits_of(results)
    label = main_scenario(traits)
    here, sentences, parts = summary[summary.scenario == label], [], []
    for name, words in BEST.items():
        rows = here[(here.metric == name) & here.value.notna()].sort_values(
            "value", ascending=name != "vaf"
        )
        if len(rows) > 1:
            first: Any = rows.iloc[0]
            value = page.number(
                float(first.value), float(first.standard_error), RANKED[name][2]
            ).text
            parts.append(
                f"{first.method} has the {words} ({value} "
                f"{first.unit}){_runner_up(first, rows.iloc[1])}"
            )
    if parts:
        sentences.append(f"With {described(traits[label])}: {'; '.join(parts)}.")
    total = summary[(summary.metric == "total_error") & summary.value.notna()]
    if len(traits) > 1 and len(total):
        best = total.loc[total.groupby("scenario", sort=False).value.idxmin()].method.value_counts()
        wins = ", ".join(f"{method} in {times} of {len(traits)}" for method, times in best.items())
        sentences.append(f"Lowest total error: {wins} scenarios.")
    return [*sentences, *sections.verdicts(claims)]


def _runner_up(first: Any, second: Any) -> str:
    noise = float(
        np.hypot(*np.nan_to_num([float(each.standard_error) for each in (first, second)]))
    )
    if abs(float(second.value) - float(first.value)) <= 2 * noise:
        return (
            f", though not clearly {'lower' if first.value <= second.value else 'higher'} than "
            f"{second.method}"
        )
    return ""
