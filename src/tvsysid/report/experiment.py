"""The page of an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid import __version__
from tvsysid.figures import Picture
from tvsysid.figures.results import unique
from tvsysid.report import experiment_tables, tables
from tvsysid.report.rendering import embedded, settings_of, words, write_page

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DETAILS = ("recorded-signals", "preparation")
"""Figures that stand beside the account of the recordings."""


def write_experiment_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    exclusions: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    reported: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> None:
    """Write one HTML file that holds all of an experiment's outcome and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    results
        Over recording, analysis, bootstrap and time, as :func:`tvsysid.figures.experiment_figures` takes them.
    summary
        Of these results: columns participant, perturbation, method, realizations, metric, value, unit.
    claims
        What the paper says of its experiment and whether it holds here; may have no rows.
    exclusions
        A row for each realization recorded: columns recording, excluded_by and shift_s are used.
    pictures
        As of :func:`tvsysid.figures.draw_all`.
    command
        What was typed to analyse the experiment; the page says nothing of it if empty.
    reported
        Realizations recorded, excluded by each step, and kept, as a paper reports them, by perturbation; shown beside
        recordings of as many realizations.
    """
    content = _content(results, summary, claims, exclusions, pictures, command, reported)
    write_page(path, "experiment.html", content)


def _content(
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    exclusions: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str,
    reported: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """What the template is filled with."""
    versions = settings_of(results, "versions")
    methods = unique(results.method_key.values)
    people = unique(results.participant.values)
    known = np.isfinite(results.true_stiffness.values).any(axis=1)
    virtual = unique(results.participant.values[known])
    there = results.checksums.transpose("recording", "analysis", ...).values.any(axis=-1)
    draws = results.vaf.transpose("recording", "analysis", "bootstrap").values[there]
    return {
        "sizes": {
            **{str(name): size for name, size in results.sizes.items()},
            "participant": len(people),
            "method": len(methods),
        },
        "truth": "all" if len(virtual) == len(people) else "some" if virtual else "none",
        "unfinished": [int(there.sum()), there.size] if not there.all() else None,
        "identifications": draws.size,
        "failed": int(np.count_nonzero(np.isnan(draws))),
        "outcome": experiment_tables.outcome(results, summary, claims, reported),
        "figures": embedded({stem: each for stem, each in pictures.items() if stem not in DETAILS}),
        "metrics": experiment_tables.metrics(summary, results.sizes["bootstrap"]),
        "claims": tables.claim_rows(claims),
        "recordings": experiment_tables.recordings(results, exclusions, reported),
        "details": embedded({stem: each for stem, each in pictures.items() if stem in DETAILS}),
        "remarks": experiment_tables.remarks(results),
        "troubles": experiment_tables.experiment_troubles(results),
        "methods": tables.methods(methods),
        "settings": {
            name.replace("_", " "): words(value) for name, value in settings_of(results, "experiment").items()
        },
        "version": versions.get("tvsysid", __version__),
        "versions": {name: each for name, each in versions.items() if name != "tvsysid"},
        "machine": results.attrs.get("machine", ""),
        "seconds": round(float(np.nansum(results.seconds.values))),
        "command": command,
        "first": {"recording": str(results.recording.values[0]), "analysis": str(results.analysis.values[0])},
    }
