"""Stiffness of people over time: of all of them, and of one in detail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.figures import style
from tvsysid.figures.results import headings, is_known, label_time, of_least_data, unique
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ABREAST = 6  # participants side by side; further ones begin a new line
TARGET_LINE: dict[str, Any] = {"color": style.TARGET, "linewidth": 0.8}
BEHIND: dict[str, Any] = {"color": "#C0C0C0", "linewidth": 1.3, "label": "torque to be followed"}
# Mean torque by perturbation; overlapping lines all show.
TORQUES: tuple[dict[str, Any], ...] = (
    {"color": "#B98345", "linewidth": 2.8},
    {"color": "#5C3A12", "linewidth": 1.3, "linestyle": "--"},
    {"color": "#8A5A24", "linewidth": 1.6, "linestyle": ":"},
    {"color": "#3B2408", "linewidth": 0.9, "linestyle": "-."},
)
LABELS = {"estimate": "stiffness\n(N·m/rad)", "time_varying_vaf": "time-varying VAF\n(%)"}


@style.styled
def stiffness_of_participants(results: xr.Dataset, title: str = "") -> Figure:
    """Draw the mean stiffness of every participant, a line for each method, above the torque.

    A column for each participant, six of them abreast; a row for each perturbation, and one for the
    torque if it is known. Vertical scales are common.

    Parameters
    ----------
    results
        Of an experiment: the estimates, the truth, ``target_torque`` and ``mean_torque``, the last
        three NaN where not known. Each method is shown with the fewest realizations that it was
        given.
    """
    results = of_least_data(results)
    people, perturbations = (
        unique(results[name].values) for name in ("participant", "perturbation")
    )
    torques = np.stack([results.target_torque.values, results.mean_torque.values])
    has_torque = bool(np.isfinite(torques).any())
    heights = [1.0] * len(perturbations) + [0.55] * has_torque
    blocks, wide = -(-len(people) // ABREAST), min(len(people), ABREAST)
    figure, grid = style.panels(
        len(heights) * blocks,
        wide,
        max(1.5 * wide, 3.6) + 0.9,
        (1.45 * sum(heights) + 0.35) * blocks + 0.8,
        title,
        sharex=True,
        height_ratios=heights * blocks,
    )
    draws = results.estimate.transpose("bootstrap", "analysis", "recording", "time").values
    limits = style.usual_limits(mean_and_spread(draws)[0], results.truth.values)
    columns = [column for block in np.split(grid, blocks) for column in block.T]
    for person, column in zip(people, columns, strict=False):
        column[0].set_title(wrapped(person))
        mine = results.isel(recording=results.participant.values == person)
        for axes, perturbation, torque in zip(column, perturbations, TORQUES * 9, strict=False):
            axes.set_ylim(limits)
            one = mine.isel(recording=mine.perturbation.values == perturbation)
            if not one.sizes["recording"]:
                style.remark(axes, "not recorded")
                continue
            draw_methods(axes, one.isel(recording=0))
            if has_torque:
                column[-1].plot(one.time, one.mean_torque[0], **torque)
                column[-1].plot(one.time, one.target_torque[0], **TARGET_LINE)
                column[-1].set_ylim(style.usual_limits((), torques))
        label_time(column[-1], results)
        column[-1].tick_params(labelbottom=True)
    for axes in np.ravel(columns[len(people) :]):
        axes.set_axis_off()
    names = [wrapped(perturbation_name(each)) for each in perturbations]
    labels = [*(f"{name}\n{LABELS['estimate']}" for name in names), "torque\n(N·m)"]
    for axes, label in zip(grid[:, 0], labels[: len(heights)] * blocks, strict=True):
        axes.set_ylabel(label)
    for axes in grid[:, 1:].flat:
        axes.tick_params(labelleft=False)
    figure.align_ylabels(grid[:, 0])
    looks = style.lines(unique(results.method_key.values)).values()
    pairs = zip(headings(results, 60), looks, strict=True)
    keys = [style.line_key(text, **look.line) for text, look in pairs]
    keys += [style.line_key(**style.TRUE_LINE)] * is_known(results)
    if np.isfinite(results.target_torque).any():
        keys.append(style.line_key("torque to be followed", **TARGET_LINE))
    if np.isfinite(results.mean_torque).any():
        keys += [
            style.line_key(f"mean torque, {name}", **torque)
            for name, torque in zip(names, TORQUES * 9, strict=False)
        ]
    style.legend_below(figure, keys)
    return figure


def draw_methods(axes: Axes, results: xr.Dataset) -> None:
    """Draw the truth and the mean by every method, of a single recording."""
    axes.plot(results.time, results.truth, **style.TRUE_LINE)
    means, _ = mean_and_spread(results.estimate.transpose("bootstrap", "analysis", "time").values)
    if not np.isfinite(means).any():
        style.remark(axes, "no estimate")
    looks = style.lines(unique(results.method_key.values)).values()
    for place, (mean, look) in enumerate(zip(means, looks, strict=True)):
        curve = look.curve(len(mean), place, len(means)) | {"markersize": 3.0}
        axes.plot(results.time, mean, linewidth=1.0, **curve)


@style.styled
def participant_in_detail(results: xr.Dataset, participant: str, title: str = "") -> Figure:
    """Draw stiffness and VAF over time of one participant: mean ± 2 SD over bootstraps.

    A column for each method, with the fewest realizations that it was given; a row for each
    perturbation with the stiffness, and one with the VAF. A grey line is the torque to be followed,
    with its scale on the right.

    Parameters
    ----------
    results
        As of :func:`stiffness_of_participants`, with ``time_varying_vaf``.
    participant
        Whose recordings are shown; ``InputError`` if there is none of that name.
    """
    return _bands(results, "participant", participant, tuple(LABELS), title)


@style.styled
def stiffness_with_bands(results: xr.Dataset, recording: str, title: str = "") -> Figure:
    """Draw the stiffness of one recording by every method in a row: mean ± 2 SD over bootstraps.

    A column for each method, as in :func:`participant_in_detail`, 180 mm wide for five of them.
    ``InputError`` if there is no recording of this label.
    """
    return _bands(results, "recording", recording, ("estimate",), title)


def _bands(
    results: xr.Dataset, kind: str, label: str, variables: Sequence[str], title: str
) -> Figure:
    """Return rows of axes for the recordings of this label, a column for each method."""
    if label not in results[kind].values:
        known = ", ".join(unique(results[kind].values))
        raise InputError(f"figure: there is no {kind} {label!r}; there are {known}")
    here = of_least_data(results.isel(recording=results[kind].values == label))
    columns, recordings = here.sizes["analysis"], here.sizes["recording"]
    rows = [(variable, place) for variable in variables for place in range(recordings)]
    figure, grid = style.panels(
        len(rows),
        columns,
        max(1.25 * columns, 2.6) + 0.84,
        1.35 * len(rows) + 1.1,
        title,
        sharex=True,
        sharey="row",
    )
    draws = here.transpose("analysis", "bootstrap", "recording", "time", ...)
    limits = {
        "estimate": style.usual_limits(draws.estimate.values, here.truth.values),
        "time_varying_vaf": (0.0, 102.0),
    }
    # Without a torque to be followed there need be no task, and the mean torque means little.
    target = here.target_torque
    hues = style.hues(unique(here.method_key.values)).values()
    for row, (variable, place) in zip(grid, rows, strict=True):
        one = here.isel(recording=place)
        name = wrapped(perturbation_name(one.perturbation.item()))
        row[0].set_ylabel(f"{name}\n{LABELS[variable]}" if recordings > 1 else LABELS[variable])
        row[0].set_ylim(limits[variable])
        values = one[variable].transpose("bootstrap", "analysis", "time").values
        upper_limit = np.inf if variable == "estimate" else 100.0
        for axes, hue, mean, spread in zip(row, hues, *mean_and_spread(values), strict=True):
            if variable == "estimate":
                axes.plot(one.time, one.truth, **style.TRUE_LINE)
            band = (mean - 2 * spread, np.minimum(mean + 2 * spread, upper_limit))
            style.curve_with_band(axes, one.time.values, mean, band, hue)
            if np.isfinite(one.target_torque).any():
                behind = _torque_behind(axes, one, axes is row[-1])
                behind.set_ylim(style.usual_limits((), target.values))
    for axes, heading in zip(grid[0], headings(here, 15), strict=True):
        axes.set_title(heading, fontsize=8.5)
    label_time(grid[-1], here)
    figure.align_ylabels(grid[:, 0])
    keys: list[Artist] = style.band_keys(here.sizes["bootstrap"], "bootstrap")
    keys += [style.line_key(**style.TRUE_LINE)] * is_known(here)
    keys += [style.line_key(**BEHIND)] * bool(np.isfinite(target).any())
    style.legend_below(figure, keys)
    return figure


def _torque_behind(axes: Axes, results: xr.Dataset, is_last: bool) -> Axes:
    """Draw the torque to be followed behind the axes, and return its own axes."""
    behind = axes.twinx()
    behind.plot(results.time, results.target_torque, **BEHIND)
    behind.set_zorder(axes.get_zorder() - 1)
    axes.patch.set_visible(False)
    behind.grid(visible=False)
    behind.spines["right"].set_visible(True)
    behind.tick_params(labelright=is_last, colors=style.GREY)
    behind.set_ylabel("torque (N·m)" if is_last else "", color=style.GREY)
    return behind
