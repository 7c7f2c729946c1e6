"""What the tables of an experiment's page hold, as plain values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.results import unique
from tvsysid.figures.words import perturbation_name
from tvsysid.report.tables import Cell, number, verdicts

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

METRICS = {
    "mean_stiffness": ("mean stiffness", "N·m/rad", 1),
    "random_error": ("random error", "N·m/rad", 2),
    "vaf": ("VAF", "%", 1),
    "bandpassed_vaf": ("VAF 1-10 Hz", "%", 1),
    "lowest_time_varying_vaf": ("lowest VAF over time", "%", 1),
    "bias_error": ("bias error", "N·m/rad", 2),
    "mean_bias": ("mean bias", "N·m/rad", 2),
    "seconds": ("computing time", "s", 2),
}
"""Heading, unit and decimals of each column of the table of metrics."""
COUNTS = {
    "recorded": "recorded",
    "excluded_alignment": "excluded: shift",
    "excluded_task": "excluded: task component",
    "excluded_residual": "excluded: residual",
    "survivors": "kept",
}
"""Heading of each count of realizations."""


def over_participants(values: NDArray[np.float64], decimals: int | None) -> Cell:
    """Mean ± standard deviation of the values that are there; no deviation of a single one."""
    known = values[np.isfinite(values)]
    if not len(known):
        return number(math.nan)
    spread = float(known.std(ddof=1)) if len(known) > 1 else math.nan
    return number(float(known.mean()), spread, decimals)


def metrics(summary: pd.DataFrame, bootstraps: int) -> dict[str, Any]:
    """Rows of the table of metrics: one for each method, amount of data and perturbation, and the columns' headings.

    ``each`` holds the same for every participant by itself.
    """
    there = [name for name in METRICS if np.isfinite(summary.value[summary.metric == name].astype(float)).any()]
    by = ["perturbation", "method", "realizations"]
    return {
        "rows": _rows(summary, by, there, bootstraps),
        "each": _rows(summary, ["participant", *by], there, bootstraps),
        "headings": [METRICS[name] for name in there],
        "perturbations": [perturbation_name(each) for each in unique(summary.perturbation.to_numpy())],
        "participants": summary.participant.nunique(),
    }


def _rows(summary: pd.DataFrame, by: list[str], metrics: list[str], bootstraps: int) -> list[dict[str, Any]]:
    """A row for each group of the summary's rows, with a cell for each of some metrics."""
    rows = []
    for _, mine in summary.groupby(by, sort=False):
        first = mine.iloc[0]
        values = {str(name): each.value.to_numpy(dtype=float) for name, each in mine.groupby("metric")}
        nothing = np.zeros(0)
        rows.append(
            {
                "participant": str(first.participant),
                "perturbation": perturbation_name(str(first.perturbation)),
                "method": str(first.method),
                "realizations": int(first.realizations),
                "cells": [over_participants(values.get(name, nothing), METRICS[name][2]) for name in metrics],
                "failed": int(np.nansum(values.get("failed", nothing))),
                "draws": bootstraps * mine.participant.nunique(),
            }
        )
    return rows


def recordings(
    results: xr.Dataset, exclusions: pd.DataFrame, reported: Mapping[str, Sequence[str]] = MappingProxyType({})
) -> dict[str, Any]:
    """What became of the realizations of each recording, their means for each perturbation, and the paper's counts."""
    shifts = {
        str(label): 1000 * mine.shift_s[mine.excluded_by == ""].to_numpy(dtype=float)
        for label, mine in exclusions.groupby("recording", sort=False)
    }
    rows = []
    for label in map(str, results.recording.values):
        here = results.sel(recording=label)
        rows.append(
            {
                "label": label,
                "trials": int(here.trials),
                "left_out": int(here.trials_left_out),
                "counts": [int(here[name]) for name in COUNTS],
                "shift": over_participants(shifts.get(label, np.zeros(0)), 0),
            }
        )
    means, paper = [], []
    for perturbation in unique(results.perturbation.values):
        chosen = results.isel(recording=(results.perturbation.values == perturbation) & (results.recorded.values > 0))
        if not chosen.sizes["recording"]:
            continue
        if chosen.sizes["recording"] > 1:
            counts = [chosen[name].values.astype(float) for name in COUNTS]
            cells = [over_participants(each, 1 if np.ptp(each) else 0) for each in counts]
            means.append({"perturbation": perturbation_name(perturbation), "counts": cells})
        theirs = reported.get(perturbation)
        if theirs and theirs[0] in unique(chosen.recorded.values):
            paper.append({"perturbation": perturbation_name(perturbation), "counts": theirs})
    return {"rows": rows, "headings": list(COUNTS.values()), "means": means, "paper": paper}


def remarks(results: xr.Dataset) -> list[dict[str, Any]]:
    """Recordings about which something was remarked, and what."""
    return [
        {"label": str(label), "remarks": lines}
        for label, text in zip(results.recording.values, results.remarks.values, strict=True)
        if (lines := [line.strip() for line in str(text).splitlines() if line.strip()])
    ]


def experiment_troubles(results: xr.Dataset) -> list[dict[str, Any]]:
    """Recordings that failed altogether, then analyses with failures or doubts: how many, and the first reason.

    Parameters
    ----------
    results
        Of an experiment: ``failure`` and ``doubts`` over (recording, analysis), empty where there is none.

    Returns
    -------
    list
        A dict for each: ``method`` (label of the recording or the analysis), ``kind`` (``"failed"`` or
        ``"doubtful"``), ``count`` of how many ``trials``, and the ``first`` reason.
    """
    failure, found = results.failure.transpose("recording", "analysis").values, []
    numbers = np.isfinite(results.vaf.transpose("recording", ...).values)
    lost = (failure != "").all(axis=1) & ~numbers.any(axis=(1, 2))
    for label, reasons in zip(results.recording.values[lost], failure[lost], strict=True):
        count = len(reasons)
        found.append(
            {"method": str(label), "kind": "failed", "count": count, "trials": count, "first": str(reasons[0])}
        )
    left = results.isel(recording=~lost)
    for label in map(str, results.analysis.values):
        for name, kind in (("failure", "failed"), ("doubts", "doubtful")):
            texts = left[name].sel(analysis=label).values
            met = [f"{recording}: {text}" for recording, text in zip(left.recording.values, texts, strict=True) if text]
            if met:
                found.append({"method": label, "kind": kind, "count": len(met), "trials": len(texts), "first": met[0]})
    return found


def outcome(
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    reported: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> list[str]:
    """The main outcome in sentences."""
    sentences = []
    for perturbation in unique(results.perturbation.values):
        chosen = results.isel(recording=(results.perturbation.values == perturbation) & (results.recorded.values > 0))
        if not chosen.sizes["recording"]:
            continue
        recorded = unique(chosen.recorded.values)
        kept = over_participants(chosen.survivors.values.astype(float), 0).text
        of = f"of {recorded[0]}" if len(recorded) == 1 else f"of {min(map(int, recorded))} to {max(map(int, recorded))}"
        counts = reported.get(perturbation)
        paper = f" (the paper: {counts[-1]} of {counts[0]})" if counts and recorded == [counts[0]] else ""
        sentences.append(
            f"With {perturbation_name(perturbation)}, {kept} {of} realizations were kept{paper}."
            f"{_extremes(summary, perturbation)}"
        )
    return [*sentences, *verdicts(claims)]


def _extremes(summary: pd.DataFrame, perturbation: str) -> str:
    """Which methods have the lowest and the highest value of the main metrics, each from its least data."""
    rows = summary[summary.perturbation == perturbation]
    parts = []
    for metric in ("random_error", "vaf", "mean_bias"):
        heading, unit, decimals = METRICS[metric]
        each = {}
        for method, mine in rows[rows.metric == metric].groupby("method", sort=False):
            values = mine.value[mine.realizations == mine.realizations.min()].to_numpy(dtype=float)
            if np.isfinite(values).any():
                each[str(method)] = over_participants(values, decimals)
        order = sorted(each, key=lambda method: each[method].value or 0.0)
        if len(order) == 1:
            parts.append(f"{heading} {each[order[0]].text} {unit} ({order[0]})")
        elif order:
            low, high = order[0], order[-1]
            parts.append(f"{heading} from {each[low].text} ({low}) to {each[high].text} {unit} ({high})")
    return f" With the least data of each method: {'; '.join(parts)}." if parts else ""
