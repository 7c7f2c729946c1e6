"""Search for the sets of switches with the greatest evidence; it is deterministic."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from heapq import nlargest
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from tvsysid.methods.adaptive.evidence import FreeEstimate, SmoothFit, Steps
from tvsysid.methods.adaptive.prior import switch_priors
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


class Placed(NamedTuple):
    """Switches at their most probable ``positions`` beside a smooth part, and their ``score``.

    Each switch may also lie at other positions: it has a window of them and their probabilities.
    ``log_volume`` is the log of the weight of all positions together, in samples.
    """

    positions: Array
    score: float
    windows: tuple[Array, ...]
    probabilities: tuple[Array, ...]
    log_volume: float

    @property
    def total(self) -> float:
        """Score of the switches at any position."""
        return self.score + self.log_volume


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


def score_of(switches: Steps, smooth: SmoothFit) -> float:
    """Return the log evidence for switches beside a smooth part, plus the log prior."""
    axis = smooth.estimate.axis
    evidence = float(switches.log_evidence(axis.periodic).max())
    return smooth.score + evidence - len(switches.positions) * math.log(axis.times)


def refine_positions(
    positions: Sequence[float] | Array, smooth: SmoothFit, windows: Windows
) -> Placed:
    """Move switches to their most probable positions, each beside the others, until none moves."""
    axis, count = smooth.estimate.axis, len(positions)
    own = smooth.beside(smooth.estimate.steps(np.array(positions, dtype=np.float64)))
    prior = switch_priors(axis.periodic)[int(own.log_evidence(axis.periodic).argmax())]
    around = list(own.positions[:, None])
    weights = [np.ones(1)] * count
    for _ in range(SWEEPS if count > 1 else count):
        before = own.positions
        for place in range(count):
            others = own.take(np.delete(np.arange(count), place))
            window = windows.around(round(own.positions[place]), smooth)
            value = others.log_evidence_with(window, axis, prior)
            best = int(np.argmax(value))
            if not np.isfinite(value[best]):
                continue
            new = window.take(slice(best, best + 1))
            own = Steps.joined([own.take(slice(place)), new, own.take(slice(place + 1, None))])
            around[place], weights[place] = window.positions, np.exp(value - value[best])
        if np.array_equal(own.positions, before):
            break
    order = np.argsort(own.positions)
    return Placed(
        own.positions[order],
        score_of(own, smooth),
        tuple(around[place] for place in order),
        tuple(weights[place] / weights[place].sum() for place in order),
        float(sum(math.log(each.sum() * windows.spacing) for each in weights)),
    )


def merge_close(placed: Placed, smooth: SmoothFit, windows: Windows) -> Placed:
    """Remove one of two close switches where that raises the evidence.

    On the grid of the search, two switches may represent one.
    """
    while len(placed.positions) > 1:
        gaps = np.abs(smooth.estimate.axis.offset(placed.positions, np.roll(placed.positions, 1)))
        close = [int(gap) for gap in np.flatnonzero(gaps < CLOSE)]
        tried = [
            refine_positions(np.delete(placed.positions, place), smooth, windows)
            for gap in close
            for place in (gap, gap - 1)
        ]
        best = max(tried, key=lambda each: each.total, default=placed)
        if best.total <= placed.total:
            break
        placed = best
    return placed


class Proposal(NamedTuple):
    """Positions of switches beside a smooth part, their score, and the gain of the last step.

    REACH is added to the gain of the first step, which then counts as 2 REACH at least. A smooth
    part is not searched if further switches had to gain more than that, or MAX_GAIN, to make it the
    best.
    """

    positions: tuple[float, ...]
    smooth: SmoothFit
    score: float = -math.inf
    gain: float = math.inf

    def refined(self, windows: Windows) -> Proposal:
        """Return the proposal with its switches at their most probable positions."""
        placed = refine_positions(self.positions, self.smooth, windows)
        return self._replace(positions=tuple(placed.positions), score=placed.score)


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


def first_proposals(smooths: Sequence[SmoothFit], grid: Grid) -> list[Proposal]:
    """Return the best of no switch, one switch and two opposite ones beside each smooth part.

    Switches add at most half of the chi-square that a smooth part leaves, less a log prior. If even
    this bound is far below the best score, no switches are searched for. The bound is not sharp,
    because it includes the noise of all samples.
    """
    best, first = max(map(BY_SCORE, smooths)), list[Proposal]()
    for smooth in smooths:
        value, positions, gain = 0.0, tuple[float, ...](), -math.inf
        if smooth.score + smooth.residual / 2 - grid.log_positions > best - REACH:
            value, positions = _one_or_two(smooth, grid)
            gain = max(value, REACH) + REACH
        first.append(Proposal(positions, smooth, smooth.score + value, gain))
    return first


def _one_or_two(smooth: SmoothFit, grid: Grid) -> tuple[float, tuple[float, ...]]:
    """Return the best score and positions of no switch, one switch, or two opposite ones."""
    steps, variance = smooth.beside(grid.first), FIRST_SIZE**2
    ratio = 1 + variance * steps.power
    single = 0.5 * (variance * steps.cross**2 / ratio - np.log(ratio)) - grid.log_positions
    ends = steps.take(grid.paired)
    gram = grid.pair_gram - ends.explained.T @ ends.explained
    ratio = 1 + variance * np.maximum((ends.power[:, None] + ends.power) / 2 - gram, 0.0)
    square = variance / 2 * (ends.cross[:, None] - ends.cross) ** 2 / ratio
    # Pairs that are far below the largest square cannot be the best: they need no logarithm.
    top = square.argmax()
    able = np.flatnonzero(square >= square.flat[top] - math.log(ratio.flat[top]))
    pairs = 0.5 * (square.flat[able] - np.log(ratio.flat[able])) - 2 * grid.log_positions
    best, pair = int(np.argmax(single)), int(np.argmax(pairs))
    both = list(divmod(int(able[pair]), len(square)))
    return max(
        (0.0, ()),
        (float(single[best]), (steps.positions[best],)),
        (float(pairs[pair]), tuple(np.sort(ends.positions[both]))),
    )


def best_switch(proposal: Proposal, steps: Steps, grid: Grid) -> Proposal:
    """Return the best set one step from a proposal.

    A step removes a switch, moves one, replaces two neighbours by one, or adds one. ``steps`` are
    those of the grid beside the smooth part.
    """
    smooth, count = proposal.smooth, len(proposal.positions)
    axis = smooth.estimate.axis
    own = smooth.beside(smooth.estimate.steps(np.array(proposal.positions)))
    removals = [[place] for place in range(count)]
    removals += [[place, place + 1] for place in range(count - 1)]
    removals += [[0, count - 1]] * (axis.periodic and count > 2)
    removals += [[]] * (count < MAX_SWITCHES)
    options = []
    for removed in removals:
        rest = own.take(np.delete(np.arange(count), np.array(removed, dtype=int)))
        if len(removed) == 1:
            options.append((score_of(rest, smooth), tuple(rest.positions)))
        value = rest.log_evidence_with(steps, axis)
        best = int(np.argmax(value))
        score = smooth.score + value[best] - (len(rest.positions) + 1) * grid.log_positions
        options.append((score, (*rest.positions, steps.positions[best])))
    best_one = proposal._replace(positions=tuple(sorted(max(options)[1]))).refined(grid.windows)
    return best_one._replace(gain=best_one.score - proposal.score)


def joint_update(estimate: FreeEstimate, positions: Sequence[float]) -> Iterator[tuple[float, ...]]:
    """Yield the best set of each number of switches, as if the noise were white.

    Dynamic programming finds the levels between them (Bellman 1961). It finds several switches
    together, each of which alone has little evidence, so that steps of one switch would miss them.
    On a periodic axis, the cycle is cut at the first of the ``positions``, with or without a switch
    there.
    """
    times, periodic = estimate.axis.times, estimate.axis.periodic
    cut = round(positions[0]) % times if periodic and positions else 0
    weights = np.roll(np.diag(estimate.precision), -cut)
    edges = np.append(np.arange(0, times, -(-times // MAX_FIRST)), times)
    # sums between an edge and each edge before it
    power, cross = (
        np.subtract.outer(sums, sums)
        for sums in (
            np.append(0.0, np.cumsum(each))[edges]
            for each in (weights, weights * np.roll(estimate.values, -cut))
        )
    )
    before = np.tri(len(edges), k=-1, dtype=bool)
    gains = np.where(before, cross**2 / np.maximum(power, NEGLIGIBLE * power.max()), -np.inf)
    best, paths = gains[:, 0], [tuple[int, ...]()] * len(edges)
    for count in range(1, min(MAX_JOINT, len(edges) - 2) + 1):
        whole = best + gains
        best = whole.max(axis=1)
        paths = [(*paths[last], (edges[last] + cut) % times) for last in whole.argmax(axis=1)]
        yield tuple(np.sort(paths[-1]).astype(float))
        if periodic and count < MAX_JOINT:
            yield tuple(np.sort([*paths[-1], cut]).astype(float))


def propose_switches(
    smooths: Sequence[SmoothFit], grid: Grid, proposals: Sequence[Proposal]
) -> list[Proposal]:
    """Return sets of switches near the best score, best first, and the empty one.

    The search begins with the ``proposals``, one for each smooth part. It always goes on beside the
    smooth part that has the best score.
    """
    found: dict[tuple[float, ...], Proposal] = {}

    def note(proposal: Proposal) -> None:
        known = found.get(proposal.positions, proposal)
        found[proposal.positions] = max(proposal, known, key=BY_SCORE)

    for proposal in proposals:
        note(proposal)
    still_open, steps, closed_at = list(proposals), dict[SmoothFit, Steps](), set()
    for _ in range(MAX_STEPS):
        best = max(map(BY_SCORE, found.values()))
        able = [
            each
            for each in still_open
            if each.score + min(each.gain, MAX_GAIN) > best
            and (each.smooth in steps or each.positions not in closed_at)
        ]
        if not able:
            break
        proposal = max(able, key=BY_SCORE)
        still_open.remove(proposal)
        if proposal.smooth not in steps:
            steps[proposal.smooth] = proposal.smooth.beside(grid.steps)
            proposal = proposal.refined(grid.windows)
            note(proposal)
        after = best_switch(proposal, steps[proposal.smooth], grid)
        if after.score > best - SLACK:
            note(after)
        if after.gain > MIN_GAIN:
            still_open.append(after)
        else:
            closed_at.add(proposal.positions)
            del steps[proposal.smooth]
    best, none = max(map(BY_SCORE, found.values())), smooths[0]
    joint = [
        Proposal(each, none, score_of(none.beside(none.estimate.steps(np.array(each))), none))
        for each in dict.fromkeys(joint_update(none.estimate, proposals[0].positions))
    ]
    for proposal in nlargest(MAX_REFINED, joint, key=BY_SCORE):
        refined = proposal.refined(grid.windows)
        if refined.score > best - SLACK:
            note(refined)
    empty = Proposal((), max(smooths, key=BY_SCORE))
    sets = sorted((each for each in found.values() if each.positions), key=BY_SCORE, reverse=True)
    best = max([empty.smooth.score, *map(BY_SCORE, sets)])
    return [*(each for each in sets[:MAX_SETS] if each.score > best - REACH), empty]
