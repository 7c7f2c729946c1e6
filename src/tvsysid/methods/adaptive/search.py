"""Search for the sets of switches with the greatest evidence; it is deterministic."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from heapq import nlargest
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from tvsysid.methods.adaptive.evidence import FreeEstimate, SmoothFit, column_evidence
from tvsysid.numerics import Array

MAX_POSITIONS = 400  # of one more switch that are tried
MAX_JOINT_POSITIONS = 200  # of several switches that are tried together
FIRST_SIZE = 0.2  # standard deviation of the first switch, in mean sizes
MAX_GAIN = 50.0  # largest gain in log evidence that is expected of one more switch
MAX_SWITCHES = 20  # from which the search adds none
SLACK = 5.0  # loss of log evidence against the best set up to which a set is returned
MAX_JOINT, MAX_REFINED = 6, 3  # switches of a joint update, and sets of these that are refined
REACH = 12.0  # gain in log evidence beyond the first one that is expected of a second switch
MAX_SETS = 8  # number of sets that the search returns
SEARCHED, PLACED = 1 / 8, 1 / 16  # samples between positions, in the search and after it
SEARCH_REACH, REFINE_REACH = 1.5, 6.0  # samples to either side in which a switch may move
NEARBY_SAMPLES = 3.0  # samples within which one of two switches may represent both
SWEEPS = 4  # of all switches, each placed beside the others, at most
BY_SCORE = attrgetter("score")


class CurveModel(NamedTuple):
    """Explanation of a free estimate: a smooth part, and switches at ``positions``.

    ``score`` is the log evidence with the switches at exactly these positions. ``places`` holds the
    possible positions of each switch and their probabilities, once they are refined.
    ``log_volume`` is the log of the ratio of the evidence, integrated over all these positions in
    samples, to that at the best ones. ``evidence`` is the integrated log evidence, priors included,
    for the size prior with the index ``size_prior``.
    """

    smooth: SmoothFit
    positions: Array
    score: float = -math.inf
    places: Sequence[tuple[Array, Array]] = ()
    log_volume: float = 0.0
    size_prior: int = 0
    evidence: float = -math.inf

    @property
    def total(self) -> float:
        """Score of the switches at any position."""
        return self.score + self.log_volume

    def is_constant(self) -> bool:
        """Return whether nothing changes."""
        return not len(self.positions) and not self.is_smooth()

    def is_smooth(self) -> bool:
        """Return whether there is a smooth part."""
        return bool(self.smooth.prior.variances[1:].any())

    def score_at(self, positions: Array) -> float:
        """Return the score with switches at other positions."""
        return float(self.smooth.scores_of(self.smooth.steps(positions)).max())

    def refined(self, spacing: float = PLACED, reach: float = REFINE_REACH) -> CurveModel:
        """Move switches to their most probable positions, each beside the others, in turn.

        Positions that are tried have a ``spacing`` and a distance of up to ``reach`` samples.
        """
        smooth, count = self.smooth, len(self.positions)
        own, places = smooth.steps(self.positions), deque[tuple[Array, Array]](maxlen=count)
        size_prior = int(smooth.scores_of(own).argmax())
        for _ in range(SWEEPS if count > 1 else 1):
            before = own.positions
            for position in before:  # the first switch is moved, and becomes the last
                others = own.take(slice(1, None))
                window = smooth.beside(smooth.estimate.window(round(position), spacing, reach))
                scores = smooth.scores_with(others, window)[size_prior]
                best = int(np.argmax(scores))
                own = others.joined(window.take(slice(best, best + 1)))
                places.append((window.positions, softmax(scores)))
            if np.array_equal(own.positions, before):
                break
        order = np.argsort(own.positions)
        # The sum of all weights is that of the best position over its probability.
        volumes = [spacing / probabilities.max() for _, probabilities in places]
        return self._replace(
            positions=own.positions[order],
            score=float(smooth.scores_of(own).max()),
            places=[places[place] for place in order],
            log_volume=sum(map(math.log, volumes)),
        )

    def without_doubles(self) -> CurveModel:
        """Remove one of two close switches where that raises the evidence.

        On the grid of the search, two switches may represent one.
        """
        own = self.positions
        is_close = np.abs(self.smooth.estimate.axis.offset(own[:, None], own)) < NEARBY_SAMPLES
        rests = [np.delete(own, place) for place in np.flatnonzero(is_close.sum(axis=0) > 1)]
        if not rests:
            return self
        tried = self._replace(positions=max(rests, key=self.score_at)).refined()
        return tried.without_doubles() if tried.total > self.total else self


class Grid:
    """Steps at all positions that are tried."""

    def __init__(self, estimate: FreeEstimate) -> None:
        times = estimate.axis.times
        spacing = max(0.5, times / MAX_POSITIONS)
        first = 0 if estimate.axis.periodic else 1  # a step before the first sample is none
        self.steps = estimate.steps(np.arange(first, int(times / spacing), dtype=float) * spacing)
        self.window = SEARCHED, SEARCH_REACH * max(1.0, spacing)


def first_model(smooth: SmoothFit, grid: Grid) -> CurveModel:
    """Return the better of no switch and the best single one beside a smooth part."""
    steps = smooth.beside(grid.steps)
    evidence = column_evidence(steps.power, steps.cross, FIRST_SIZE**2)
    score = smooth.score + evidence.max() - math.log(smooth.estimate.axis.times)
    if score <= smooth.score:
        return CurveModel(smooth, np.zeros(0), smooth.score)
    return CurveModel(smooth, steps.positions[[evidence.argmax()]], score)


def best_step(model: CurveModel, grid: Grid) -> CurveModel:
    """Return the best model with one more switch, or with another one in place of one."""
    smooth, count = model.smooth, len(model.positions)
    own, steps, options = smooth.steps(model.positions), smooth.beside(grid.steps), []
    rests = [np.delete(np.arange(count), place) for place in range(count)]
    for kept in [*rests, np.arange(count)]:
        rest = own.take(kept)
        scores = smooth.scores_with(rest, steps).max(axis=0)
        best = int(np.argmax(scores))
        options.append((scores[best], [*rest.positions, steps.positions[best]]))
    return model._replace(positions=np.sort(max(options)[1])).refined(*grid.window)


def joint_update(estimate: FreeEstimate, first: Array) -> Iterator[Array]:
    """Yield the best set of each number of switches, as if the noise were white.

    Dynamic programming finds the levels between them (Bellman 1961). It finds several switches
    together, each of which alone has little evidence, so that steps of one switch would miss them.
    On a periodic axis, the cycle is cut at the ``first`` position, with or without a switch there.
    """
    times, periodic = estimate.axis.times, estimate.axis.periodic
    cut = round(first[0]) if periodic and len(first) else 0
    precision = np.sum(estimate.whitener**2, axis=0)
    edges = np.append(np.arange(0, times, -(-times // MAX_JOINT_POSITIONS)), times)
    sums = np.cumsum(np.roll([precision, precision * estimate.values], -cut, axis=1), axis=1)
    sums = np.pad(sums, ((0, 0), (1, 0)))[:, edges]
    power, cross = sums[:, :, None] - sums[:, None]  # from an edge before to an edge
    before = np.tri(len(edges), k=-1, dtype=bool)
    gains = np.divide(cross**2, power, out=np.full(power.shape, -np.inf), where=before)
    best, paths = gains[:, 0], [list[float]()] * len(edges)
    for count in range(1, MAX_JOINT + 1):
        paths = [[*paths[last], edges[last]] for last in (best + gains).argmax(axis=1)]
        best = (best + gains).max(axis=1)
        for path in [paths[-1], [*paths[-1], 0.0]][: 1 + (periodic and count < MAX_JOINT)]:
            yield np.sort(np.add(path, cut) % times)


def propose_switches(first: Sequence[CurveModel], grid: Grid) -> list[CurveModel]:
    """Return sets of switches near the best score, and the empty one, which is last.

    The search begins with the ``first`` model of each smooth part. Each step extends the model with
    the best score. A smooth part is skipped if its first set of switches is one at
    which the search of another smooth part has ended.
    """
    found, still_open, ended = list(first), list(first), set[bytes]()
    # The search begins only where a gain as large, and REACH more, would make it the best.
    gains = {each.smooth: max(each.score - each.smooth.score, REACH) + REACH for each in first}
    while still_open:
        still_open.sort(key=BY_SCORE)
        before, best = still_open.pop(), max(map(BY_SCORE, found))
        positions, possible = before.positions, before.score + min(gains[before.smooth], MAX_GAIN)
        is_new = before.places or positions.tobytes() not in ended
        if is_new and possible > best and len(positions) < MAX_SWITCHES:
            after = best_step(before, grid)
            found.append(after)
            if after.score > before.score:
                gains[after.smooth] = after.score - before.score
                still_open.append(after)
            else:
                ended.add(positions.tobytes())
    empty = CurveModel(first[0].smooth, np.zeros(0))
    joint = [
        empty._replace(positions=positions, score=empty.score_at(positions))
        for positions in joint_update(empty.smooth.estimate, first[0].positions)
    ]
    found += [each.refined(*grid.window) for each in nlargest(MAX_REFINED, joint, key=BY_SCORE)]
    best_of = {each.positions.tobytes(): each for each in sorted(found, key=BY_SCORE)}
    best = max(map(BY_SCORE, found))
    sets = [each for at, each in best_of.items() if at and each.score > best - SLACK]
    return [*nlargest(MAX_SETS, sets, key=BY_SCORE), empty]
