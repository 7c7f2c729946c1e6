"""Impulse responses of several methods on top of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.figures.style import hues, legend_below, panels, styled
from tvsysid.figures.words import wrapped

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


@styled
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
    count = responses.sizes["instant"]
    figure, grid = panels(1, count, max(3.2 * count + 0.6, 4.0), 3.6, title, sharex=True, sharey=True)
    methods = [str(name) for name in responses.method_key.values]
    for axes, instant in zip(grid[0], responses.instant.values, strict=True):
        here = responses.sel(instant=instant)
        axes.plot(here.lag, here.true_impulse_response, color="#BBBBBB", linewidth=5, label="truth")
        for number, (method, hue) in enumerate(hues(methods).items()):
            # Dashes begin at different places, so that lines on top of each other all show.
            style = (3.0 * number, (5.0, 2.5))
            response = here.impulse_response.sel(method_key=method)
            axes.plot(here.lag, response, color=hue, linestyle=style, linewidth=1.5, label=wrapped(method, 40))
        axes.set_title(f"k = {float(here.stiffness):.0f} N·m/rad, at {float(instant):g} s")
        axes.set_xlabel("lag (s)")
        axes.margins(x=0)
    grid[0, 0].set_ylabel("impulse response (N·m/(rad·s))")
    legend_below(figure, grid[0, 0].lines)
    return figure
