"""Stiffness of people over time, like figures 8 and 9 of van de Ruit et al. 2021."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.figures.analyses import (
    headings,
    least_data,
    one_period,
    recording_of,
    unique,
    usual_range,
)
from tvsysid.figures.style import TARGET, TRUTH, Style, legend_below, lines, plain
from tvsysid.figures.words import told, wrapped
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ABREAST = 6
"""Participants side by side; further ones begin a new line."""
TORQUES: tuple[tuple[str, float, Style], ...] = (
    ("#C4C4C4", 2.8, "-"),
    ("#707070", 1.3, "--"),
    ("#909090", 1.6, ":"),
    ("#505050", 0.9, "-."),
)
"""Colour, width and style of the mean torque under each perturbation, such that lines on top of each other show."""
SMALL = 7.5
"""Points of the small print."""


def stiffness_of_participants(results: xr.Dataset, title: str = "") -> Figure:
    """Mean stiffness over bootstraps of every participant, a line for each method, above the torque.

    Parameters
    ----------
    results
        Of an experiment: ``stiffness`` over (recording, analysis, bootstrap, time), and ``true_stiffness``,
        ``target_torque`` and ``mean_torque`` over (recording, time), NaN where not known. Each method is shown with
        the fewest realizations that it was given.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each participant, six of them abreast; a row for each perturbation, and one for the torque if it
        is known. Vertical scales are common.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    participants, perturbations = unique(results.participant.values), unique(results.perturbation.values)
    blocks = [participants[first : first + ABREAST] for first in range(0, len(participants), ABREAST)]
    mean = _means(results)
    torques = np.stack([results.target_torque.values, results.mean_torque.values])
    with_torque = bool(np.isfinite(torques).any())
    rows = len(perturbations) + with_torque
    wide, heights = len(blocks[0]), [1.0] * len(perturbations) + [0.55] * with_torque
    figure = Figure(
        figsize=(max(1.5 * wide, 3.6) + 0.9, 1.45 * sum(heights) * len(blocks) + 0.35 * len(blocks) + 0.8),
        layout="constrained",
    )
    grid = figure.subplots(rows * len(blocks), wide, sharex=True, squeeze=False, height_ratios=heights * len(blocks))
    limits = usual_range(np.moveaxis(mean.values, 1, 0), results.true_stiffness.values)
    torque_limits = usual_range(torques[:0], torques)
    for number, block in enumerate(blocks):
        part = grid[rows * number : rows * (number + 1)]
        for column, axes_of_one in enumerate(part.T):
            if column >= len(block):
                for axes in axes_of_one:
                    axes.set_axis_off()
                continue
            axes_of_one[0].set_title(wrapped(block[column]), fontsize=9)
            for axes, perturbation in zip(axes_of_one, perturbations, strict=False):
                label = recording_of(results, block[column], perturbation)
                _all_methods(axes, results, mean, label)
                axes.set_ylim(limits)
            if with_torque:
                _torques(axes_of_one[-1], results, block[column], perturbations)
                axes_of_one[-1].set_ylim(torque_limits)
            axes_of_one[-1].set_xlabel("time (s)", fontsize=SMALL)
            axes_of_one[-1].tick_params(labelbottom=True)
            for axes in axes_of_one:
                plain(axes).tick_params(labelsize=SMALL, labelleft=column == 0)
                one_period(axes, results)
        for axes, perturbation in zip(part[:, 0], perturbations, strict=False):
            axes.set_ylabel(f"{_words(perturbation)}\nstiffness\n(N·m/rad)", fontsize=SMALL)
        if with_torque:
            part[-1, 0].set_ylabel("torque\n(N·m)", fontsize=SMALL)
    figure.align_ylabels(grid[:, 0])
    _legend_of_methods(figure, results, perturbations, torques)
    figure.suptitle(title, fontsize=10)
    return figure


def participant_in_detail(results: xr.Dataset, participant: str, title: str = "") -> Figure:
    """Stiffness and time-varying VAF of one participant: mean ± 2 standard deviations over bootstraps.

    Parameters
    ----------
    results
        As of :func:`stiffness_of_participants`, with ``time_varying_vaf``.
    participant
        Whose recordings are shown.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each method, with the fewest realizations that it was given; a row for each perturbation with the
        stiffness, and one with the VAF. A grey line is the torque to be followed, with its scale on the right.

    Raises
    ------
    InputError
        If there is no such participant.
    """
    perturbations = unique(results.perturbation.values[results.participant.values == participant])
    if not perturbations:
        raise InputError(
            f"participant_in_detail: there is no participant {participant!r}; "
            f"there are {', '.join(unique(results.participant.values))}"
        )
    labels = {
        (_words(perturbation) if len(perturbations) > 1 else ""): recording_of(results, participant, perturbation)
        for perturbation in perturbations
    }
    return _bands(results, {words: label for words, label in labels.items() if label is not None}, True, title)


def stiffness_with_bands(results: xr.Dataset, recording: str, title: str = "") -> Figure:
    """Stiffness of one recording by every method, in one row: mean ± 2 standard deviations over bootstraps.

    Parameters
    ----------
    results
        As of :func:`stiffness_of_participants`.
    recording
        Its label.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each method, as in :func:`participant_in_detail`, 180 mm wide for five of them.

    Raises
    ------
    InputError
        If there is no such recording.
    """
    there = unique(results.recording.values)
    if recording not in there:
        raise InputError(f"stiffness_with_bands: there is no recording {recording!r}; there are {', '.join(there)}")
    return _bands(results, {"": recording}, False, title)


def _bands(results: xr.Dataset, recordings: dict[str, str], with_vaf: bool, title: str) -> Figure:
    """Rows of axes by what is written beside them, a column for each method."""
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    least, titles = least_data(results), headings(results, 15)
    here = results.sel(recording=list(recordings.values()), analysis=list(least.values()))
    hues = {method: hue for method, (hue, _) in lines(list(least)).items()}
    rows = [("stiffness", "stiffness\n(N·m/rad)")] + [("time_varying_vaf", "time-varying VAF\n(%)")] * with_vaf
    count = len(rows) * len(recordings)
    figure = Figure(figsize=(max(1.25 * len(least), 2.6) + 0.84, 1.35 * count + 1.1), layout="constrained")
    grid = figure.subplots(count, len(least), sharex=True, sharey="row", squeeze=False)
    moments = {name: mean_and_spread(np.moveaxis(here[name].values, 2, 0)) for name, _ in rows}
    mean, spread = moments["stiffness"]
    bands = np.stack([mean - 2 * spread, mean + 2 * spread], axis=1)
    limits = usual_range(np.moveaxis(bands, 2, 0), here.true_stiffness.values)
    # Without a torque to be followed there need be no task, and the mean torque tells little.
    torque_limits = usual_range(np.zeros((0, 1)), here.target_torque.values)
    places = [(name, words, each) for name, words in rows for each in recordings]
    for row, (name, words, each) in zip(grid, places, strict=True):
        place = list(recordings).index(each)
        torque = here.target_torque.values[place]
        for column, (axes, method) in enumerate(zip(row, least, strict=True)):
            plain(axes).tick_params(labelsize=SMALL)
            if np.isfinite(torque).any():
                _behind(axes, here.time.values, torque, torque_limits, column == len(least) - 1)
            truth = here.true_stiffness.values[place]
            if name == "stiffness" and np.isfinite(truth).any():
                axes.plot(here.time.values, truth, color=TRUTH, linewidth=1.0, linestyle="--", label="truth", zorder=3)
            middle, around = (each[place, column] for each in moments[name])
            _band(axes, here.time.values, middle, around, hues[method], name)
            axes.set_ylim(limits if name == "stiffness" else (0, 102))
            one_period(axes, here)
        row[0].set_ylabel(f"{each}\n{words}" if each else words, fontsize=SMALL)
    for axes, label in zip(grid[0], least.values(), strict=True):
        axes.set_title(titles[label], fontsize=8.5)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)", fontsize=SMALL)
    figure.align_ylabels(grid[:, 0])
    _legend_of_bands(figure, here)
    figure.suptitle(title, fontsize=10)
    return figure


def _means(results: xr.Dataset) -> xr.DataArray:
    """Mean stiffness over bootstraps of each method's smallest analysis, over (recording, analysis, time)."""
    here = results.stiffness.sel(analysis=list(least_data(results).values()))
    mean, _ = mean_and_spread(here.transpose("bootstrap", "recording", "analysis", "time").values)
    shape: xr.DataArray = here.isel(bootstrap=0, drop=True).transpose("recording", "analysis", "time")
    return shape.copy(data=mean)


def _all_methods(axes: Axes, results: xr.Dataset, mean: xr.DataArray, label: str | None) -> None:
    """Truth and every method's mean in one axes, or that there is nothing."""
    if label is None:
        _nothing(axes, "not recorded")
        return
    here, truth = mean.sel(recording=label), results.true_stiffness.sel(recording=label).values
    if np.isfinite(truth).any():
        axes.plot(results.time.values, truth, color="#BBBBBB", linewidth=3.5, label="truth")
    if not np.isfinite(here.values).any():
        _nothing(axes, "no estimate")
        return
    for (method, analysis), (hue, style) in zip(
        (least := least_data(results)).items(), lines(list(least)).values(), strict=True
    ):
        values = here.sel(analysis=analysis).values
        if np.isfinite(values).any():
            axes.plot(results.time.values, values, color=hue, linestyle=style, linewidth=1.1, label=method)


def _torques(axes: Axes, results: xr.Dataset, participant: str, perturbations: Sequence[str]) -> None:
    """Torque to be followed, and what came under each perturbation."""
    targets = []
    for (hue, width, style), perturbation in zip(cycle(TORQUES), perturbations, strict=False):
        label = recording_of(results, participant, perturbation)
        if label is None:
            continue
        here = results.sel(recording=label)
        target, mean = here.target_torque.values, here.mean_torque.values
        if np.isfinite(target).any():
            targets.append(target)
        if np.isfinite(mean).any():
            axes.plot(results.time.values, mean, color=hue, linewidth=width, linestyle=style, label=label)
    for target in targets:
        axes.plot(results.time.values, target, color=TARGET, linewidth=0.8, label="target")


def _words(perturbation: str) -> str:
    return wrapped(told(perturbation))


def _nothing(axes: Axes, why: str) -> None:
    axes.text(0.5, 0.96, why, transform=axes.transAxes, ha="center", va="top", fontsize=SMALL)


def _behind(axes: Axes, time: Array, torque: Array, limits: tuple[float, float], scale: bool) -> None:
    """Draw a torque as a grey line behind what the axes show, with its scale on the right if asked for."""
    other = axes.twinx()
    other.plot(time, torque, color="#C0C0C0", linewidth=1.3, label="torque")
    other.set_ylim(limits)
    other.spines[["top", "left"]].set_visible(False)
    other.spines["right"].set_visible(scale)
    other.tick_params(labelright=scale, right=scale, labelsize=SMALL, labelcolor="#666666", color="#BBBBBB")
    if scale:
        other.set_ylabel("torque (N·m)", fontsize=SMALL, color="#666666")
    axes.set_zorder(other.get_zorder() + 1)
    axes.patch.set_visible(False)


def _band(axes: Axes, time: Array, mean: Array, spread: Array, hue: str, name: str) -> None:
    """Mean, and twice the standard deviation on either side, within what a VAF can be."""
    if not np.isfinite(mean).any():
        _nothing(axes, "no estimate")
        return
    low, high = mean - 2 * spread, mean + 2 * spread
    if name == "time_varying_vaf":
        low, high = np.maximum(low, 0.0), np.minimum(high, 100.0)
    if np.isfinite(spread).any() and np.nanmax(spread) > 0:
        axes.fill_between(time, low, high, color=hue, alpha=0.28, linewidth=0, label="spread")
    axes.plot(time, mean, color=hue, linewidth=1.4 if name == "stiffness" else 0.9, label="mean")


def _legend_of_methods(figure: Figure, results: xr.Dataset, perturbations: Sequence[str], torques: Array) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415  # heavy

    least, labels = least_data(results), headings(results, 60)
    handles = [
        Line2D([], [], color=hue, linestyle=style, linewidth=1.6, label=labels[least[method]])
        for method, (hue, style) in lines(list(least)).items()
    ]
    if np.isfinite(results.true_stiffness.values).any():
        handles.append(Line2D([], [], color="#BBBBBB", linewidth=3.5, label="truth"))
    if np.isfinite(torques[0]).any():
        handles.append(Line2D([], [], color=TARGET, linewidth=0.8, label="torque to be followed"))
    if np.isfinite(torques[1]).any():
        handles += [
            Line2D([], [], color=hue, linewidth=width, linestyle=style, label=f"mean torque, {_words(each)}")
            for (hue, width, style), each in zip(cycle(TORQUES), perturbations, strict=False)
        ]
    legend_below(figure, handles)


def _legend_of_bands(figure: Figure, here: xr.Dataset) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415  # heavy
    from matplotlib.patches import Patch  # noqa: PLC0415  # heavy

    grey, several = "#777777", here.sizes["bootstrap"] > 1
    handles: list[Any] = [Line2D([], [], color=grey, label="mean over bootstraps" if several else "the only bootstrap")]
    if several:
        handles.append(Patch(color=grey, alpha=0.35, linewidth=0, label="± 2 standard deviations"))
    if np.isfinite(here.true_stiffness.values).any():
        handles.append(Line2D([], [], color=TRUTH, linewidth=1.0, linestyle="--", label="truth"))
    if np.isfinite(here.target_torque.values).any():
        handles.append(Line2D([], [], color="#C0C0C0", linewidth=1.3, label="torque to be followed"))
    legend_below(figure, handles)
