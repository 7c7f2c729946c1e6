"""Where each switch lies, and how surely: positions between samples, each beside the others."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tvsysid.methods.adaptive.evidence import Columns, Line, Products, Sizes, Smooth, every_sizes, jumps, one_more
from tvsysid.methods.adaptive.search import APART, Found
from tvsysid.numerics import Array

RESOLVED = 1 / 16  # sample: steps between positions that are told apart
NEAR = 6.0  # samples to either side of where a switch was found in which it may lie
SWEEPS = 4  # of all switches, each placed beside the others, at most
CLOSE, SAME = 3.0, 0.26  # samples within which one of two switches may stand for both; two sets are the same


class Placed(NamedTuple):
    """Switches at their most probable ``positions``, with the products of these.

    Each may also lie at other positions: a window of columns and their probability for each, ``log_volume`` being the
    log of what the positions weigh together, in samples.
    """

    positions: Array
    columns: Columns
    windows: tuple[Columns, ...]
    shares: tuple[Array, ...]
    log_volume: float


class Windows:
    """Columns at finely spaced positions about places, made once for each place."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.columns: dict[int, Columns] = {}
        self.products: dict[tuple[int, int], Products] = {}

    def about(self, position: float) -> Columns:
        """Columns about a position."""
        centre = round(position)
        if centre not in self.columns:
            reach = round(NEAR / RESOLVED)
            positions = centre + RESOLVED * np.arange(-reach, reach + 1.0)
            axis = self.line.axis
            if axis.periodic:
                positions = np.mod(positions, axis.times)
            else:
                positions = positions[(positions > 0) & (positions <= axis.times - 1)]
            self.columns[centre] = self.line.columns(positions)
        return self.columns[centre]

    def beside(self, position: float, smooth: Smooth) -> Products:
        """Their products beside a smooth part."""
        key = round(position), id(smooth)
        if key not in self.products:
            self.products[key] = smooth.products(self.about(position))
        return self.products[key]


def joined(parts: list[Columns]) -> Columns:
    """Columns side by side."""
    return Columns(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))


def distance(line: Line, positions: Array, other: float | Array) -> Array:
    """Distances in samples."""
    apart = np.abs(positions - other)
    return np.minimum(apart, line.axis.times - apart) if line.axis.periodic else apart


def best_sizes(smooth: Smooth, columns: Columns) -> tuple[Sizes, float]:
    """Prior of sizes that suits some switches best, and their log evidence."""
    products = smooth.products(columns)
    gram = products.between(products)
    every = every_sizes(smooth.line.axis.periodic)
    evidence = [jumps(gram, products.cross, sizes).evidence for sizes in every]
    best = int(np.argmax(evidence))
    return every[best], evidence[best]


def refined(found: Found, windows: Windows) -> Placed:
    """Switches moved to where they are most probable, each beside the others, until none moves."""
    positions, smooth, line = np.array(found.positions), found.smooth, windows.line
    if not len(positions):
        return Placed(positions, line.columns(positions), (), (), 0.0)
    sizes = best_sizes(smooth, line.columns(positions))[0]
    count, shares = len(positions), [np.zeros(0)] * len(positions)
    about = [windows.about(each) for each in positions]
    volumes = np.zeros(count)
    for _ in range(SWEEPS):
        before = positions.copy()
        for place in range(count):
            others = np.delete(np.arange(count), place)
            beside = smooth.products(line.columns(positions[others])) if count > 1 else None
            window = windows.beside(positions[place], smooth)
            value = _values(window, beside, sizes)
            for other in others:
                value[distance(line, window.columns.positions, positions[other]) < APART] = -np.inf
            best = int(np.argmax(value))
            if not math.isfinite(value[best]):
                continue
            about[place] = window.columns
            positions[place] = window.columns.positions[best]
            share = np.exp(value - value[best])
            volumes[place] = math.log(float(share.sum()) * RESOLVED)
            shares[place] = share / share.sum()
        if np.all(positions == before):
            break
    order = np.argsort(positions)
    columns = line.columns(positions[order])
    return Placed(
        positions[order],
        columns,
        tuple(about[k] for k in order),
        tuple(shares[k] for k in order),
        float(volumes.sum()),
    )


def _values(window: Products, others: Products | None, sizes: Sizes) -> Array:
    """Log evidence for some switches and one more at each position of a window."""
    if others is None:
        none = np.zeros((len(window.cross), 0))
        return one_more(window, np.zeros((0, 0)), np.zeros(0), none, window.diagonal(), sizes)
    gram = others.between(others)
    return one_more(window, gram, others.cross, window.between(others), window.diagonal(), sizes)


def total(placed: Placed, smooth: Smooth) -> float:
    """Log evidence for switches wherever they may lie, and prior."""
    count = len(placed.positions)
    if not count:
        return smooth.score
    times = math.log(smooth.line.axis.times)
    return smooth.score + best_sizes(smooth, placed.columns)[1] + placed.log_volume - count * times


def simplified(placed: Placed, smooth: Smooth, windows: Windows) -> Placed:
    """Without one of two switches that are close, where that is better: on a grid two may stand for one."""
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
