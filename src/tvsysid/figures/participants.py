"""Stiffness of people over time: of all of them, and of one in detail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
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
    usual_range,
)
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ABREAST = 6  # participants side by side; further ones begin a new line
BEHIND: dict[str, Any] = {"color": "#C0C0C0", "linewidth": 1.3}
TARGET_LINE: dict[str, Any] = {"color": style.TARGET, "linewidth": 0.8}
TORQUES: tuple[tuple[str, float, style.Style], ...] = (
    ("#B98345", 2.8, "-"),
    ("#5C3A12", 1.3, "--"),
    ("#8A5A24", 1.6, ":"),
    ("#3B2408", 0.9, "-."),
)
"""Colour, width and style of the mean torque by perturbation; overlapping lines all show."""


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
    participants, perturbations = (
        unique(results.participant.values),
        unique(results.perturbation.values),
    )
    blocks = [
        participants[first : first + ABREAST] for first in range(0, len(participants), ABREAST)
    ]
    mean = mean_stiffness(results)
    torques = np.stack([results.target_torque.values, results.mean_torque.values])
    heights = [1.0] * len(perturbations) + [0.55] * bool(np.isfinite(torques).any())
    rows, wide = len(heights), len(blocks[0])
    figure, grid = style.panels(
        rows * len(blocks),
        wide,
        max(1.5 * wide, 3.6) + 0.9,
        (1.45 * sum(heights) + 0.35) * len(blocks) + 0.8,
        title,
        sharex=True,
        height_ratios=heights * len(blocks),
    )
    limits = usual_range(np.moveaxis(mean.values, 1, 0), truth(results).values)
    torque_limits = usual_range(torques[:0], torques)
    for number, block in enumerate(blocks):
        part = grid[rows * number : rows * (number + 1)]
        for column, (person, column_axes) in enumerate(zip(block, part.T, strict=False)):
            column_axes[0].set_title(wrapped(person))
            for axes, perturbation in zip(column_axes, perturbations, strict=False):
                _all_methods(axes, results, mean, recording_of(results, person, perturbation))
                axes.set_ylim(limits)
            if rows > len(perturbations):
                _torques(column_axes[-1], results, person, perturbations)
                column_axes[-1].set_ylim(torque_limits)
            label_time(column_axes[-1], results)
            column_axes[-1].tick_params(labelbottom=True)
            for axes in column_axes:
                axes.tick_params(labelleft=column == 0)
        for axes in part[:, len(block) :].flat:
            axes.set_axis_off()
        for axes, perturbation in zip(part[:, 0], perturbations, strict=False):
            axes.set_ylabel(f"{_words(perturbation)}\nstiffness\n(N·m/rad)")
        if rows > len(perturbations):
            part[-1, 0].set_ylabel("torque\n(N·m)")
    figure.align_ylabels(grid[:, 0])
    style.legend_below(figure, _keys(results, perturbations, torques))
    return figure


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
    perturbations = unique(chosen.perturbation.values)
    if not perturbations:
        raise InputError(
            f"participant_in_detail: there is no participant {participant!r}; there are "
            f"{', '.join(unique(results.participant.values))}"
        )
    labels = {
        (_words(perturbation) if len(perturbations) > 1 else ""): str(
            recording_of(results, participant, perturbation)
        )
        for perturbation in perturbations
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


LABELS = {"stiffness": "stiffness\n(N·m/rad)", "time_varying_vaf": "time-varying VAF\n(%)"}


def _bands(
    results: xr.Dataset, recordings: Mapping[str, str], names: Sequence[str], title: str
) -> Figure:
    """Return rows of axes by their labels, a column for each method."""
    least, titles = least_data(results), headings(results, 15)
    here = results.sel(recording=list(recordings.values()), analysis=list(least.values()))
    rows, columns = len(names) * len(recordings), len(least)
    figure, grid = style.panels(
        rows,
        columns,
        max(1.25 * columns, 2.6) + 0.84,
        1.35 * rows + 1.1,
        title,
        sharex=True,
        sharey="row",
    )
    values = {"stiffness": estimates(here), "time_varying_vaf": here.time_varying_vaf}
    # Without a torque to be followed there need be no task, and the mean torque means little.
    torques, time = here.target_torque.values, here.time.values
    torque_limits = usual_range(np.zeros((0, 1)), torques)
    for block, name in enumerate(names):
        each = values[name].transpose("bootstrap", "recording", "analysis", "time").values
        mean, spread = mean_and_spread(each)
        band = np.stack([mean - 2 * spread, mean + 2 * spread])
        if name == "stiffness":
            limits = usual_range(np.moveaxis(band, 2, 0), truth(here).values)
        else:
            band, limits = np.clip(band, 0.0, 100.0), (0.0, 102.0)
        for place, words in enumerate(recordings):
            row, true = grid[block * len(recordings) + place], truth(here).values[place]
            row[0].set_ylabel(f"{words}\n{LABELS[name]}".strip())
            row[0].set_ylim(limits)
            for column, (axes, hue) in enumerate(
                zip(row, style.hues(list(least)).values(), strict=True)
            ):
                if name == "stiffness" and np.isfinite(true).any():
                    axes.plot(time, true, **style.TRUE_LINE)
                reached = spread[place, column]
                shade = (
                    list(band[:, place, column])
                    if np.isfinite(reached).any() and np.nanmax(reached) > 0
                    else None
                )
                width = 1.4 if name == "stiffness" else 0.9
                style.curve_with_band(
                    axes, time, mean[place, column], shade, hue, linewidth=width, label="mean"
                )
            if np.isfinite(torques[place]).any():
                _behind(row, time, torques[place], torque_limits)
    for axes, label in zip(grid[0], least.values(), strict=True):
        axes.set_title(titles[label], fontsize=8.5)
    label_time(grid[-1], here)
    figure.align_ylabels(grid[:, 0])
    keys = style.band_keys(here.sizes["bootstrap"], "bootstrap")
    keys += [style.line_key(**style.TRUE_LINE)] * knows_truth(here)
    keys += [style.line_key("torque to be followed", **BEHIND)] * bool(np.isfinite(torques).any())
    style.legend_below(figure, keys)
    return figure


def _behind(row: Sequence[Axes], time: Array, torque: Array, limits: tuple[float, float]) -> None:
    """Draw a torque as a grey line behind the axes of a row, with its scale on the right."""
    from matplotlib.transforms import Affine2D  # noqa: PLC0415  # heavy

    low, high = row[0].get_ylim()
    stretch = (high - low) / (limits[1] - limits[0])
    to_values = Affine2D().scale(1.0, stretch).translate(0.0, low - limits[0] * stretch)
    for axes in row:
        axes.plot(
            time, torque, transform=to_values + axes.transData, zorder=0.8, label="torque", **BEHIND
        )
    scale = row[-1].twinx()
    scale.set_ylim(limits)
    scale.set_ylabel("torque (N·m)", color="#666666")
    scale.grid(visible=False)
    scale.spines["right"].set_visible(True)
    scale.tick_params(labelcolor="#666666", color="#BBBBBB")


def _all_methods(axes: Axes, results: xr.Dataset, mean: xr.DataArray, label: str | None) -> None:
    """Draw the truth and every method's mean in one axes, or a note that there is none."""
    if label is None:
        style.remark(axes, "not recorded")
        return
    here, true = mean.sel(recording=label), truth(results).sel(recording=label).values
    if np.isfinite(true).any():
        axes.plot(results.time.values, true, **style.TRUE_LINE)
    if not np.isfinite(here.values).any():
        style.remark(axes, "no estimate")
        return
    least = least_data(results)
    for place, (values, (method, look)) in enumerate(
        zip(here.values, style.lines(list(least)).items(), strict=True)
    ):
        if np.isfinite(values).any():
            curve = look.curve(len(values), place, len(least)) | {"markersize": 3.0}
            axes.plot(results.time.values, values, linewidth=1.0, label=method, **curve)


def _torques(
    axes: Axes, results: xr.Dataset, participant: str, perturbations: Sequence[str]
) -> None:
    """Draw the target torque and the mean torque under each perturbation."""
    for (hue, width, dash), perturbation in zip(cycle(TORQUES), perturbations, strict=False):
        label = recording_of(results, participant, perturbation)
        if label is None:
            continue
        target, mean = (
            results[name].sel(recording=label).values for name in ("target_torque", "mean_torque")
        )
        if np.isfinite(mean).any():
            axes.plot(
                results.time.values, mean, color=hue, linewidth=width, linestyle=dash, label=label
            )
        if np.isfinite(target).any():
            axes.plot(results.time.values, target, zorder=2.5, label="target", **TARGET_LINE)


def _words(perturbation: str) -> str:
    return wrapped(perturbation_name(perturbation))


def _keys(results: xr.Dataset, perturbations: Sequence[str], torques: Array) -> list[Artist]:
    least, labels = least_data(results), headings(results, 60)
    keys = [
        style.line_key(labels[least[method]], **look.line)
        for method, look in style.lines(list(least)).items()
    ]
    if knows_truth(results):
        keys.append(style.line_key(**style.TRUE_LINE))
    if np.isfinite(torques[0]).any():
        keys.append(style.line_key("torque to be followed", **TARGET_LINE))
    if np.isfinite(torques[1]).any():
        for (hue, width, dash), each in zip(cycle(TORQUES), perturbations, strict=False):
            keys.append(
                style.line_key(
                    f"mean torque, {_words(each)}", color=hue, linewidth=width, linestyle=dash
                )
            )
    return keys
