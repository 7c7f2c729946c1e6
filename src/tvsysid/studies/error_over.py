"""Figure of an error against the size of something, with its values in words."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from tvsysid.figures import Illustration, error_against

if TYPE_CHECKING:
    import pandas as pd


def error_over(
    summary: pd.DataFrame,
    metric: str,
    sizes: pd.Series,
    title: str,
    text: str,
    *axes: str,
) -> Illustration:
    """Return the figure of a metric against a size.

    Parameters
    ----------
    summary
        Summary of a study, with full names.
    sizes
        Size of each scenario, by its label.
    title, text
        Title, and the first sentence of the description.
    axes
        Label of the horizontal axis and, if it is no bias of the stiffness, of the vertical one.
    """
    rows = summary[(summary.metric == metric) & summary.scenario.isin(sizes.index)]
    rows = rows.assign(size=rows.scenario.map(sizes)).dropna(subset=["value"])
    rows = rows.sort_values("size", kind="stable")
    rows = rows[rows.groupby("method")["size"].transform("nunique") > 1]
    lines = (
        f"{method}: {', '.join(f'{row.value:.3g} at {row.size:g}' for row in line.itertuples())}."
        for method, line in rows.groupby("method", sort=False)
    )
    horizontal, *vertical = axes
    drawing = partial(error_against, horizontal, rows, title, *vertical)
    return Illustration(drawing, title, " ".join([text, *lines]))
