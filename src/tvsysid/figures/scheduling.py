"""Estimates over a measured variable, and how often each of its values occurred."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import style
from tvsysid.figures.identification import draw_quantity
from tvsysid.models import Model
from tvsysid.signals import Ensemble

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 40


def variable_of(models: Mapping[str, Model], ensemble: Ensemble) -> str:
    """Name the first channel that a model estimates something over; nothing if there is none."""
    axes = [estimate.axes for model in models.values() for estimate in model.estimates.values()]
    return next((over[0] for over in axes if len(over) == 1 and over[0] in ensemble.channels), "")


@style.styled
def scheduled_estimates(
    models: Mapping[str, Model], ensemble: Ensemble, variable: str, title: str = ""
) -> Figure:
    """Draw each quantity over a variable, with 95 % bands, above a histogram of the variable.

    Parameters
    ----------
    models
        By label; one at least estimates something over the ``variable``.
    ensemble
        With the variable as a channel.
    """
    estimated = [
        (name, each) for model in models.values() for name, each in model.estimates.items()
    ]
    names = list(
        dict.fromkeys(name for name, estimate in estimated if estimate.axes == (variable,))
    )
    columns = min(len(names), 2)
    rows = -(-len(names) // columns)
    figure = style.blank(4.6 * columns + 0.6, 2.6 * rows + 1.8, title)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[*[1.0] * rows, 0.5])
    first = None
    for place, name in enumerate(names):
        first = axes = figure.add_subplot(grid[divmod(place, columns)], sharex=first)
        draw_quantity(axes, name, models)
        axes.set_xlabel(variable)
    values = ensemble.signal(variable)[:, ensemble.core].ravel()
    for column in range(columns):
        below = figure.add_subplot(grid[rows, column], sharex=first)
        below.hist(
            values, BINS, weights=np.full(len(values), 1 / ensemble.sampling_rate), color=style.GREY
        )
        below.set_xlabel(variable)
        below.set_ylabel("time spent there (s)")
    looks = style.lines(list(models))
    style.legend_below(
        figure, [style.line_key(label, **look.line) for label, look in looks.items()]
    )
    return figure
