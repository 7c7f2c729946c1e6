"""Search for the sets of switches with the greatest evidence; it is deterministic."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from heapq import nlargest
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from tvsysid.methods.adaptive.evidence import FreeEstimate, SmoothFit, Steps
from tvsysid.numerics import Array

# positions that are tried at most
MAX_POSITIONS = 400  # of one more switch
MAX_FIRST = 200  # of the first switch
MAX_PAIRED = 100  # of each of the first two switches
FIRST_SIZE = 0.2  # standard deviation of the first one or two switches, in mean sizes
MAX_STEPS = 60  # of the search
MAX_SWITCHES = 12
MIN_GAIN = 1e-6  # log evidence of a step below which the search beside a smooth part ends
MAX_GAIN = 50.0  # log evidence that a further switch is expected to bring at most
SLACK = 5.0  # log evidence below the best down to which a set without gain counts
MAX_JOINT, MAX_REFINED = 6, 3  # switches of a joint update, and sets of these that are refined
NEGLIGIBLE = 1e-12  # share of all precision
REACH = 12.0  # log evidence below the best down to which sets are kept
MAX_SETS = 8  # that are kept
SEARCHED, PLACED = 1 / 8, 1 / 16  # samples between positions, in the search and at last
SEARCH_REACH, REFINE_REACH = 1.5, 6.0  # samples to either side in which a switch may move
CLOSE = 3.0  # samples within which one of two switches may represent both
BY_SCORE = attrgetter("score")
SWEEPS = 4  # of all switches, each placed beside the others, at most


class Windows:
    """Steps at finely spaced positions around samples, calculated once for each sample.

    ``spacing`` and ``reach`` are in samples.
    """

    def __init__(
        self, estimate: FreeEstimate, spacing: float = PLACED, reach: float = REFINE_REACH
    ) -> None:
        axis, count = estimate.axis, round(reach / spacing)

        @cache
        def steps(centre: int) -> Steps:
            positions = centre + spacing * np.arange(-count, count + 1.0)
            if axis.periodic:
                return estimate.steps(np.mod(positions, axis.times))
            return estimate.steps(positions[(positions > 0) & (positions <= axis.times - 1)])

        @cache
        def beside(centre: int, smooth: SmoothFit) -> Steps:
            return smooth.beside(steps(centre))

        self.spacing, self.around = spacing, beside


class Switches(NamedTuple):
    """Switches at ``positions`` beside a smooth part, and their ``score``.

    Each may also lie at other positions: ``places`` are these, and their probabilities.
    ``log_volume`` is the log of the weight of all positions together, in samples. ``gain`` is what
    the last step of the search added to the score.
    """

    positions: Array
    smooth: SmoothFit
    score: float = -math.inf
    gain: float = math.inf
    places: Sequence[tuple[Array, Array]] = ()
    log_volume: float = 0.0

    @property
    def total(self) -> float:
        """Score of the switches at any position."""
        return self.score + self.log_volume

    def refined(self, windows: Windows) -> Switches:
        """Move switches to their most probable positions, each beside the others, in turn."""
        smooth, count = self.smooth, len(self.positions)
        axis, own = smooth.estimate.axis, smooth.steps(self.positions)
        prior = int(own.log_evidence(axis.periodic).argmax())
        places = [(each, np.ones(1)) for each in own.positions[:, None]]
        for _ in range(SWEEPS if count > 1 else count):
            before = own.positions
            for _ in range(count):  # the first switch is moved, and becomes the last
                others = own.take(slice(1, None))
                window = windows.around(round(own.positions[0]), smooth)
                value = others.log_evidence_with(window, axis)[prior]
                best = int(np.argmax(value))
                moved, place = own.take(slice(1)), places.pop(0)
                if np.isfinite(value[best]):
                    moved = window.take(slice(best, best + 1))
                    place = window.positions, softmax(value)
                own, places = others.joined(moved), [*places, place]
            if np.array_equal(own.positions, before):
                break
        order = np.argsort(own.positions)
        # The sum of all weights is that of the best position over its probability.
        volumes = [windows.spacing / probabilities.max() for _, probabilities in places]
        return self._replace(
            positions=own.positions[order],
            score=smooth.score_of(own),
            places=[places[place] for place in order],
            log_volume=sum(map(math.log, volumes)),
        )

    def without_doubles(self, windows: Windows) -> Switches:
        """Remove one of two close switches where that raises the evidence.

        On the grid of the search, two switches may represent one.
        """
        own, axis = self.positions, self.smooth.estimate.axis
        is_close = np.abs(axis.offset(own, np.roll(own, 1))) < CLOSE
        tried = [
            self._replace(positions=np.delete(own, place)).refined(windows)
            for later in np.flatnonzero(is_close & (len(own) > 1))
            for place in (later, later - 1)
        ]
        best = max(tried, key=attrgetter("total"), default=self)
        return best.without_doubles(windows) if best.total > self.total else self


class Grid:
    """Steps at all positions that are tried."""

    def __init__(self, estimate: FreeEstimate) -> None:
        times = estimate.axis.times
        spacing = max(0.5, times / MAX_POSITIONS)
        first = 0 if estimate.axis.periodic else 1  # a step before the first sample is none
        self.steps = estimate.steps(np.arange(first, int(times / spacing), dtype=float) * spacing)
        count = len(self.steps.positions)
        every = -(-count // MAX_FIRST)
        self.paired = slice(None, None, -(-count // (every * MAX_PAIRED)))
        self.first = self.steps.take(slice(None, None, every))
        pairs = self.first.take(self.paired)
        self.pair_gram = pairs.products(pairs)
        self.log_positions = math.log(times)
        self.windows = Windows(estimate, SEARCHED, SEARCH_REACH * max(1.0, spacing))


def first_proposal(smooth: SmoothFit, grid: Grid) -> Switches:
    """Return the best of no switch, one switch and two opposite ones beside a smooth part."""
    value, positions = max(one_or_two(smooth, grid), key=itemgetter(0))
    # Searched only if a gain as large, and REACH more, would make it the best.
    return Switches(positions, smooth, smooth.score + value, max(value, REACH) + REACH)


def one_or_two(smooth: SmoothFit, grid: Grid) -> Iterator[tuple[float, Array]]:
    """Yield the log evidence and positions of no switch, the best one, and the best opposite two.

    The sizes of two opposite switches are those of one column, which is their difference.
    """
    yield 0.0, np.zeros(0)
    steps, variance = smooth.beside(grid.first), FIRST_SIZE**2
    pairs = steps.take(grid.paired)
    gram = grid.pair_gram - pairs.explained.T @ pairs.explained
    power = (pairs.power[:, None] + pairs.power) / 2 - gram
    cross = (pairs.cross[:, None] - pairs.cross) / math.sqrt(2)
    for tried, powers, products in ((steps, steps.power, steps.cross), (pairs, power, cross)):
        ratio = 1 + variance * np.maximum(powers, 0.0)
        value = 0.5 * (variance * products**2 / ratio - np.log(ratio))
        best = np.unravel_index(value.argmax(), value.shape)
        yield value[best] - len(best) * grid.log_positions, tried.positions[np.sort(best)]


def best_switch(switches: Switches, grid: Grid) -> Switches:
    """Return the best set one step from a set of switches.

    A step removes a switch, moves one, replaces two neighbours by one, or adds one.
    """
    smooth, count = switches.smooth, len(switches.positions)
    own, steps = smooth.steps(switches.positions), smooth.beside(grid.steps)
    removals = [[place] for place in range(count)]
    removals += [[place, place + 1] for place in range(count - 1)]
    removals += [[0, count - 1]] * (smooth.estimate.axis.periodic and count > 2)
    removals += [[]] * (count < MAX_SWITCHES)
    options = []
    for removed in removals:
        rest = own.take(np.delete(np.arange(count), np.array(removed, dtype=int)))
        if len(removed) == 1:
            options.append((smooth.score_of(rest), list(rest.positions)))
        value = rest.log_evidence_with(steps, smooth.estimate.axis).max(axis=0)
        best = int(np.argmax(value))
        score = smooth.score + value[best] - (len(rest.positions) + 1) * grid.log_positions
        options.append((score, [*rest.positions, steps.positions[best]]))
    refined = switches._replace(positions=np.sort(max(options)[1])).refined(grid.windows)
    return refined._replace(gain=refined.score - switches.score)


def joint_update(estimate: FreeEstimate, positions: Array) -> Iterator[Array]:
    """Yield the best set of each number of switches, as if the noise were white.

    Dynamic programming finds the levels between them (Bellman 1961). It finds several switches
    together, each of which alone has little evidence, so that steps of one switch would miss them.
    On a periodic axis, the cycle is cut at the first of the ``positions``, with or without a switch
    there.
    """
    times, periodic = estimate.axis.times, estimate.axis.periodic
    cut = round(positions[0]) % times if periodic and len(positions) else 0
    precision = np.sum(estimate.whitener**2, axis=0)
    edges = np.append(np.arange(0, times, -(-times // MAX_FIRST)), times)
    sums = np.cumsum(np.roll([precision, precision * estimate.values], -cut, axis=1), axis=1)
    sums = np.pad(sums, ((0, 0), (1, 0)))[:, edges]
    power, cross = sums[:, :, None] - sums[:, None]  # from an edge before to an edge
    before = np.tri(len(edges), k=-1, dtype=bool)
    gains = np.where(before, cross**2 / np.maximum(power, NEGLIGIBLE * power.max()), -np.inf)
    best, paths = gains[:, 0], [tuple[int, ...]()] * len(edges)
    for count in range(1, min(MAX_JOINT, len(edges) - 2) + 1):
        whole = best + gains
        best = whole.max(axis=1)
        paths = [(*paths[last], (edges[last] + cut) % times) for last in whole.argmax(axis=1)]
        yield np.sort(paths[-1]).astype(np.float64)
        if periodic and count < MAX_JOINT:
            yield np.sort([*paths[-1], cut]).astype(np.float64)


def propose_switches(
    smooths: Sequence[SmoothFit], grid: Grid, first: Sequence[Switches]
) -> list[Switches]:
    """Return sets of switches near the best score, best first, and the empty one.

    The search begins with one set for each smooth part. It always goes on beside the smooth part
    that has the best score. It does not begin beside a smooth part with a set at which it ended
    beside another.
    """
    found, still_open = list(first), {each.smooth: each for each in first}
    begun, ended = set[SmoothFit](), set[tuple[float, ...]]()
    for _ in range(MAX_STEPS):
        best = max(map(BY_SCORE, found))
        able = [
            each
            for each in still_open.values()
            if each.score + min(each.gain, MAX_GAIN) > best
            and (each.smooth in begun or tuple(each.positions) not in ended)
        ]
        if not able:
            break
        switches = max(able, key=BY_SCORE)
        smooth = switches.smooth
        if smooth not in begun:
            begun.add(smooth)
            switches = switches.refined(grid.windows)
            found.append(switches)
        after = best_switch(switches, grid)
        if after.score > best - SLACK:
            found.append(after)
        still_open[smooth] = after
        if after.gain <= MIN_GAIN:
            ended.add(tuple(switches.positions))
            del still_open[smooth]
    best, none = max(map(BY_SCORE, found)), smooths[0]
    joint = [
        Switches(positions, none, none.score_of(none.steps(positions)))
        for positions in joint_update(none.estimate, first[0].positions)
    ]
    joint = [each.refined(grid.windows) for each in nlargest(MAX_REFINED, joint, key=BY_SCORE)]
    found += [each for each in joint if each.score > best - SLACK]
    smoothest = max(smooths, key=BY_SCORE)
    empty = Switches(np.zeros(0), smoothest, smoothest.score)
    best_of = {tuple(each.positions): each for each in sorted(found, key=BY_SCORE)}
    sets = [each for each in best_of.values() if len(each.positions)]
    best = max(map(BY_SCORE, [empty, *sets]))
    sets = nlargest(MAX_SETS, [each for each in sets if each.score > best - REACH], key=BY_SCORE)
    return [*sets, empty]
