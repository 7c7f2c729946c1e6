"""Posterior of a function of time: all plausible models, weighted by their evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.methods.adaptive.evidence import Line, Smooth, every_sizes, jumps_of_every_size
from tvsysid.methods.adaptive.harmonics import few_harmonics
from tvsysid.methods.adaptive.mixture import (
    LIGHTEST,
    Candidate,
    Hypothesis,
    Mixture,
    mixture_of,
    path,
)
from tvsysid.methods.adaptive.placing import (
    Found,
    Placed,
    Windows,
    add,
    joined,
    refined,
    simplified,
    total,
)
from tvsysid.methods.adaptive.prior import JITTERS, Axis, Roughness, roughnesses
from tvsysid.methods.adaptive.search import Grid, first_states, found_sets
from tvsysid.numerics import Array
from tvsysid.numerics.bands import arc_length

LIKELY, MOST_MODELS = (
    7.0,
    32,
)  # log evidence below the best down to which models count, and how many at most
MOST_SMEARED = 6  # switches up to which it is tried how steps are smeared
COARSELY = 1 / 4  # sample between positions where smears are compared
OPEN = 3.0  # log evidence below the usual low-pass's down to which another smear counts

Hypotheses = Sequence[Hypothesis]


def candidates(smooths: tuple[Smooth, ...], sets: list[Placed]) -> list[Candidate]:
    """Return every smooth part with every set of switches and prior of sizes."""
    line = smooths[0].line
    out = [
        Candidate(smooth, smooth.score, placed, None)
        for placed in sets
        if not len(placed.positions)
        for smooth in smooths
    ]
    filled = [placed for placed in sets if len(placed.positions)]
    if not filled:
        return out
    ends = np.cumsum([0] + [len(placed.positions) for placed in filled])
    columns = joined([placed.columns for placed in filled])
    products = [smooth.products(columns) for smooth in smooths]
    grams = np.stack([each.between(each) for each in products])
    crosses = np.stack([each.cross for each in products])
    every = every_sizes(line.axis.periodic)
    scores = np.array([smooth.score for smooth in smooths])
    for placed, first, stop in zip(filled, ends[:-1], ends[1:], strict=True):
        gram, cross = grams[:, first:stop, first:stop], crosses[:, first:stop]
        prior = (
            placed.log_volume - (stop - first) * math.log(line.axis.times) - math.log(len(every))
        )
        factors = jumps_of_every_size(gram, cross, line.axis.periodic)
        for sizes, factor in zip(every, factors.T, strict=True):
            values = scores + prior + factor
            out.extend(
                Candidate(*each, placed, sizes)
                for each in zip(smooths, map(float, values), strict=True)
            )
    return out


class Outcome(NamedTuple):
    """Summary of a candidate, whose matrices would be many times the data."""

    evidence: float
    roughness: Roughness
    switches: bool

    def constant(self) -> bool:
        """Return whether nothing changes."""
        return not self.switches and self.roughness.kind == "none"


class Averaged(NamedTuple):
    """Candidates that count, with their weights, and the mixture of all.

    ``every`` holds the outcome of each candidate.
    """

    candidates: list[Candidate]
    weights: Array
    mixture: Mixture
    every: list[Outcome]

    def probabilities(self) -> Array:
        """Return the probability of every candidate."""
        evidence = np.array([each.evidence for each in self.every])
        share = np.exp(evidence - evidence.max())
        return np.asarray(share / share.sum())

    def probability(self, wanted: Callable[[Outcome], bool]) -> float:
        """Return the probability of all candidates of a kind together."""
        return float(self.probabilities()[[wanted(each) for each in self.every]].sum())

    def hypotheses(self) -> Hypotheses:
        """Return the hypotheses that were averaged, the most probable first."""
        return tuple(
            Hypothesis(each.smooth.line.axis, each.smooth.roughness, each.placed.positions)
            for each in self.candidates
        )

    def arc(self) -> float:
        """Return the length of the path of the scaled estimate, for simultaneous bands."""
        paths = [path(each) for each in self.candidates]
        mean = sum(weight * each.mean for weight, each in zip(self.weights, paths, strict=True))
        apart = [
            math.sqrt(weight) * (each.mean - mean)
            for weight, each in zip(self.weights, paths, strict=True)
        ]
        features = np.column_stack([paths[0].factor, *apart])
        return arc_length(features, np.eye(features.shape[1]))


def averaged(line: Line, known: Hypotheses = ()) -> Averaged:
    """Average all plausible models of a line, weighted by their evidence.

    If there are ``known`` models, only these are averaged.

    A low-pass before sampling smears a step, and so do realizations that switch at different times.
    Each is tried where there are steps. The usual low-pass has a prior probability of 1/2; what the
    data leave open is averaged.
    """
    if known:
        own = attrs.evolve(line, axis=known[0].axis)
        return _weighed(own, _found(own, known=known))
    every = _found(line)
    found = _weighed(line, every)
    best = found.candidates[0]
    if (
        found.probability(lambda each: not each.switches) > 0.5
        or len(best.placed.positions) > MOST_SMEARED
    ):
        return found
    axes = [
        line.axis._replace(taps=0.0),
        *(line.axis._replace(jitter=jitter) for jitter in JITTERS),
    ]
    scores = [_score(best, line, axis) for axis in (line.axis, *axes)]
    other, prior = int(np.argmax(scores[1:])), -math.log(len(axes))
    if scores[1 + other] + prior < scores[0] - OPEN:
        return found
    beside = _found(
        attrs.evolve(line, axis=axes[other]),
        parts=[each.smooth.roughness for each in found.candidates],
    )
    return _weighed(
        line, [*every, *(each._replace(evidence=each.evidence + prior) for each in beside)]
    )


def averaged_beside(line: Line, other: Averaged, known: Hypotheses = ()) -> Averaged:
    """Average models of a line that is mostly constant, but may switch where another does.

    The prior probability is 1/2 that it switches where the other's best candidate does. Other
    switches are searched for only where some seem to be there at first.
    """
    own = attrs.evolve(line, axis=other.candidates[0].smooth.line.axis)
    return _weighed(own, _found(own, other.candidates[0].placed, known))


def tied(placed: Placed, line: Line) -> Placed:
    """Return the switches of another line, with the distributions of their times."""
    columns = line.columns(placed.positions)
    volume = len(placed.positions) * math.log(line.axis.times) + math.log(
        0.5
    )  # no position is to be found
    return placed._replace(columns=columns, log_volume=volume)


def _score(best: Candidate, line: Line, axis: Axis) -> float:
    """Return the score of a candidate's switches, smeared as on another axis."""
    smeared = attrs.evolve(line, axis=axis)
    smooth = Smooth(smeared, best.smooth.roughness)
    windows = Windows(smeared, COARSELY)
    found = refined(Found(best.placed.positions, smooth), windows)
    return total(simplified(found, smooth, windows), smooth)


def _found(
    line: Line,
    others: Placed | None = None,
    known: Hypotheses = (),
    parts: Sequence[Roughness] = (),
) -> list[Candidate]:
    """Return all plausible candidates of a line, with steps smeared as its axis says.

    If there are smooth ``parts``, only these are used. See :func:`averaged_beside`.
    """
    kinds = {each.weights.tobytes(): each for each in [*parts, *(each.roughness for each in known)]}
    smooths = tuple(Smooth(line, each) for each in kinds.values() or roughnesses(line.axis))
    own = [tied(others, line)] if others is not None and len(others.positions) else []
    if known:
        beside = dict(zip(kinds, smooths, strict=True))
        best_ones = {tuple(each.positions): each for each in reversed(known)}.values()
        found_ones = [
            Found(each.positions, beside[each.roughness.weights.tobytes()]) for each in best_ones
        ]
    else:
        grid = Grid(line)
        states = first_states(smooths, grid)
        if others is not None and not states[0].places:
            most = max(
                [each.evidence for each in candidates(smooths, own)]
                + [state.score for state in states[1:]]
            )
            if most < states[0].score - 1:
                none = Placed(np.zeros(0), line.columns(np.zeros(0)), (), (), 0.0)
                return candidates(smooths, [none])
        found_ones = found_sets(grid, smooths, states)
        del grid  # of as many steps as there are times, or more
    windows, sets = Windows(line), list[Placed]()
    for found in found_ones:
        placed = refined(found, windows)
        add(sets, placed, line)
        add(sets, simplified(placed, found.smooth, windows), line)
    every = candidates(smooths, sets)
    every.sort(key=lambda each: each.evidence)
    again: list[Placed] = []
    for best in {id(each.placed): each for each in every}.values():
        add(again, refined(Found(best.placed.positions, best.smooth), windows), line)
    if not kinds:  # beside the best set, and beside none
        for best in {each.sizes is None: each for each in every}.values():
            smooths += tuple(
                Smooth(line, each) for each in few_harmonics(line, best.placed.columns)
            )
    return candidates(smooths, [*again, *own])


def _weighed(line: Line, every: list[Candidate]) -> Averaged:
    every = sorted(every, key=lambda each: -each.evidence)
    kept = [each for each in every if each.evidence > every[0].evidence - LIKELY][:MOST_MODELS]
    weights = np.exp([each.evidence - every[0].evidence for each in kept])
    weights /= weights.sum()
    heavy = weights >= LIGHTEST
    kept, weights = (
        [each for each, is_heavy in zip(kept, heavy, strict=True) if is_heavy],
        weights[heavy],
    )
    weights /= weights.sum()
    parts = [mixture_of(each, share) for each, share in zip(kept, weights, strict=True)]
    shares = [part.weights * weight for part, weight in zip(parts, weights, strict=True)]
    means, variances = ([getattr(part, name) for part in parts] for name in ("means", "variances"))
    mixture = Mixture(*(np.concatenate(each, axis=1) for each in (shares, means, variances)))
    size = line.size
    scaled = Mixture(mixture.weights, mixture.means * size, mixture.variances * size**2)
    outcomes = [
        Outcome(each.evidence, each.smooth.roughness, each.sizes is not None) for each in every
    ]
    return Averaged(kept, weights, scaled, outcomes)
