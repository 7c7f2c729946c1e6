"""Posterior of a function of time: all plausible models, weighted by their evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import NamedTuple

import attrs
import numpy as np
from scipy.linalg import block_diag
from scipy.special import softmax

from tvsysid.methods.adaptive.evidence import (
    FreeEstimate,
    SmoothFit,
    few_harmonics,
    size_covariances,
    switch_evidence,
)
from tvsysid.methods.adaptive.prior import (
    JITTERS,
    SWITCH_SIZES,
    Axis,
    SmoothPrior,
    smooth_priors,
)
from tvsysid.methods.adaptive.search import (
    CurveModel,
    Grid,
    first_model,
    propose_switches,
)
from tvsysid.numerics import Array
from tvsysid.numerics.bands import arc_length

MAX_MODELS = 32  # number of models in the mixture
MIN_WEIGHT = 0.002  # smallest weight of a model in the mixture
MAX_COMPONENTS = 48  # positions of a switch in the mixture, for a model that has all the weight
MAX_OFFSET = 0.26  # samples between switches up to which two sets of switches are the same
SMEAR_SPACING = 1 / 4  # samples between positions where smears are compared
MAX_LOSS = 3.0  # of log evidence against the usual low-pass, up to which another smear is averaged
BY_EVIDENCE = attrgetter("evidence")


class Mixture(NamedTuple):
    """Weights (component,) of normal distributions with means and variances (time, component)."""

    weights: Array
    means: Array
    variances: Array

    def mean(self) -> Array:
        """Return the mean of the mixture, shape (time,)."""
        return np.asarray(self.means @ self.weights)

    def variance(self) -> Array:
        """Return the variance of the mixture, shape (time,)."""
        apart = self.means - self.mean()[:, None]
        return np.asarray((self.variances + apart**2) @ self.weights)


class Hypothesis(NamedTuple):
    """A prior of the smooth part, and switches at positions in samples, smeared by an axis."""

    axis: Axis
    prior: SmoothPrior
    positions: Array


class OverTime(NamedTuple):
    """Posterior over time for sets of positions of switches.

    ``means`` and ``variances`` have shape (time, set). ``sizes`` (set, switch) are those of the
    switches, with a ``covariance``. The values depend on them by ``shapes`` (set, time, switch).
    """

    means: Array
    variances: Array
    sizes: Array
    covariance: Array
    shapes: Array

    @classmethod
    def of(cls, model: CurveModel, positions: Array) -> OverTime:
        """Return the posterior over time for sets of positions (set, switch) of the switches."""
        smooth, each, shape = model.smooth, positions.ravel(), positions.shape
        steps, true_steps = smooth.steps(each), smooth.estimate.axis.steps(each)
        shapes = true_steps - smooth.features @ steps.explained
        shapes = shapes.reshape(len(shapes), *shape).swapaxes(0, 1)
        gram = np.einsum("sisj->sij", steps.products(steps).reshape(2 * shape))
        balanced, size = divmod(model.size_prior, len(SWITCH_SIZES))
        covariance = size_covariances(gram)[size]
        if balanced:
            ones = covariance.sum(axis=-1, keepdims=True)
            covariance = covariance - ones @ ones.swapaxes(1, 2) / ones.sum(axis=1, keepdims=True)
        sizes = covariance @ steps.cross.reshape(*shape, 1)
        means = smooth.features @ smooth.mean + (shapes @ sizes)[..., 0]
        variances = np.sum(smooth.features**2, axis=1) + np.sum(
            shapes @ covariance * shapes, axis=2
        )
        return cls(means.T, variances.T, sizes[..., 0], covariance, shapes)


def components(model: CurveModel, weight: float, best: OverTime) -> Array:
    """Return means and variances of equal parts of the posterior, shape (2, time, component).

    The number of parts grows with the ``weight`` of the model. ``best`` has all switches at their
    most probable positions. The switch nearest to a time takes all its positions, the others stay
    there.
    """
    axis, own = model.smooth.estimate.axis, model.positions
    if not len(own):
        return np.stack([best.means, best.variances])
    apart = np.abs(axis.offset(np.arange(axis.times)[:, None], own))
    nearest, count = np.argmin(apart, axis=1), max(4, round(MAX_COMPONENTS * weight))
    out, shares = np.empty((2, axis.times, count)), (np.arange(count) + 0.5) / count
    for index, (window, probabilities) in enumerate(model.places):
        rows, positions = nearest == index, np.tile(own, (count, 1))
        # Each position stands for the same share of the probability.
        positions[:, index] = window[np.searchsorted(np.cumsum(probabilities)[:-1], shares)]
        moved = OverTime.of(model, positions)
        out[:, rows] = moved.means[rows], moved.variances[rows]
    if axis.jitter:
        out[1] += axis.jitter_variance(own) @ best.sizes.T**2
    return out


@attrs.frozen(eq=False)
class ModelAverage:
    """CurveModels, the best first, and the mixture of those that count, with their weights."""

    models: list[CurveModel]
    weights: Array
    over_time: list[OverTime]
    mixture: Mixture

    @classmethod
    def of(cls, models: list[CurveModel]) -> ModelAverage:
        """Return the posterior of all models."""
        models = sorted(models, key=BY_EVIDENCE, reverse=True)
        weights = softmax([each.evidence for each in models[:MAX_MODELS]])
        weights = weights[weights >= MIN_WEIGHT]
        weights /= weights.sum()
        kept, size = models[: len(weights)], models[0].smooth.estimate.size
        over_time = [OverTime.of(each, each.positions[None]) for each in kept]
        parts = list(map(components, kept, weights, over_time))
        counts = [part.shape[2] for part in parts]
        means, variances = np.concatenate(parts, axis=2)
        mixture = Mixture(np.repeat(weights / counts, counts), size * means, size**2 * variances)
        return cls(models, weights, over_time, mixture)

    def probability(self, wanted: Callable[[CurveModel], bool]) -> float:
        """Return the probability of all models of a kind together."""
        probabilities = softmax([each.evidence for each in self.models])
        return float(probabilities @ [wanted(each) for each in self.models])

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses that count, the most probable first."""
        return tuple(
            Hypothesis(each.smooth.estimate.axis, each.smooth.prior, each.positions)
            for each in self.models[: len(self.weights)]
        )

    def arc(self) -> float:
        """Return the length of the path of the scaled estimate, for simultaneous bands."""
        smooth, best = self.models[0].smooth, self.over_time[0]
        features = np.hstack([smooth.features, best.shapes[0]])
        return arc_length(features, block_diag(np.eye(len(smooth.mean)), best.covariance[0]))

    def parameters(self) -> float:
        """Return the best model's effective number of parameters: switches have size and time."""
        best = self.models[0]
        return best.smooth.posterior.effective + 2 * len(best.positions)


def average(estimate: FreeEstimate, known: Sequence[Hypothesis] = ()) -> ModelAverage:
    """Average all plausible models of a free estimate, weighted by their evidence.

    If there are ``known`` hypotheses, only these are averaged.

    A low-pass filter before sampling smears a step, and so do realizations that switch at different
    times. If there are steps, each smear is tried. The usual low-pass filter has a prior
    probability of 1/2. The best other smear is averaged with it unless the data exclude it.
    """
    if known:
        estimate = attrs.evolve(estimate, axis=known[0].axis)
        return ModelAverage.of(plausible(estimate, [each.prior for each in known], known))
    models = plausible(estimate)
    found = ModelAverage.of(models)
    best, usual = found.models[0], estimate.axis
    if found.probability(lambda each: not len(each.positions)) > 0.5:
        return found
    smears = [usual._replace(taps=0.0), *(usual._replace(jitter=jitter) for jitter in JITTERS)]
    smeared = [attrs.evolve(estimate, axis=axis) for axis in (*smears, usual)]
    fits = [SmoothFit(each, best.smooth.prior) for each in smeared]
    *totals, total = (best._replace(smooth=fit).refined(SMEAR_SPACING).total for fit in fits)
    log_prior = -math.log(len(smears))
    if max(totals) + log_prior < total - MAX_LOSS:
        return found
    priors = [each.prior for each in found.hypotheses]
    beside = plausible(smeared[totals.index(max(totals))], priors)
    beside = [each._replace(evidence=each.evidence + log_prior) for each in beside]
    return ModelAverage.of(models + beside)


def plausible(
    estimate: FreeEstimate,
    priors: Sequence[SmoothPrior] = (),
    known: Sequence[Hypothesis] = (),
) -> list[CurveModel]:
    """Return all plausible models, with steps smeared as the estimate's axis says.

    ``priors`` are those of the smooth part, by default all. Search for sets of switches, unless
    there are ``known`` hypotheses with these priors, or a constant has clearly more evidence than
    any first model.
    """
    given = {each.variances.tobytes(): each for each in priors or smooth_priors(estimate.axis)}
    fits = {key: SmoothFit(estimate, prior) for key, prior in given.items()}
    smooths = list(fits.values())
    if known:  # of hypotheses with the same switches, the most probable counts
        sets = {each.positions.tobytes(): each for each in reversed(known)}.values()
        proposals = [
            CurveModel(fits[each.prior.variances.tobytes()], each.positions) for each in sets
        ]
    else:
        grid = Grid(estimate)
        first = [first_model(smooth, grid) for smooth in smooths]
        clear = all(each.score < first[0].score - 1 for each in first[1:])
        if clear and not len(first[0].positions):
            return weighed(smooths, first[:1])
        proposals = propose_switches(first, grid)
    refined = [each.refined() for each in proposals]
    found = distinct(each for one in refined for each in (one, one.without_doubles()))
    if not priors:  # beside the best set of switches, and beside none
        models = sorted(weighed(smooths, found), key=BY_EVIDENCE)
        for best in {not len(each.positions): each for each in models}.values():
            sums = few_harmonics(estimate, best.positions)
            smooths += [SmoothFit(estimate, prior) for prior in sums]
    return weighed(smooths, found)


def distinct(sets: Iterable[CurveModel]) -> list[CurveModel]:
    """Return sets of switches without repetitions."""
    out: list[CurveModel] = []
    for switches in sets:
        own, offset = switches.positions, switches.smooth.estimate.axis.offset
        alike = (each.positions for each in out if len(each.positions) == len(own))
        if not any((np.abs(offset(each, own)) < MAX_OFFSET).all() for each in alike):
            out.append(switches)
    return out


def weighed(smooths: Sequence[SmoothFit], sets: Sequence[CurveModel]) -> list[CurveModel]:
    """Return every smooth part with every set of switches and every prior of their sizes."""
    estimate, out = smooths[0].estimate, list[CurveModel]()
    for switches in sets:
        steps = estimate.steps(switches.positions)
        beside = [smooth.beside(steps) for smooth in smooths]
        gram, cross = zip(*((each.products(each), each.cross) for each in beside), strict=True)
        evidence = switch_evidence(estimate.axis, np.array(gram), np.array(cross))
        evidence = evidence if len(switches.positions) else evidence[:1]
        log_prior = switches.log_volume - math.log(len(evidence))
        out += [
            switches._replace(smooth=smooth, size_prior=size_prior, evidence=float(value))
            for size_prior, row in enumerate(evidence + log_prior)
            for smooth, value in zip(smooths, row + [each.score for each in smooths], strict=True)
        ]
    return out
