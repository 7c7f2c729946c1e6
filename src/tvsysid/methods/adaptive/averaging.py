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
    search_switches,
)
from tvsysid.numerics import Array
from tvsysid.numerics.bands import arc_length

MAX_MODELS = 32  # number of models in the mixture
MIN_WEIGHT = 0.002  # smallest weight of a model in the mixture
MAX_COMPONENTS = 48  # positions of a switch in the mixture, for a model that has all the weight
MAX_OFFSET = 0.26  # samples between switches up to which two sets of switches are the same
SMEAR_SPACING = 1 / 4  # samples between positions where smears are compared
MAX_SMEAR_LOSS = 3.0  # loss of log evidence against the usual low-pass up to which a smear joins
BY_EVIDENCE = attrgetter("evidence")


class Mixture(NamedTuple):
    """Weights (component,) of normal distributions with means and variances (time, component)."""

    weights: Array
    means: Array
    variances: Array

    def mean(self) -> Array:
        """Return the mean of the mixture, shape (time,)."""
        return self.means @ self.weights

    def variance(self) -> Array:
        """Return the variance of the mixture, shape (time,)."""
        apart = self.means - self.mean()[:, None]
        return (self.variances + apart**2) @ self.weights


class Hypothesis(NamedTuple):
    """A prior of the smooth part, and switches at positions in samples on an axis."""

    axis: Axis
    prior: SmoothPrior
    positions: Array


class CurvePosterior(NamedTuple):
    """Posterior of the curve of a model, for several sets of exact positions of its switches.

    ``means`` and ``variances`` have shape (time, set). ``sizes`` (set, switch) are the posterior
    means of the switches' sizes, and ``covariance`` (set, switch, switch) is theirs. ``shapes``
    (set, time, switch) are what switches of size 1 add to the mean: a step, less what the smooth
    part would explain of it.
    """

    means: Array
    variances: Array
    sizes: Array
    covariance: Array
    shapes: Array

    @classmethod
    def of(cls, model: CurveModel, positions: Array) -> CurvePosterior:
        """Return the posterior over time for sets of positions (set, switch) of the switches."""
        smooth = model.smooth
        each = positions.ravel()
        shape = positions.shape
        steps = smooth.steps(each)
        true_steps = smooth.estimate.axis.steps(each)
        shapes = true_steps - smooth.features @ steps.explained
        shapes = shapes.reshape(len(shapes), *shape).swapaxes(0, 1)
        # Products of the switches within each set
        gram = np.einsum("sisj->sij", steps.products(steps).reshape(2 * shape))
        is_balanced, index = divmod(model.size_prior, len(SWITCH_SIZES))
        covariance = size_covariances(gram)[index]
        if is_balanced:  # given that the sizes add up to zero
            ones = covariance.sum(axis=-1, keepdims=True)
            covariance = covariance - ones @ ones.swapaxes(1, 2) / ones.sum(axis=1, keepdims=True)
        sizes = covariance @ steps.cross.reshape(*shape, 1)
        means = smooth.features @ smooth.mean + (shapes @ sizes)[..., 0]
        variances = np.sum(smooth.features**2, axis=1) + np.sum(
            shapes @ covariance * shapes, axis=2
        )
        return cls(means.T, variances.T, sizes[..., 0], covariance, shapes)


def components(model: CurveModel, weight: float, best: CurvePosterior) -> Array:
    """Return means and variances of equally probable components, shape (2, time, component).

    At each time, components differ in the position of the switch that is nearest to this time. The
    other switches are at their most probable positions. ``best`` is the posterior with all switches
    there. The number of components grows with the ``weight`` of the model.
    """
    axis = model.smooth.estimate.axis
    own = model.positions
    if not len(own):
        return np.stack([best.means, best.variances])
    apart = np.abs(axis.offset(np.arange(axis.times)[:, None], own))
    nearest = np.argmin(apart, axis=1)
    count = max(4, round(MAX_COMPONENTS * weight))
    out = np.empty((2, axis.times, count))
    shares = (np.arange(count) + 0.5) / count
    for index, (window, probabilities) in enumerate(model.possible_positions):
        rows = nearest == index
        positions = np.tile(own, (count, 1))
        quantiles = np.searchsorted(np.cumsum(probabilities)[:-1], shares)
        positions[:, index] = window[quantiles]
        moved = CurvePosterior.of(model, positions)
        out[:, rows] = moved.means[rows], moved.variances[rows]
    if axis.jitter:
        out[1] += axis.jitter_variance(own) @ best.sizes.T**2
    return out


@attrs.frozen(eq=False)
class ModelAverage:
    """All models, the best first, and the mixture of the first ones, which have ``weights``.

    ``curves`` are the posteriors of these models, with switches at their best positions. The
    mixture is in the quantity's unit.
    """

    models: list[CurveModel]
    weights: Array
    curves: list[CurvePosterior]
    mixture: Mixture

    @classmethod
    def of(cls, models: list[CurveModel]) -> ModelAverage:
        """Return the posterior of all models."""
        models = sorted(models, key=BY_EVIDENCE, reverse=True)
        weights = softmax([each.evidence for each in models[:MAX_MODELS]])
        weights = weights[weights >= MIN_WEIGHT]
        weights /= weights.sum()
        kept = models[: len(weights)]
        size = models[0].smooth.estimate.size
        curves = [CurvePosterior.of(each, each.positions[None]) for each in kept]
        parts = list(map(components, kept, weights, curves))
        counts = [part.shape[2] for part in parts]
        means, variances = np.concatenate(parts, axis=2)
        mixture = Mixture(np.repeat(weights / counts, counts), size * means, size**2 * variances)
        return cls(models, weights, curves, mixture)

    def probability(self, wanted: Callable[[CurveModel], bool]) -> float:
        """Return the probability of all models of a kind together."""
        probabilities = softmax([each.evidence for each in self.models])
        total = float(probabilities @ [wanted(each) for each in self.models])
        return min(total, 1.0)  # a sum may exceed 1 by rounding, and the rest would print as -0 %

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of the mixture, the most probable first."""
        return tuple(
            Hypothesis(each.smooth.estimate.axis, each.smooth.prior, each.positions)
            for each in self.models[: len(self.weights)]
        )

    def arc(self) -> float:
        """Return the length that widens simultaneous bands (``arc_length``), of the best model."""
        smooth = self.models[0].smooth
        best = self.curves[0]
        features = np.hstack([smooth.features, best.shapes[0]])
        return arc_length(features, block_diag(np.eye(len(smooth.mean)), best.covariance[0]))

    def parameters(self) -> float:
        """Return the best model's effective number of parameters. A switch has size and time."""
        best = self.models[0]
        return best.smooth.posterior.effective + 2 * len(best.positions)


def average(estimate: FreeEstimate, known: Sequence[Hypothesis] = ()) -> ModelAverage:
    """Average all plausible models of a free estimate, weighted by their evidence.

    Each prior of the smooth part is fitted without switches and with one. If a constant has clearly
    more evidence than any other of these models, there are no further ones. Otherwise, sets of
    switches are searched for, and every smooth part is combined with every set. Sums of few
    harmonics are then added to the smooth parts.

    If there are ``known`` hypotheses, nothing is searched for: their smooth parts are combined with
    their sets of switches.
    """
    if known:
        estimate = attrs.evolve(estimate, axis=known[0].axis)
        smooths = distinct_fits(estimate, known)
        # Switches are refined beside the smooth part of the most probable hypothesis with them.
        starts = {each.positions.tobytes(): each for each in reversed(known)}.values()
        rough = [CurveModel(SmoothFit(estimate, each.prior), each.positions) for each in starts]
        return ModelAverage.of(weigh(smooths, refined_sets(rough)))
    smooths = [SmoothFit(estimate, prior) for prior in smooth_priors(estimate.axis)]
    grid = Grid(estimate)
    first = [first_model(smooth, grid) for smooth in smooths]
    # The first of them has no smooth part.
    if first[0].is_constant() and all(each.score < first[0].score - 1 for each in first[1:]):
        return ModelAverage.of(weigh(smooths, first[:1]))
    sets = refined_sets(search_switches(first, grid))
    models = weigh(smooths, sets)
    # The last of each kind, with and without switches, is the best.
    best_of = {len(each.positions) > 0: each for each in sorted(models, key=BY_EVIDENCE)}
    for best in best_of.values():
        sums = few_harmonics(estimate, best.positions)
        models += weigh([SmoothFit(estimate, prior) for prior in sums], sets)
    found = ModelAverage.of(models)
    is_switching = found.probability(lambda each: len(each.positions) > 0) >= 0.5
    return with_other_smear(found, estimate) if is_switching else found


def distinct_fits(estimate: FreeEstimate, hypotheses: Iterable[Hypothesis]) -> list[SmoothFit]:
    """Fit the smooth parts of all hypotheses, those with the same variances only once."""
    distinct = {each.prior.variances.tobytes(): each.prior for each in hypotheses}
    return [SmoothFit(estimate, prior) for prior in distinct.values()]


def refined_sets(rough: Iterable[CurveModel]) -> list[CurveModel]:
    """Refine sets of switches. Return each of the resulting sets once.

    A set in which two close switches represent one is returned without the second, too.
    """
    out: list[CurveModel] = []
    for each in rough:
        refined = each.refined()
        for switches in (refined, refined.without_doubles()):
            own = switches.positions
            offset = switches.smooth.estimate.axis.offset
            as_many = (known.positions for known in out if len(known.positions) == len(own))
            if not any((np.abs(offset(known, own)) < MAX_OFFSET).all() for known in as_many):
                out.append(switches)
    return out


def with_other_smear(found: ModelAverage, estimate: FreeEstimate) -> ModelAverage:
    """Average also models whose steps are smeared in another way, unless the data exclude that.

    Usually, a low-pass filter before sampling smears a step. There may be none, or realizations may
    switch at different times. All of these together have the prior probability of the usual filter.
    Only the best of them is averaged.
    """
    usual, best = estimate.axis, found.models[0]
    jittered = (usual._replace(jitter=jitter) for jitter in JITTERS)
    smears = [usual._replace(filter_reach=0.0), *jittered]
    smeared = [attrs.evolve(estimate, axis=axis, similar=estimate) for axis in smears]
    fits = [SmoothFit(each, best.smooth.prior) for each in smeared]
    totals = [best._replace(smooth=fit).refined(SMEAR_SPACING).total for fit in fits]
    log_prior = -math.log(len(smears))
    if max(totals) + log_prior < best.refined(SMEAR_SPACING).total - MAX_SMEAR_LOSS:
        return found
    other = smeared[totals.index(max(totals))]
    smooths = distinct_fits(other, found.hypotheses)
    grid = Grid(other)
    sets = refined_sets(search_switches([first_model(each, grid) for each in smooths], grid))
    models = [each._replace(evidence=each.evidence + log_prior) for each in weigh(smooths, sets)]
    return ModelAverage.of(found.models + models)


def weigh(smooths: Sequence[SmoothFit], sets: Iterable[CurveModel]) -> list[CurveModel]:
    """Return the models of every smooth part, set and size prior, with their evidence."""
    estimate = smooths[0].estimate
    out = list[CurveModel]()
    for switches in sets:
        steps = estimate.steps(switches.positions)
        beside = [smooth.beside(steps) for smooth in smooths]
        gram = np.array([each.products(each) for each in beside])
        cross = np.array([each.cross for each in beside])
        evidence = switch_evidence(estimate.axis, gram, cross)
        if not len(switches.positions):  # all size priors are the same
            evidence = evidence[:1]
        log_prior = switches.log_volume - math.log(len(evidence))
        out += [
            switches._replace(smooth=smooth, size_prior=size_prior, evidence=float(value))
            for size_prior, row in enumerate(evidence + log_prior)
            for smooth, value in zip(smooths, row + [each.score for each in smooths], strict=True)
        ]
    return out
