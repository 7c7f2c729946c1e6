"""What the pages of all studies show: metrics, claims, failures and warnings, settings, methods."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid import __version__
from tvsysid.methods import METHODS
from tvsysid.report.page import in_text
from tvsysid.study.dataset import axes_of
from tvsysid.study.measure import SKIPPED

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

METRICS = {
    "mean_stiffness": ("mean stiffness", "N·m/rad", 1),
    "bias_error": ("bias error", "N·m/rad", 2),
    "random_error": ("random error", "N·m/rad", 2),
    "total_error": ("total error", "N·m/rad", 2),
    "mean_bias": ("mean bias", "N·m/rad", 2),
    "rise_time": ("rise time", "s", 3),
    "vaf": ("VAF", "%", 2),
    "bandpassed_vaf": ("VAF 1–10 Hz", "%", 2),
    "lowest_time_varying_vaf": ("lowest VAF over time", "%", 1),
    "coverage": ("in 95 % band", "%", 1),
    "reflex_gain total_error": ("error of reflex gain", "N·m·s/rad", 2),
    "intrinsic pathway_vaf": ("VAF intrinsic", "%", 1),
    "reflex pathway_vaf": ("VAF reflex", "%", 1),
    "seconds": ("time", "ms", 1),
}
"""Heading, unit and decimals of each metric."""
BEST = ("bias_error", "random_error", "total_error", "rise_time", "vaf")
MAX_TIE = 2.0  # standard errors of a difference up to which it is not clear
CLAIM = ["claim", "verdict", "finding", "estimate", "low", "high", "unit", "remark"]


def metric_columns(values: pd.DataFrame, errors: pd.DataFrame) -> dict[str, list[str]]:
    """Return a column of texts for each metric that has values, ± errors, by heading."""
    columns = {}
    for name, (heading, unit, decimals) in METRICS.items():
        if name in values and values[name].notna().any():
            factor = 1000 if unit == "ms" else 1
            pairs = zip(factor * values[name], factor * errors[name], strict=True)
            columns[f"{heading} ({unit})"] = [in_text(*pair, decimals) for pair in pairs]
    return columns


def best_methods(summary: pd.DataFrame) -> list[dict[str, str]]:
    """Return the best method by each metric, and its ``rival`` if they do not differ clearly."""
    best = []
    for metric in BEST:
        rows = summary[summary.metric == metric].dropna(subset=["value"])
        rows = rows.sort_values("value", ascending=metric != "vaf")
        if len(rows) < 2:
            continue
        (heading, unit, decimals), (first, second) = METRICS[metric], rows.value[:2]
        error = np.hypot(*rows.standard_error.fillna(0.0)[:2])
        best.append(
            {
                "method": rows.method.iloc[0],
                "words": f"{'highest' if metric == 'vaf' else 'lowest'} {heading}",
                "value": f"{in_text(first, rows.standard_error.iloc[0], decimals)} {unit}",
                "rival": "" if abs(second - first) > MAX_TIE * error else rows.method.iloc[1],
            }
        )
    return best


def problems(results: xr.Dataset) -> list[dict[str, Any]]:
    """Return failures and warnings of a study: how often, and the first reason.

    A dict for each: ``method`` (label of the method, or of a recording of which nothing could be
    identified), ``kind`` (``"failed"``, ``"skipped"`` or ``"warning"``), ``count`` of how many
    ``trials``, and the ``first`` reason.
    """
    case, draw, method = axes_of(results)
    table = results[["failure", "warnings"]].to_dataframe([method, case, draw]).reset_index()
    reasons = table.groupby(case).failure
    is_lost = (reasons.transform("nunique") == 1) & (table.failure != "")
    if results.sizes[method] > 1:
        table[method] = table[method].mask(is_lost, table[case])
    trials = table[method].value_counts()
    table = table.melt([method, case], ["failure", "warnings"], "kind", "first")
    table = table[table["first"] != ""].replace({"failure": "failed", "warnings": "warning"})
    table["kind"] = table.kind.mask(table["first"].str.startswith(SKIPPED), "skipped")
    table["first"] = table["first"].str.removeprefix(SKIPPED)
    if results.sizes[case] > 1:
        is_own = table[method] == table[case]
        table["first"] = table["first"].where(is_own, table[case] + ": " + table["first"])
    found = table.groupby([method, "kind"], sort=False)["first"].agg(["size", "first"])
    return [
        {"method": label, "kind": kind, "count": count, "trials": int(trials[label]), "first": text}
        for label, kind, count, text in found.reset_index().itertuples(index=False)
    ]


def common(
    results: xr.Dataset, claims: pd.DataFrame, settings: Mapping[str, object]
) -> dict[str, Any]:
    """Return the values that the templates of all studies take.

    Results and claims are those of :func:`tvsysid.report.write_report`; the settings are shown.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    rows: dict[str, object] = {
        **{
            name.replace("_", " "): re.sub(r'["{}\[\]]', "", json.dumps(value, ensure_ascii=False))
            for name, value in settings.items()
        },
        "time of identification": f"{float(results.seconds.sum()):,.0f} s on one core",
        **{f"version of {name}": each for name, each in settings_of(results, "versions").items()},
    }
    labels = dict.fromkeys(map(str, results.method_key.values))
    return {
        "results": results,
        "claims": claims.assign(claim=claims.claim + " (" + claims.source + ")")[CLAIM],
        "verdicts": claims.verdict.value_counts().to_dict(),
        "methods": {label: METHODS.get(label.partition(":")[0]) for label in labels},
        "problems": problems(results),
        "settings": pd.DataFrame(rows.items(), columns=["setting", "value"]),
        "failed": int((results.failure != "").sum()),
        "tried": int((results.failure.notnull() & results.get("asked", True)).sum()),
        "version": version_of(results),
    }


def version_of(results: xr.Dataset) -> str:
    """Return the version of this package that made the results."""
    return str(settings_of(results, "versions").get("tvsysid", __version__))


def settings_of(results: xr.Dataset, name: str) -> dict[str, Any]:
    """Return the settings in an attribute with JSON text."""
    settings: dict[str, Any] = json.loads(results.attrs.get(name, "{}"))
    return settings
