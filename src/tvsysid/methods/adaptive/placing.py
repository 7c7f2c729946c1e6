"""Distributions of the times of switches: positions between samples, each beside the others."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tvsysid.methods.adaptive.evidence import (
    Columns,
    Line,
    Products,
    Sizes,
    Smooth,
    every_sizes,
    jumps_of_every_size,
    one_more,
)
from tvsysid.numerics import Array

RESOLVED = 1 / 16  # samples from one position that is tried to the next
APART = 1.0  # samples that two switches are apart at least
NEAR = 6.0  # samples to either side of where a switch was found in which it may lie
SWEEPS = 4  # of all switches, each placed beside the others, at most
CLOSE, SAME = (
    3.0,
    0.26,
)  # samples within which one of two switches may stand for both; two sets are the same


class Found(NamedTuple):
    """Positions of switches in samples, and the smooth part beside which they were found."""

    positions: Array
    smooth: Smooth


class Placed(NamedTuple):
    """Switches at their most probable ``positions``, with the products of these.

    Each switch may also lie at other positions: it has a window of them and their probabilities.
    ``log_volume`` is the log of the weight of all positions together, in samples.
    """

    positions: Array
    columns: Columns
    windows: tuple[Array, ...]
    shares: tuple[Array, ...]
    log_volume: float


class Window(NamedTuple):
    """Products of steps at finely spaced positions beside a smooth part, and their squares."""

    products: Products
    power: Array


class Windows:
    """Windows of positions about places of switches, calculated once for each place.

    The distance between positions is in samples.
    """

    def __init__(self, line: Line, resolved: float = RESOLVED, near: float = NEAR) -> None:
        self.line, self.resolved, self.near = line, resolved, near
        self.columns: dict[int, Columns] = {}
        self.windows: dict[tuple[int, int], Window] = {}

    def beside(self, position: float, smooth: Smooth) -> Window:
        """Return the window about a position beside a smooth part."""
        centre = round(position)
        key = centre, id(smooth)
        if key not in self.windows:
            if centre not in self.columns:
                self.columns[centre] = self.line.columns(self._about(centre))
            products = smooth.products(self.columns[centre])
            self.windows[key] = Window(products, products.diagonal())
        return self.windows[key]

    def _about(self, centre: int) -> Array:
        reach, axis = round(self.near / self.resolved), self.line.axis
        positions = centre + self.resolved * np.arange(-reach, reach + 1.0)
        if axis.periodic:
            return np.mod(positions, axis.times)
        return positions[(positions > 0) & (positions <= axis.times - 1)]


def joined(parts: list[Columns]) -> Columns:
    """Join columns side by side."""
    return Columns(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))


def together(parts: list[Products]) -> Products:
    """Join products side by side."""
    taken, cross = (
        np.concatenate([getattr(each, name) for each in parts], axis=-1)
        for name in ("taken", "cross")
    )
    return Products(joined([each.columns for each in parts]), taken, cross)


def distance(line: Line, positions: Array, other: float | Array) -> Array:
    """Return distances in samples."""
    apart = np.abs(positions - other)
    return np.minimum(apart, line.axis.times - apart) if line.axis.periodic else apart


def best_sizes(switches: Products, periodic: bool) -> tuple[Sizes, float]:
    """Return the prior of sizes that suits some switches best, and their log evidence."""
    evidence = jumps_of_every_size(switches.between(switches), switches.cross, periodic)
    best = int(np.argmax(evidence))
    return every_sizes(periodic)[best], float(evidence[best])


def refined(found: Found, windows: Windows) -> Placed:
    """Move switches to their most probable positions, each beside the others, until none moves."""
    smooth, line, count = found.smooth, windows.line, len(found.positions)
    own = smooth.products(line.columns(np.array(found.positions)))
    if not count:
        return Placed(found.positions, own.columns, (), (), 0.0)
    sizes = best_sizes(own, line.axis.periodic)[0]
    shares, volumes = [np.ones(1)] * count, np.full(count, math.log(windows.resolved))
    positions = own.columns.positions
    about, tried = list(positions[:, None]), dict[int, tuple[float, ...]]()
    for _ in range(SWEEPS if count > 1 else 1):
        for place in range(count):
            rest = [other for other in range(count) if other != place]
            setting = round(positions[place]), *positions[rest]
            if tried.get(place) == setting:  # nothing has moved since
                continue
            tried[place] = setting
            window = windows.beside(positions[place], smooth)
            value = _values(window, own.take(np.array(rest, dtype=np.intp)), sizes, line)
            best = int(np.argmax(value))
            if not np.isfinite(value[best]):  # others are too close everywhere
                continue
            own = own.put(place, window.products, best)
            positions, about[place] = own.columns.positions, window.products.columns.positions
            share = np.exp(value - value[best])
            volumes[place] = math.log(float(share.sum()) * windows.resolved)
            shares[place] = share / share.sum()
    order = np.argsort(positions)
    columns = own.columns.take(order)
    volume = float(volumes.sum())
    return Placed(
        positions[order],
        columns,
        tuple(about[k] for k in order),
        tuple(shares[k] for k in order),
        volume,
    )


def _values(window: Window, others: Products, sizes: Sizes, line: Line) -> Array:
    """Return the log evidence for switches and one more at each position of a window.

    The additional switch keeps a distance from the others.
    """
    products = window.products
    gram, mixed = others.between(others), products.between(others)
    (value,) = one_more(
        products, gram, others.cross, mixed, window.power, sizes.balanced, (sizes.spread,)
    )
    for position in others.columns.positions:
        near = distance(line, products.columns.positions, position) < APART
        if not near.all():
            value[near] = -np.inf
    return np.asarray(value)


def total(placed: Placed, smooth: Smooth) -> float:
    """Return the log evidence for switches at any position, plus the log prior."""
    count = len(placed.positions)
    if not count:
        return smooth.score
    axis, products = smooth.line.axis, smooth.products(placed.columns)
    return (
        smooth.score
        + best_sizes(products, axis.periodic)[1]
        + placed.log_volume
        - count * math.log(axis.times)
    )


def simplified(placed: Placed, smooth: Smooth, windows: Windows) -> Placed:
    """Remove one of two close switches where that raises the evidence.

    On a grid, two switches may stand for one.
    """
    best, score = placed, total(placed, smooth)
    while len(best.positions) > 1:
        gaps = distance(windows.line, best.positions, np.roll(best.positions, 1))
        tried = [
            refined(Found(np.delete(best.positions, place), smooth), windows)
            for gap in np.flatnonzero(gaps < CLOSE)
            for place in {int(gap), int(gap) - 1 if gap else len(gaps) - 1}
        ]
        scores = [total(each, smooth) for each in tried]
        if not scores or max(scores) <= score:
            break
        best, score = tried[int(np.argmax(scores))], max(scores)
    return best


def add(sets: list[Placed], placed: Placed, line: Line) -> None:
    """Add a set of switches that is not there yet."""
    for other in sets:
        same = len(other.positions) == len(placed.positions)
        if same and np.all(distance(line, other.positions, placed.positions) < SAME):
            return
    sets.append(placed)
