"""What the pages of all studies show: claims, failures and warnings, settings, methods."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid import __version__
from tvsysid.methods import METHODS
from tvsysid.report.page import in_text
from tvsysid.study.dataset import axes_of
from tvsysid.study.measure import SKIPPED
from tvsysid.study.settings import in_words

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SYMBOLS = {"holds": "✓", "does not hold": "✗", "undecided": "?", "not studied": "–"}
CLAIM = ["claim", "verdict", "finding", "estimate", "limits", "unit", "remark"]


def problems(results: xr.Dataset) -> list[dict[str, Any]]:
    """Return failures and warnings of a study: how often, and the first reason.

    A dict for each: ``method`` (label of the method, or of a recording of which nothing could be
    identified), ``kind`` (``"failed"``, ``"skipped"`` or ``"warning"``), ``count`` of how many
    ``trials``, and the ``first`` reason.
    """
    case, draw, method = axes_of(results)
    failure = results.failure.transpose(case, method, draw).values
    is_same = (failure == failure[:, :1, :1]) & (failure != "")
    is_lost = is_same.all(axis=(1, 2)) & (failure.shape[1] > 1)
    rows = [
        (str(label), "failed", texts.size, texts.size, str(texts.flat[0]))
        for label, texts in zip(results[case].values[is_lost], failure[is_lost], strict=True)
    ]
    left = results.isel({case: ~is_lost})
    places = [f"{label}: " if len(failure) > 1 else "" for label in left[case].values]
    for label in map(str, left[method].values):
        mine = left.sel({method: label})
        found: dict[str, list[str]] = {"failed": [], "skipped": [], "warning": []}
        for place, failures, warned in zip(
            places,
            mine.failure.transpose(case, draw).values,
            mine.warnings.transpose(case, draw).values,
            strict=True,
        ):
            found["failed"] += [f"{place}{text}" for text in failures if text]
            for text in filter(None, map(str, warned)):
                kind = "skipped" if text.startswith(SKIPPED) else "warning"
                found[kind].append(f"{place}{text.removeprefix(SKIPPED)}")
        count = mine.sizes[case] * mine.sizes[draw]
        rows += [(label, kind, len(each), count, each[0]) for kind, each in found.items() if each]
    names = ("method", "kind", "count", "trials", "first")
    return [dict(zip(names, row, strict=True)) for row in rows]


def common(
    results: xr.Dataset,
    claims: pd.DataFrame,
    labels: Iterable[str],
    settings: Mapping[str, object],
    what: str,
) -> dict[str, Any]:
    """Return the values that the templates of all studies take.

    Parameters
    ----------
    results, claims
        As for :func:`tvsysid.report.write_report`.
    labels
        Of the methods.
    settings
        To be shown, with what is known of the computation.
    what
        Heading of what failed or gave warnings.
    """
    return {
        "results": results,
        "claims": claims_table(claims),
        "verdicts": claims.verdict.value_counts().reindex(list(SYMBOLS)).dropna().astype(int),
        "methods": {label: METHODS.get(label.partition(":")[0]) for label in labels},
        "problems": problems_table(results, what),
        "settings": settings_table(results, settings),
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


def claims_table(claims: pd.DataFrame) -> pd.DataFrame:
    """Return claims with headings for a page, and their numbers as text."""
    import pandas as pd  # noqa: PLC0415  # heavy

    rows = []
    each: Any
    for each in claims.itertuples():
        is_known = np.isfinite([each.low, each.high]).all()
        row = {
            "claim": f"{each.claim} ({each.source})",
            "verdict": f"{SYMBOLS[each.verdict]} {each.verdict}",
            "finding": each.finding,
            "estimate": in_text(each.estimate),
            "limits": f"{in_text(each.low)} to {in_text(each.high)}" if is_known else "",
            "unit": each.unit,
            "remark": each.remark,
        }
        rows.append(row)
    return pd.DataFrame(rows, columns=CLAIM)


def settings_table(results: xr.Dataset, settings: Mapping[str, object]) -> pd.DataFrame:
    """Return what was run, in words: settings, versions and the machine."""
    import pandas as pd  # noqa: PLC0415  # heavy

    versions = {"tvsysid": version_of(results)} | settings_of(results, "versions")
    rows = {name.replace("_", " "): in_words(value) for name, value in settings.items()}
    rows |= {f"version of {name}": str(each) for name, each in versions.items()}
    rows |= {"machine": str(results.attrs["machine"])} if "machine" in results.attrs else {}
    return pd.DataFrame(rows.items(), columns=["setting", "value"])


def with_heading(metrics: Mapping[str, tuple[str, str, int]], summary: pd.DataFrame) -> list[str]:
    """Return the metrics that have a value somewhere, in order."""
    known = set(summary.metric[np.isfinite(summary.value.astype(float))])
    return [name for name in metrics if name in known]


def version_of(results: xr.Dataset) -> str:
    """Return the version of this package that made the results."""
    return str(settings_of(results, "versions").get("tvsysid", __version__))


def settings_of(results: xr.Dataset, name: str) -> dict[str, Any]:
    """Return the settings in an attribute with JSON text."""
    settings: dict[str, Any] = json.loads(results.attrs.get(name, "{}"))
    return settings
