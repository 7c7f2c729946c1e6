"""What was identified from one recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.style import lines, plain
from tvsysid.models import Model

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def identified_stiffness(
    models: Mapping[str, Model], vaf: Mapping[str, NDArray[np.float64]], title: str = ""
) -> Figure:
    """Stiffness over time by each method, above its time-varying VAF.

    Parameters
    ----------
    models
        By label.
    vaf
        Time-varying VAF in per cent, shape (time,), by label.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Two axes, one above the other.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    for (label, model), (hue, style) in zip(models.items(), lines(list(models)).values(), strict=True):
        plain(upper).plot(model.time, model.stiffness, color=hue, linestyle=style, linewidth=1.4, label=label)
        plain(lower).plot(model.time, vaf[label], color=hue, linestyle=style, linewidth=1.4)
    shown = np.concatenate([model.stiffness for model in models.values()])
    if np.isfinite(shown).any():
        # A method that is out of its depth has spikes; they shall not hide the others.
        low, high = np.nanpercentile(shown, [3, 97])
        room = 0.35 * max(high - low, 0.2 * abs(high))
        upper.set_ylim(low - room, high + room)
    upper.set_ylabel("stiffness (N·m/rad)")
    lower.set_ylabel("time-varying VAF (%)")
    lower.set_xlabel("time within a realization (s)")
    lower.set_ylim(0, 102)
    figure.legend(
        *upper.get_legend_handles_labels(),
        frameon=False,
        loc="outside lower center",
        ncols=max(1, min(len(models), 60 // (6 + max(map(len, models))))),
    )
    figure.suptitle(title, fontsize=11)
    return figure
