"""The page of a simulation study."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from tvsysid import __version__
from tvsysid.figures import Picture
from tvsysid.report import tables
from tvsysid.report.rendering import embedded, settings_of, words, write_page

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OBJECT = re.compile(r"\w+\(.*\)")
"""Label of a method that was given as an object, which no file can name."""
SETTINGS = {
    "stiffness": "stiffness profiles",
    "perturbation": "perturbations",
    "duration_s": "data (s)",
    "snr_db": "signal-to-noise ratio of the torque (dB)",
    "methods": "methods",
    "trials": "trials of each scenario",
    "seed": "seed",
    "viscosity": "viscosity",
}


def write_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
) -> None:
    """Write one HTML file that holds all of a study's outcome and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    results
        As of :func:`tvsysid.study.run`.
    summary
        Of these results, as of :func:`tvsysid.study.summarize`.
    claims
        What the paper says and whether it holds here; may have no rows.
    pictures
        As of :func:`tvsysid.figures.draw_all`.
    command
        What was typed to run the study; the page says nothing of it if empty.
    """
    write_page(path, "page.html", _content(results, summary, claims, pictures, command))


def _content(
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str,
) -> dict[str, Any]:
    """What the template is filled with."""
    study = settings_of(results, "study")
    there = results.checksums.values.any(axis=-1)
    known = results.failure.values[there]
    return {
        "outcome": tables.outcome(results, summary, claims),
        "sizes": {str(name): size for name, size in results.sizes.items()},
        "unfinished": [int(there.sum()), there.size] if not there.all() else None,
        "identifications": known.size,
        "failed": sum(text != "" for text in known.ravel()),
        "version": settings_of(results, "versions").get("tvsysid", __version__),
        "versions": {name: each for name, each in settings_of(results, "versions").items() if name != "tvsysid"},
        "machine": results.attrs.get("machine", ""),
        "seconds": round(float(results.seconds.sum() + results.stage_seconds.sum())),
        "settings": {SETTINGS.get(name, name.replace("_", " ")): words(value) for name, value in study.items()},
        "ranking": tables.ranking(results, summary),
        "figures": embedded(pictures),
        "claims": tables.claim_rows(claims),
        "methods": tables.methods(map(str, results.method_key.values)),
        "troubles": tables.troubles(results),
        "command": command,
        "toml": "" if any(OBJECT.fullmatch(label) for label in study.get("methods", ())) else tomli_w.dumps(study),
    }
