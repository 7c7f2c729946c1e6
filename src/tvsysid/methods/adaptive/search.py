"""Search for the sets of switches with the greatest evidence; it is deterministic."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from heapq import nlargest
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from tvsysid.methods.adaptive.evidence import FreeEstimate, SmoothFit, column_evidence
from tvsysid.methods.adaptive.prior import USUAL_SWITCH_SIZE
from tvsysid.numerics import Array

MAX_SWITCHES = 20  # of a model
MAX_POSITIONS = 400  # at which one more switch is tried
MAX_GAIN = 50.0  # largest gain in score that is expected of one more switch
# A second switch is expected to gain at most max(gain of the first, EXTRA_GAIN) + EXTRA_GAIN.
EXTRA_GAIN = 12.0
MAX_JOINT_SWITCHES = 6  # that are placed together
MAX_JOINT_POSITIONS = 200  # at which they are tried
MAX_JOINT_SETS = 3  # of these sets that are refined
MAX_SETS = 8  # that the search returns
MAX_SET_LOSS = 5.0  # their loss of score against the best set
SEARCH_SPACING, SPACING = 1 / 8, 1 / 16  # samples between positions, in the search and after it
SEARCH_REACH, REACH = 1.5, 6.0  # samples to either side by which a switch may move
MAX_SWEEPS = 4  # of a refinement, which moves each switch once in a sweep
NEARBY_SAMPLES = 3.0  # samples within which one of two switches may represent both
BY_SCORE = attrgetter("score")


class CurveModel(NamedTuple):
    """Explanation of a free estimate: a smooth part, and switches at ``positions``.

    ``score`` is that of the :class:`SmoothFit` beside which the switches were found, with switches
    at exactly these positions and their best size prior. If the positions are refined,
    ``possible_positions`` holds the positions that each switch may have, and their probabilities.
    ``log_volume`` is the log of the evidence integrated over these positions in samples, less that
    of the evidence at the best ones. ``evidence`` is the score with one ``size_prior`` (an index of
    the result of ``switch_evidence``) instead of the best, plus ``log_volume`` and the log
    probabilities of this size prior and of an unusual smear.
    """

    smooth: SmoothFit
    positions: Array
    score: float = -math.inf
    possible_positions: Sequence[tuple[Array, Array]] = ()
    log_volume: float = 0.0
    size_prior: int = 0
    evidence: float = -math.inf

    @property
    def total(self) -> float:
        """Score, of the best size prior, with the positions of the switches integrated out."""
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

    def refined(self, spacing: float = SPACING, reach: float = REACH) -> CurveModel:
        """Move switches to their most probable positions, each beside the others, in turn.

        Positions that are tried have a ``spacing`` and a distance of up to ``reach`` samples.
        """
        smooth, count = self.smooth, len(self.positions)
        own = smooth.steps(self.positions)
        size_prior = int(smooth.scores_of(own).argmax())
        windows = list[tuple[Array, Array]]()
        unmoved = 0  # last switches that stayed where they were
        while unmoved < count and len(windows) < (MAX_SWEEPS * count if count > 1 else 1):
            position = own.positions[0]  # take the first switch, move it, and append it
            others = own.take(slice(1, None))
            window = smooth.beside(smooth.estimate.steps_around(round(position), spacing, reach))
            scores = smooth.scores_with(others, window)[size_prior]
            best = int(np.argmax(scores))
            own = others.joined(window.take(slice(best, best + 1)))
            windows.append((window.positions, softmax(scores)))
            unmoved = unmoved + 1 if window.positions[best] == position else 0
        possible_positions = windows[len(windows) - count :]
        order = np.argsort(own.positions)
        # A probability is evidence over the sum of evidence. So 1 / probability is the sum relative
        # to the best, and each term of the sum stands for one spacing.
        volumes = [spacing / probabilities.max() for _, probabilities in possible_positions]
        return self._replace(
            positions=own.positions[order],
            score=float(smooth.scores_of(own).max()),
            possible_positions=[possible_positions[index] for index in order],
            log_volume=sum(map(math.log, volumes)),
        )

    def without_doubles(self) -> CurveModel:
        """Remove one of two close switches where that raises the evidence.

        On the grid of the search, two switches may represent one.
        """
        own = self.positions
        is_close = np.abs(self.smooth.estimate.axis.offset(own[:, None], own)) < NEARBY_SAMPLES
        doubles = np.flatnonzero(is_close.sum(axis=0) > 1)
        if not len(doubles):
            return self
        rests = [np.delete(own, index) for index in doubles]
        tried = self._replace(positions=max(rests, key=self.score_at)).refined()
        return tried.without_doubles() if tried.total > self.total else self


class Grid:
    """Steps at all positions at which the search tries one more switch.

    ``window`` is the spacing and reach within which the search moves a switch.
    """

    def __init__(self, estimate: FreeEstimate) -> None:
        times = estimate.axis.times
        spacing = max(0.5, times / MAX_POSITIONS)
        first = 0 if estimate.axis.periodic else 1  # a step at the first sample is a constant
        self.steps = estimate.steps(np.arange(first, int(times / spacing), dtype=float) * spacing)
        self.window = SEARCH_SPACING, SEARCH_REACH * max(1.0, spacing)


def first_model(smooth: SmoothFit, grid: Grid) -> CurveModel:
    """Return a smooth part with the best switch of the usual size, or none if that is better."""
    steps = smooth.beside(grid.steps)
    evidence = column_evidence(steps.power, steps.cross, USUAL_SWITCH_SIZE**2)
    score = smooth.score + evidence.max() - math.log(smooth.estimate.axis.times)
    if score <= smooth.score:
        return CurveModel(smooth, np.zeros(0), smooth.score)
    return CurveModel(smooth, steps.positions[[evidence.argmax()]], score)


def best_change(model: CurveModel, grid: Grid) -> CurveModel:
    """Return the best model with one more switch, or with one switch at another position."""
    smooth = model.smooth
    every = np.arange(len(model.positions))
    own = smooth.steps(model.positions)
    steps = smooth.beside(grid.steps)
    options = []
    for kept in [*(np.delete(every, index) for index in every), every]:
        rest = own.take(kept)
        scores = smooth.scores_with(rest, steps).max(axis=0)
        best = int(np.argmax(scores))
        options.append((scores[best], [*rest.positions, steps.positions[best]]))
    return model._replace(positions=np.sort(max(options)[1])).refined(*grid.window)


def joint_switches(estimate: FreeEstimate, first: Array) -> Iterator[Array]:
    """Yield the positions of the best one, two and more switches between constant levels.

    Dynamic programming finds them as if the noise were white (Bellman 1961). It also finds several
    switches that have little evidence one by one. A periodic axis is cut at the ``first`` position,
    with or without a switch there.
    """
    times = estimate.axis.times
    periodic = estimate.axis.periodic
    cut = round(first[0]) if periodic and len(first) else 0
    precision = np.sum(estimate.whitener**2, axis=0)
    edges = np.append(np.arange(0, times, -(-times // MAX_JOINT_POSITIONS)), times)
    sums = np.cumsum(np.roll([precision, precision * estimate.values], -cut, axis=1), axis=1)
    sums = np.pad(sums, ((0, 0), (1, 0)))[:, edges]
    # Power and cross product of a constant level, indexed by the edges at its end and its start
    power, cross = sums[:, :, None] - sums[:, None]
    before = np.tri(len(edges), k=-1, dtype=bool)
    gains = np.divide(cross**2, power, out=np.full(power.shape, -np.inf), where=before)
    # Gain and switches of the best levels from 0 up to each edge
    best, paths = gains[:, 0], [list[float]()] * len(edges)
    for count in range(1, MAX_JOINT_SWITCHES + 1):
        total = best + gains
        paths = [[*paths[last], edges[last]] for last in total.argmax(axis=1)]
        best = total.max(axis=1)
        yield np.sort(np.add(paths[-1], cut) % times)
        if periodic and count < MAX_JOINT_SWITCHES:
            yield np.sort(np.add([*paths[-1], 0.0], cut) % times)  # with a switch at the cut


def search_switches(first: Sequence[CurveModel], grid: Grid) -> list[CurveModel]:
    """Return sets of switches near the best score, and the empty one, which is last.

    The search begins with the ``first`` model of each smooth part. It changes the model with the
    best score by one switch at a time. Beside a smooth part, it ends where no change raises the
    score, or where a gain as large as the last one would not give the best score of all.
    """
    found = list(first)
    open_models = list(first)
    ended_at = set[bytes]()  # positions of the switches at which a search ended
    gains = dict[SmoothFit, float]()  # of the last change, beside smooth parts that have begun
    while open_models:
        open_models.sort(key=BY_SCORE)
        model = open_models.pop()  # the best
        best = max(map(BY_SCORE, found))
        smooth = model.smooth
        switches = model.positions.tobytes()
        if smooth not in gains:  # its search begins, unless another one has ended at its switches
            if switches in ended_at:
                continue
            gains[smooth] = max(model.score - smooth.score, EXTRA_GAIN) + EXTRA_GAIN
        possible = model.score + min(gains[smooth], MAX_GAIN)
        if possible > best and len(model.positions) < MAX_SWITCHES:
            after = best_change(model, grid)
            found.append(after)
            if after.score > model.score:
                gains[smooth] = after.score - model.score
                open_models.append(after)
            else:
                ended_at.add(switches)
    empty = CurveModel(first[0].smooth, np.zeros(0))
    joint = [
        empty._replace(positions=positions, score=empty.score_at(positions))
        for positions in joint_switches(empty.smooth.estimate, first[0].positions)
    ]
    found += [each.refined(*grid.window) for each in nlargest(MAX_JOINT_SETS, joint, key=BY_SCORE)]
    found.sort(key=BY_SCORE)
    best_of = {each.positions.tobytes(): each for each in found if len(each.positions)}
    sets = [each for each in best_of.values() if each.score > found[-1].score - MAX_SET_LOSS]
    return [*nlargest(MAX_SETS, sets, key=BY_SCORE), empty]
