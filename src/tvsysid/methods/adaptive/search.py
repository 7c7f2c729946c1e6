"""Deterministic search for the sets of switches with the greatest evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from heapq import nlargest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.adaptive.evidence import Columns, Line, Products, Sizes, Smooth, one_more
from tvsysid.methods.adaptive.placing import (
    APART,
    Found,
    Windows,
    best_sizes,
    distance,
    refined,
    together,
)
from tvsysid.methods.adaptive.prior import SIZES
from tvsysid.numerics import Array

FINE, COARSE, PAIRS = (
    400,
    200,
    100,
)  # positions that are tried: of one more switch, of the first, of a pair at most
POLISHED, ABOUT = (
    1 / 8,
    1.5,
)  # samples to which positions are polished after each step, and how far they may move
STEPS, MOST = 60, 12  # of the search, and switches at most
GAIN = 50.0  # log evidence that a further switch is taken to bring at most
NEARLY = 5.0  # log evidence below the best down to which a set counts that is no gain
FAINT = 1e-12  # share of all precision below which there is none
PARTED, PARTS = (
    6,
    3,
)  # switches at most of the best sets of each number, and how many of these are polished
REACH = 12.0  # log evidence below the best down to which sets are kept
MOST_SETS = 8  # that are kept
START = Sizes(0.2, False)


class State(NamedTuple):
    """Positions of switches beside a smooth part, their score, and the gain of the last step.

    REACH is added to the gain of the first step, which then counts as 2 REACH at least. A smooth
    part is not searched if further switches had to gain more than that, or GAIN, to make it the
    best. The bound of :func:`first_states` is less sharp, because it includes the noise of all
    samples.
    """

    places: tuple[float, ...]
    score: float
    gain: float = math.inf


class Grid:
    """Positions that are tried, and the distance between two of them."""

    def __init__(self, line: Line) -> None:
        self.line, times = line, line.axis.times
        self.step = max(0.5, times / FINE)
        count = int(times / self.step)
        first = 0 if line.axis.periodic else 1  # a step before the first sample is none
        self.fine = line.columns(np.arange(first, count, dtype=np.float64) * self.step)
        count = len(self.fine.positions)
        apart = -(-count // COARSE)
        further = -(-count // (apart * PAIRS))
        self.coarse, self.pairs = slice(None, None, apart), slice(None, None, apart * further)
        self.coarse_pairs = slice(None, None, further)  # of the coarse ones
        pairs = self.fine.take(self.pairs)
        self.pair_gram = pairs.seen.T @ pairs.weighted
        self.log_positions = math.log(times)
        self.windows = Windows(line, POLISHED, ABOUT * max(1.0, self.step))


def first_states(smooths: tuple[Smooth, ...], grid: Grid) -> list[State]:
    """Return the best of no switch, one switch and two opposite ones beside each smooth part.

    Switches add at most half of the chi-square that a smooth part leaves, less a log prior. If even
    this bound is far below the best score, no switches are searched for.
    """
    columns, best = grid.fine.take(grid.coarse), max(smooth.score for smooth in smooths)
    return [
        _first(smooth, grid, columns)
        if smooth.score + smooth.left / 2 - grid.log_positions > best - REACH
        else State((), smooth.score, -math.inf)
        for smooth in smooths
    ]


def _first(smooth: Smooth, grid: Grid, columns: Columns) -> State:
    products = smooth.products(columns)
    variance = START.spread**2
    power = 1 + variance * products.diagonal()
    single = 0.5 * (variance * products.cross**2 / power - np.log(power)) - grid.log_positions
    pair_value, pair = _pair(products.take(grid.coarse_pairs), grid)
    best, ends = int(np.argmax(single)), columns.positions[grid.coarse_pairs]
    options = [(0.0, ()), (float(single[best]), (float(columns.positions[best]),))]
    options.append((pair_value - 2 * grid.log_positions, tuple(float(ends[k]) for k in pair)))
    value, places = max(options)
    return State(places, smooth.score + value, max(value, REACH) + REACH)


def _pair(products: Products, grid: Grid) -> tuple[float, tuple[int, int]]:
    """Return the log evidence for the best pair of opposite switches."""
    gram = grid.pair_gram - products.taken.T @ products.taken
    power, variance = np.diag(gram), START.spread**2
    square = 1 + variance * np.maximum((power[:, None] + power) / 2 - gram, 0.0)
    value = variance / 4 * (products.cross[:, None] - products.cross) ** 2 / square
    best = int(np.argmax(value))  # a logarithm that is positive is still to be subtracted
    able = np.flatnonzero(value >= value.flat[best] - 0.5 * math.log(square.flat[best]))
    values = value.flat[able] - 0.5 * np.log(square.flat[able])
    best = int(np.argmax(values))
    first, second = sorted(divmod(int(able[best]), len(value)))
    return float(values[best]), (first, second)


class Walk:
    """Sets of switches beside one smooth part, each a step from the one before."""

    def __init__(self, smooth: Smooth, grid: Grid) -> None:
        self.smooth, self.grid = smooth, grid
        self.products = smooth.products(grid.fine)
        self.power = self.products.diagonal()
        self.known: dict[float, tuple[Products, Array]] = {}

    def at(self, places: tuple[float, ...]) -> tuple[Products, Array]:
        """Return steps at places, and their products with those on the grid, (position, step)."""
        for place in places:
            if place not in self.known:
                step = self.smooth.products(self.grid.line.columns(np.array([place])))
                self.known[place] = step, self.products.between(step)
        if not places:
            return self.products.take(np.zeros(0, dtype=np.intp)), np.zeros((len(self.power), 0))
        steps, mixed = zip(*(self.known[place] for place in places), strict=True)
        return together(list(steps)), np.concatenate(mixed, axis=1)

    def score(self, places: tuple[float, ...]) -> float:
        """Return the score of a set."""
        if not places:
            return self.smooth.score
        steps = self.at(places)[0]
        best = best_sizes(steps, self.grid.line.axis.periodic)[1]
        return self.smooth.score + best - len(places) * self.grid.log_positions

    def scan(self, places: tuple[float, ...]) -> tuple[float, float]:
        """Return the best score of a set and one more switch, and the place of that switch."""
        steps, mixed = self.at(places)
        gram, kinds = (
            steps.between(steps),
            (False, True) if self.grid.line.axis.periodic else (False,),
        )
        found = [
            one_more(self.products, gram, steps.cross, mixed, self.power, each, SIZES)
            for each in kinds
        ]
        best, positions = np.max(found, axis=(0, 1)), self.grid.fine.positions
        for place in places:
            best[distance(self.grid.line, positions, place) < APART] = -np.inf
        top = int(np.argmax(best))
        score = self.smooth.score + float(best[top]) - (len(places) + 1) * self.grid.log_positions
        return score, float(positions[top])

    def polished(self, places: tuple[float, ...]) -> tuple[float, ...]:
        """Move the switches to positions between those of the grid.

        This may raise the score more than another switch.
        """
        placed = refined(Found(np.array(places), self.smooth), self.grid.windows)
        return tuple(float(each) for each in placed.positions)

    def best_step(self, state: State) -> State:
        """Return the best of one switch less, one elsewhere or for two neighbours, or one more."""
        places, count = state.places, len(state.places)
        fewer = [places[:j] + places[j + 1 :] for j in range(count)]
        options = [(self.score(each), each) for each in fewer]
        bases = [*fewer, *(fewer[j][:j] + fewer[j][j + 1 :] for j in range(count - 1))]
        if self.grid.line.axis.periodic and count > 2:
            bases.append(places[1:-1])
        for each in [*bases, *([places] if count < MOST else [])]:
            score, place = self.scan(each)
            options.append((score, tuple(sorted((*each, place)))))
        found = self.polished(max(options)[1])
        score = self.score(found)
        return State(found, score, score - state.score)

    def at_once(self, places: tuple[float, ...]) -> Iterator[State]:
        """Yield the best of all :func:`partitions` after :meth:`polished`.

        Their scores on the grid only say which of them to polish.
        """
        parts = dict.fromkeys(partitions(self.grid.line, places))
        for each in map(self.polished, nlargest(PARTS, parts, key=self.score)):
            yield State(each, self.score(each))


def partitions(line: Line, places: tuple[float, ...]) -> Iterator[tuple[float, ...]]:
    """Yield the best set of each number of switches, as if the noise were white.

    Dynamic programming finds the levels between them (Bellman 1961).

    A step-by-step search would miss several switches of which none alone is worth much. On a
    periodic axis, the cycle is cut at the first of the ``places``, with or without a switch there.
    """
    times, periodic = line.axis.times, line.axis.periodic
    cut = round(places[0]) % times if periodic and places else 0
    weights = np.roll(np.diag(line.precision), -cut)
    edges = np.append(np.arange(0, times, -(-times // COARSE)), times)
    sums = [
        np.append(0.0, np.cumsum(each))[edges]
        for each in (weights, weights * np.roll(line.seen, -cut))
    ]
    power, cross = (
        np.subtract.outer(each, each) for each in sums
    )  # of all between an edge and one before
    before = np.tri(len(edges), k=-1, dtype=bool)
    gains = np.where(before, cross**2 / np.maximum(power, FAINT * power.max()), -np.inf)
    best, chosen = gains[:, 0], list[NDArray[np.intp]]()
    for count in range(1, min(PARTED, len(edges) - 2) + 1):
        whole = best + gains
        chosen.append(np.argmax(whole, axis=1))
        best = np.take_along_axis(whole, chosen[-1][:, None], axis=1)[:, 0]
        switches, last = list[float](), len(edges) - 1
        for each in reversed(chosen):
            last = each[last]
            switches.append(float((edges[last] + cut) % times))
        yield tuple(sorted(switches))
        if periodic and count < PARTED:
            yield tuple(sorted([*switches, float(cut)]))


def found_sets(grid: Grid, smooths: tuple[Smooth, ...], states: list[State]) -> list[Found]:
    """Return sets of switches near the best score, best first, and the empty one."""
    scores: dict[tuple[float, ...], tuple[float, int]] = {}

    def note(state: State, key: int) -> None:
        scores[state.places] = max(scores.get(state.places, (-np.inf, key)), (state.score, key))

    for key, state in enumerate(states):
        note(state, key)
    walks: dict[int, Walk] = {}
    open_ones, closed_at = dict(enumerate(states)), set()
    for _ in range(STEPS):
        best = max(scores.values())[0]
        able = {
            key: state
            for key, state in open_ones.items()
            if state.score + min(state.gain, GAIN) > best
            and (key in walks or state.places not in closed_at)
        }
        if not able:
            break
        key = max(able, key=lambda each: able[each].score)
        if key not in walks:
            walk = walks[key] = Walk(smooths[key], grid)
            if open_ones[key].places:
                places = walk.polished(open_ones[key].places)
                open_ones[key] = State(places, walk.score(places), open_ones[key].gain)
                note(open_ones[key], key)
        after = walks[key].best_step(open_ones[key])
        if after.score > best - NEARLY:
            note(after, key)
        if after.gain <= 1e-6:
            closed_at.add(open_ones.pop(key).places)
            del walks[key]  # its products are as large as the grid's
            continue
        open_ones[key] = after
    walk, best = walks.get(0) or Walk(smooths[0], grid), max(scores.values())[0]
    walks.clear()  # one is enough from here on
    for state in walk.at_once(states[0].places):
        if state.score > best - NEARLY:
            note(state, 0)
    scores.pop((), None)
    best = max([score for score, _ in scores.values()] + [max(smooth.score for smooth in smooths)])
    near = sorted(
        ((score, key, places) for places, (score, key) in scores.items() if score > best - REACH),
        reverse=True,
    )
    sets = [Found(np.array(places), smooths[key]) for _, key, places in near]
    return [*sets[:MOST_SETS], Found(np.zeros(0), max(smooths, key=lambda smooth: smooth.score))]
