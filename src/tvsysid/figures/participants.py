"""Stiffness of people over time: of all of them, and of one in detail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.figures import style
from tvsysid.figures.results import (
    estimates,
    headings,
    knows_truth,
    label_time,
    least_data,
    mean_stiffness,
    recording_of,
    truth,
    unique,
)
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ABREAST = 6  # participants side by side; further ones begin a new line
TARGET_LINE: dict[str, Any] = {"color": style.TARGET, "linewidth": 0.8}
BEHIND: dict[str, Any] = {"color": "#C0C0C0", "linewidth": 1.3}
# Mean torque by perturbation; overlapping lines all show.
TORQUES: tuple[dict[str, Any], ...] = (
    {"color": "#B98345", "linewidth": 2.8},
    {"color": "#5C3A12", "linewidth": 1.3, "linestyle": "--"},
    {"color": "#8A5A24", "linewidth": 1.6, "linestyle": ":"},
    {"color": "#3B2408", "linewidth": 0.9, "linestyle": "-."},
)
LABELS = {"stiffness": "stiffness\n(N·m/rad)", "time_varying_vaf": "time-varying VAF\n(%)"}


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
    people = unique(results.participant.values)
    perturbations = unique(results.perturbation.values)
    torques = np.stack([results.target_torque.values, results.mean_torque.values])
    heights = [1.0] * len(perturbations) + [0.55] * bool(np.isfinite(torques).any())
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
    every = np.moveaxis(mean_stiffness(results).values, 1, 0)
    limits = style.usual_limits(every, truth(results).values)
    columns = [column for block in np.split(grid, blocks) for column in block.T]
    for person, column in zip(people, columns, strict=False):
        column[0].set_title(wrapped(person))
        for number, (axes, perturbation) in enumerate(zip(column, perturbations, strict=False)):
            axes.set_ylim(limits)
            label = recording_of(results, person, perturbation)
            if label is None:
                style.remark(axes, "not recorded")
                continue
            one = results.sel(recording=[label])
            _all_methods(axes, one)
            if len(heights) > len(perturbations):
                column[-1].plot(one.time, one.mean_torque[0], **TORQUES[number % len(TORQUES)])
                column[-1].plot(one.time, one.target_torque[0], **TARGET_LINE)
                column[-1].set_ylim(style.usual_limits((), torques))
        label_time(column[-1], results)
        column[-1].tick_params(labelbottom=True)
    for axes in np.ravel(columns[len(people) :]):
        axes.set_axis_off()
    labels = [f"{_words(each)}\n{LABELS['stiffness']}" for each in perturbations]
    labels = [*labels, "torque\n(N·m)"][: len(heights)] * blocks
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    for axes in grid[:, 1:].flat:
        axes.tick_params(labelleft=False)
    figure.align_ylabels(grid[:, 0])
    style.legend_below(figure, _keys(results, perturbations))
    return figure


def _keys(results: xr.Dataset, perturbations: Sequence[str]) -> list[Artist]:
    least, titles = least_data(results), headings(results, 60)
    looks = style.lines(list(least))
    keys = [style.line_key(titles[least[name]], **look.line) for name, look in looks.items()]
    keys += [style.line_key(**style.TRUE_LINE)] * knows_truth(results)
    if np.isfinite(results.target_torque).any():
        keys.append(style.line_key("torque to be followed", **TARGET_LINE))
    if np.isfinite(results.mean_torque).any():
        keys += [
            style.line_key(f"mean torque, {_words(each)}", **TORQUES[number % len(TORQUES)])
            for number, each in enumerate(perturbations)
        ]
    return keys


def _all_methods(axes: Axes, results: xr.Dataset) -> None:
    """Draw the truth and the mean by every method, of a single recording."""
    methods, time = list(least_data(results)), results.time.values
    axes.plot(time, truth(results)[0], **style.TRUE_LINE)
    mean = mean_stiffness(results).values[0]
    if not np.isfinite(mean).any():
        style.remark(axes, "no estimate")
    for place, (values, look) in enumerate(zip(mean, style.lines(methods).values(), strict=True)):
        curve = look.curve(len(time), place, len(methods)) | {"markersize": 3.0}
        axes.plot(time, values, linewidth=1.0, **curve)


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
    chosen = results.isel(recording=results.participant.values == participant)
    if not chosen.sizes["recording"]:
        raise InputError(
            f"participant_in_detail: there is no participant {participant!r}; there are "
            f"{', '.join(unique(results.participant.values))}"
        )
    several = chosen.sizes["recording"] > 1
    labels = {
        f"{_words(str(perturbation))}\n" if several else "": str(label)
        for label, perturbation in chosen.perturbation.to_series().items()
    }
    return _bands(chosen, labels, ("stiffness", "time_varying_vaf"), title)


@style.styled
def stiffness_with_bands(results: xr.Dataset, recording: str, title: str = "") -> Figure:
    """Draw the stiffness of one recording by every method in a row: mean ± 2 SD over bootstraps.

    A column for each method, as in :func:`participant_in_detail`, 180 mm wide for five of them.
    ``InputError`` if there is no recording of this label.
    """
    there = unique(results.recording.values)
    if recording not in there:
        raise InputError(
            f"stiffness_with_bands: there is no recording {recording!r}; there are "
            f"{', '.join(there)}"
        )
    return _bands(results, {"": recording}, ("stiffness",), title)


def _bands(
    results: xr.Dataset, recordings: Mapping[str, str], names: Sequence[str], title: str
) -> Figure:
    """Return rows of axes by their labels, a column for each method."""
    least, titles = least_data(results), headings(results, 15)
    here = results.sel(recording=list(recordings.values()), analysis=list(least.values()))
    columns, time = len(least), here.time.values
    rows = [(name, words, label) for name in names for words, label in recordings.items()]
    figure, grid = style.panels(
        len(rows),
        columns,
        max(1.25 * columns, 2.6) + 0.84,
        1.35 * len(rows) + 1.1,
        title,
        sharex=True,
        sharey="row",
    )
    # Without a torque to be followed there need be no task, and the mean torque means little.
    torques = here.target_torque.values
    stiffness = estimates(here).transpose("analysis", "bootstrap", "recording", "time").values
    limits = {
        "stiffness": style.usual_limits(stiffness, truth(here).values),
        "time_varying_vaf": (0.0, 102.0),
    }
    for row, (name, words, label) in zip(grid, rows, strict=True):
        one = here.sel(recording=label)
        values = estimates(one) if name == "stiffness" else one.time_varying_vaf
        mean, spread = mean_and_spread(values.transpose("bootstrap", "analysis", "time").values)
        most = 100.0 if name == "time_varying_vaf" else np.inf
        row[0].set_ylabel(f"{words}{LABELS[name]}")
        row[0].set_ylim(limits[name])
        for axes, hue, middle, reach in zip(
            row, style.hues(list(least)).values(), mean, 2 * spread, strict=True
        ):
            if name == "stiffness":
                axes.plot(time, truth(one), **style.TRUE_LINE)
            band = (middle - reach, np.minimum(middle + reach, most))
            style.curve_with_band(axes, time, middle, band, hue)
            if np.isfinite(one.target_torque).any():
                behind = axes.twinx()
                behind.plot(time, one.target_torque, **BEHIND)
                behind.set_ylim(style.usual_limits((), torques))
                behind.set_zorder(axes.get_zorder() - 1)
                axes.patch.set_visible(False)
                behind.grid(visible=False)
                behind.spines["right"].set_visible(True)
                behind.tick_params(labelright=axes is row[-1], colors=style.GREY)
                behind.set_ylabel("torque (N·m)" if axes is row[-1] else "", color=style.GREY)
    for axes, label in zip(grid[0], least.values(), strict=True):
        axes.set_title(titles[label], fontsize=8.5)
    label_time(grid[-1], here)
    figure.align_ylabels(grid[:, 0])
    keys = style.band_keys(here.sizes["bootstrap"], "bootstrap")
    keys += [style.line_key(**style.TRUE_LINE)] * knows_truth(here)
    keys += [style.line_key("torque to be followed", **BEHIND)] * bool(np.isfinite(torques).any())
    style.legend_below(figure, keys)
    return figure


def _words(perturbation: str) -> str:
    return wrapped(perturbation_name(perturbation))
