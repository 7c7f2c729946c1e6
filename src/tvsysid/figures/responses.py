"""Impulse responses, like figure 2 of van de Ruit et al. 2021."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.figures.style import lines, plain
from tvsysid.figures.words import wrapped

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


def impulse_responses(responses: xr.Dataset, title: str = "") -> Figure:
    """True and identified impulse responses at chosen instants.

    Parameters
    ----------
    responses
        ``impulse_response`` over (method_key, instant, lag) and ``true_impulse_response`` over (instant, lag), in
        N·m/(rad·s); coordinates lag and instant in s, and stiffness over (instant,) in N·m/rad.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        One axes for each instant.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    count = responses.sizes["instant"]
    figure = Figure(figsize=(3.2 * count + 1.9, 3.4), layout="constrained")
    grid = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)[0]
    methods = [str(name) for name in responses.method_key.values]
    for axes, instant in zip(grid, responses.instant.values, strict=True):
        here = responses.sel(instant=instant)
        plain(axes).plot(here.lag, here.true_impulse_response, color="#BBBBBB", linewidth=5, label="truth")
        for number, (method, (hue, _)) in enumerate(lines(methods).items()):
            # Dashes begin at different places, so that lines on top of each other all show.
            style = (3.0 * number, (5.0, 2.5))
            response = here.impulse_response.sel(method_key=method)
            axes.plot(here.lag, response, color=hue, linestyle=style, linewidth=1.5, label=wrapped(method))
        axes.set_title(f"k = {float(here.stiffness):.0f} N·m/rad, at {float(instant):g} s", fontsize=9)
        axes.set_xlabel("lag (s)", fontsize=8)
        axes.margins(x=0)
        axes.tick_params(labelsize=8)
    grid[0].set_ylabel("impulse response (N·m/(rad·s))", fontsize=8)
    figure.legend(*grid[0].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside right upper")
    figure.suptitle(title, fontsize=10)
    return figure
