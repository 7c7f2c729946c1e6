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
    sizes, found = results.sizes, []
    failures = results.failure.transpose(case, method, draw).values
    warnings = results.warnings.transpose(case, method, draw).values
    lost = (failures == failures[:, :1, :1]).all((1, 2)) & (failures[:, 0, 0] != "")
    lost &= sizes[method] > 1
    for label, text in zip(results[case].values[lost], failures[lost, 0, 0], strict=True):
        number = sizes[method] * sizes[draw]
        found.append((str(label), "failed", number, number, str(text)))
    places = [f"{each}: " if sizes[case] > 1 else "" for each in results[case].values[~lost]]
    for column, label in enumerate(map(str, results[method].values)):
        said: dict[str, list[str]] = {"failed": [], "skipped": [], "warning": []}
        for place, *each in zip(places, failures[~lost], warnings[~lost], strict=True):
            failed, warned = ([text for text in part[column] if text] for part in each)
            said["failed"] += [place + text for text in failed]
            for text in map(str, warned):
                kind = "skipped" if text.startswith(SKIPPED) else "warning"
                said[kind].append(place + text.removeprefix(SKIPPED))
        number = len(places) * sizes[draw]
        found += [(label, kind, len(each), number, each[0]) for kind, each in said.items() if each]
    names = ("method", "kind", "count", "trials", "first")
    return [dict(zip(names, row, strict=True)) for row in found]


def common(
    results: xr.Dataset, claims: pd.DataFrame, settings: Mapping[str, object], what: str
) -> dict[str, Any]:
    """Return the values that the templates of all studies take.

    Parameters
    ----------
    results, claims
        As for :func:`tvsysid.report.write_report`.
    settings
        Settings to be shown.
    what
        Heading of what failed or gave warnings.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    asked = results.asked if "asked" in results else True
    failed = int((results.failure != "").sum())
    tried = int(((results.failure == results.failure) & asked).sum())
    rows: dict[str, object] = {
        **{
            name.replace("_", " "): re.sub(r'["{}\[\]]', "", json.dumps(value, ensure_ascii=False))
            for name, value in settings.items()
        },
        "time of identification": f"{round(float(results.seconds.sum())):,} s on one core",
        "failed identifications": f"{failed} of {tried}",
        **{f"version of {name}": each for name, each in settings_of(results, "versions").items()},
    }
    claims = claims.assign(claim=claims.claim + " (" + claims.source + ")")[CLAIM]
    labels = dict.fromkeys(map(str, results.method_key.values))
    return {
        "results": results,
        "claims": claims,
        "verdicts": claims.verdict.value_counts().to_dict(),
        "methods": {label: METHODS.get(label.partition(":")[0]) for label in labels},
        "problems": problems_table(results, what),
        "settings": pd.DataFrame(rows.items(), columns=["setting", "value"]),
        "failed": failed,
        "tried": tried,
        "version": version_of(results),
    }


def problems_table(results: xr.Dataset, what: str) -> pd.DataFrame:
    """Return :func:`problems` with headings for a page."""
    import pandas as pd  # noqa: PLC0415  # heavy

    rows = [
        (each["method"], each["kind"], f"{each['count']} of {each['trials']}", each["first"])
        for each in problems(results)
    ]
    return pd.DataFrame(rows, columns=[what, "what", "how many", "first reason"])


def version_of(results: xr.Dataset) -> str:
    """Return the version of this package that made the results."""
    return str(settings_of(results, "versions").get("tvsysid", __version__))


def settings_of(results: xr.Dataset, name: str) -> dict[str, Any]:
    """Return the settings in an attribute with JSON text."""
    settings: dict[str, Any] = json.loads(results.attrs.get(name, "{}"))
    return settings
