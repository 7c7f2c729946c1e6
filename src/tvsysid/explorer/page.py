"""The page and its results as HTML, from two templates."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from tvsysid.errors import InputError, describe_error
from tvsysid.explorer.outcome import Outcome, outcome
from tvsysid.explorer.settings import Settings, method_settings, settings_from
from tvsysid.methods import METHODS, describe, key_of
from tvsysid.methods.settings import split_settings
from tvsysid.recordings import Channel
from tvsysid.recordings.reading import AngleUnit, Columns, TorqueUnit
from tvsysid.recordings.saved import save_settings
from tvsysid.signals import Array

QUANTITIES = ("stiffness", "viscosity", "inertia", "reflex_gain")
UNITS_AND_COLUMNS = {
    name: (label, {choice: choice for choice in get_args(choices)})
    for name, label, choices in (
        ("angle_unit", "Unit of the angle", AngleUnit),
        ("torque_unit", "Unit of the torque", TorqueUnit),
        ("columns", "Columns of a matrix", Columns),
    )
}
MAX_TIMES = 11  # rows in the table of values over time
PIECES = 300  # of a channel, in whose picture each has a line


@cache
def _templates() -> Environment:
    loader = PackageLoader("tvsysid.explorer", "")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)


def page(start: Settings, channels: Mapping[str, Channel]) -> str:
    """Return the page, which begins with some settings. ``channels`` are those of a file."""
    key = key_of(start.method)
    groups: dict[str, dict[str, tuple[str, dict[str, str]]]] = {}
    for name in dict.fromkeys((key, *METHODS)):
        about = describe(name)
        groups.setdefault(about.purpose, {})[name] = about.title, method_settings(name)
    labels = {name: f"{name} ({each.described})" for name, each in channels.items()}
    return (
        _templates()
        .get_template("page.html")
        .render(
            start=start,
            title=start.source.name if isinstance(start.source, Path) else "recording",
            channels=channels and {"": "choose a channel", **labels},
            lines={labels[name]: line(each.read(name)) for name, each in channels.items()},
            units=UNITS_AND_COLUMNS,
            groups=groups,
            key=key,
            typed=split_settings(start.method[len(key) + 1 :]),
            quantities=QUANTITIES,
        )
    )


def line(values: Array) -> str:
    """Return a channel over time as points of a line, from 0 to 1: the extremes of its pieces."""
    flat = values.ravel("F").real
    starts = np.arange(0, len(flat), max(1, len(flat) // PIECES))
    ends = np.stack([each.reduceat(flat, starts) for each in (np.fmin, np.fmax)], 1).ravel()
    y = np.interp(ends, [np.fmin.reduce(ends), np.fmax.reduce(ends)], [1, 0])
    x = np.linspace(0, 1, len(ends))
    return " ".join(f"{x[n]:.4g},{y[n]:.4g}" for n in np.flatnonzero(np.isfinite(y)))


def result(form: Mapping[str, str], start: Settings) -> str:
    """Return what the page shows of the form's settings: the outcome, or the error."""
    try:
        settings = settings_from(form, start)
        found = outcome(settings, form["quantity"], form["band"] == "simultaneous")
        if "save" in form and isinstance(settings.source, Path):
            save_settings(settings.source, settings.reading, settings.cutting)
    except Exception as error:  # a user's method may raise anything
        text = str(error) if isinstance(error, InputError) else f"Error: {describe_error(error)}"
        return _templates().get_template("result.html").render(error=text)
    return shown(found, form["quantity"])


def shown(found: Outcome, quantity: str = "stiffness") -> str:
    """Return an outcome as HTML."""
    answer = found.found.answer
    words = quantity.replace("_", " ")
    summary = found.found.summary().rename(columns={"VAF (%)": "VAF in sample (%)"})
    summary = summary.set_index("method").T
    over_time = found.found.over_time().set_index("method").loc[answer.label].set_index("time_s")
    every = max(1, len(over_time) // (MAX_TIMES - 1))
    again = {
        "On the command line": found.settings.command,
        "In Python": found.settings.python,
    }
    return (
        _templates()
        .get_template("result.html")
        .render(
            error="",
            found=found,
            words=words,
            is_identified=quantity in answer.model.estimates,
            picture=base64.b64encode(found.picture).decode(),
            summary=_table(summary.rename(lambda name: name.replace("half_band", "95 % band, ±"))),
            over_time=_table(over_time.iloc[::every]),
            again={label: text for label, text in again.items() if text},
        )
    )


def _table(frame: pd.DataFrame) -> str:
    return frame.to_html(float_format="{:.4g}".format, na_rep="", border=0)
