r"""Evidence for smooth parts and switches, by small matrices.

An estimate z that is free at each time, with the covariance N of its error, is explained by a
smooth part and by switches,

.. math:: z = F w + H \Delta + e, \qquad w \sim N(0, V), \quad \Delta \sim N(0, \tau^2),
          \quad e \sim N(0, N)

Each combination of a smooth prior V, positions of switches (columns of H) and their size
:math:`\tau` has an evidence: the probability of z with w and :math:`\Delta` integrated out. A
smooth part that changes faster explains more, but its evidence is spread over more functions. So
the evidence decides how fast stiffness may change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from operator import attrgetter
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.adaptive.prior import (
    AMPLITUDES,
    LEVEL,
    SWITCH_SIZES,
    Axis,
    SizePrior,
    SmoothPrior,
    fourier_features,
    smooth_priors,
)
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments, solve

MIN_DISTANCE = 1.0  # samples between two switches
MAX_HARMONIC, MAX_WAVES = 12, 8  # that is tried, and cosines and sines of a sum
WAVES_PROBABILITY = 0.1  # prior weight of all sums of harmonics; that of no smooth part is 0.5
FIRST_ODDS, SECOND_ODDS = 1 / 20, 2.0  # of a harmonic's cosine or sine, and then of the other one
STEP = 0.2  # standard deviation of the steps beside harmonics, in mean sizes


class Steps(NamedTuple):
    """Unit steps at ``positions``, and what a smooth part leaves of them.

    ``columns`` (time, step) are the steps as they are recorded, whitened by the noise. ``features``
    (feature, step) are their products with the features of the smooth part, ``explained``
    (coefficient, step) the part of them that the smooth part explains. ``power`` (step,) are the
    squares of what is left, and ``cross`` (step,) its products with the estimate.
    """

    positions: Array
    columns: Array
    features: Array
    explained: Array
    power: Array
    cross: Array

    def take(self, index: NDArray[np.intp] | slice) -> Steps:
        """Return some of the steps; a slice copies nothing."""
        return Steps(*(each[..., index] for each in self))

    def joined(self, other: Steps) -> Steps:
        """Return the steps, and other ones after them."""
        return Steps(*(np.concatenate(each, axis=-1) for each in zip(self, other, strict=True)))

    def products(self, other: Steps) -> Array:
        """Return the products of what is left with that of other steps, shape (step, other)."""
        return np.asarray(self.columns.T @ other.columns - self.explained.T @ other.explained)

    def log_evidence(self, periodic: bool) -> Array:
        """Return the log evidence for the steps together, shape (size prior,)."""
        return log_evidence(self.products(self)[None], self.cross[None], periodic)[:, 0]

    def log_evidence_with(self, further: Steps, axis: Axis) -> Array:
        """Return the log evidence for the steps and each further one, shape (size prior, further).

        It is -inf where a further step is too close.
        """
        more = further, self.products(further)
        evidence = log_evidence(self.products(self)[None], self.cross[None], axis.periodic, more)
        near = np.abs(axis.offset(self.positions[:, None], further.positions)) < MIN_DISTANCE
        return np.where(near.any(axis=0), -np.inf, evidence)


@attrs.frozen(eq=False)
class FreeEstimate:
    """Estimate at each time of an axis, in units of its mean ``size``.

    ``whitener`` (time, time) makes its error white, with unit variance.
    """

    axis: Axis
    values: Array
    whitener: Array
    size: float

    @cached_property
    def features(self) -> Array:
        """Features of the smooth part, shape (time, feature)."""
        return fourier_features(self.axis)

    @cached_property
    def white(self) -> Array:
        """Features, and the values last, whitened."""
        return np.asarray(self.whitener @ np.column_stack([self.features, self.values]))

    @cached_property
    def moments(self) -> Moments:
        """Moments of the whitened features and values."""
        return Moments.of(self.white.T @ self.white, len(self.white))

    def with_misfit(self) -> FreeEstimate:
        """Return the estimate with errors so large that they explain what a smooth part leaves.

        The smooth part is the most probable one without switches.
        """
        smooths = (SmoothFit(self, prior) for prior in smooth_priors(self.axis))
        misfit = max(smooths, key=attrgetter("score")).misfit
        return attrs.evolve(self, whitener=self.whitener / math.sqrt(max(misfit, 1.0)))

    def steps(self, positions: Array) -> Steps:
        """Return steps at positions, with their products."""
        columns = self.whitener @ self.axis.steps(positions, recorded=True)
        products = self.white.T @ columns
        return Steps(
            positions,
            columns,
            features=products[:-1],
            explained=np.zeros((0, len(positions))),
            power=np.einsum("tc,tc->c", columns, columns),
            cross=products[-1],
        )


class SmoothFit:
    """Free estimate explained by one smooth part.

    ``score`` is the log evidence relative to no smooth part and no constant, plus the log prior.
    ``mean`` (coefficient,) are the coefficients of the smooth part, in units in which their
    posterior is white.
    """

    def __init__(self, estimate: FreeEstimate, prior: SmoothPrior) -> None:
        self.estimate, self.prior = estimate, prior
        kept = np.flatnonzero(prior.variances)
        self._posterior = solve(estimate.moments.take(kept), 1 / prior.variances[kept])
        # The first harmonics are a slice, which copies nothing.
        self._kept = slice(len(kept)) if kept[-1] < len(kept) else kept
        self.mean = self.whitened(estimate.moments.cross)
        explained = float(self.mean @ self.mean)
        self.score = prior.log_prior + 0.5 * (explained - self._posterior.log_determinant)

    @property
    def misfit(self) -> float:
        """Variance of what the smooth part leaves, relative to that of the estimate's error."""
        return self._posterior.residual / (self._posterior.number - self._posterior.effective)

    def whitened(self, products: Array) -> Array:
        """Return products with the features in the units of ``mean``, shape (coefficient, ...)."""
        return np.asarray(self._posterior.inverse_factor @ products[self._kept])

    @cached_property
    def features(self) -> Array:
        """Features over time in the units of ``mean``, shape (time, coefficient)."""
        return self.whitened(self.estimate.features.T).T

    def steps(self, positions: Array) -> Steps:
        """Return what the smooth part leaves of steps at positions."""
        return self.beside(self.estimate.steps(positions))

    def beside(self, steps: Steps) -> Steps:
        """Return what the smooth part leaves of steps."""
        explained = self.whitened(steps.features)
        return steps._replace(
            explained=explained,
            power=steps.power - np.einsum("kc,kc->c", explained, explained),
            cross=steps.cross - self.mean @ explained,
        )

    def score_of(self, switches: Steps) -> float:
        """Return the score with switches, whose positions are equally likely beforehand."""
        axis = self.estimate.axis
        evidence = float(switches.log_evidence(axis.periodic).max())
        return self.score + evidence - len(switches.positions) * math.log(axis.times)


def log_evidence(
    gram: Array, cross: Array, periodic: bool, further: tuple[Steps, Array] | None = None
) -> Array:
    r"""Return the log evidence for sets of switches, shape (size prior, set).

    The priors are those of :func:`size_priors`. ``gram`` (set, switch, switch) are the products of
    the switches with each other, ``cross`` (set, switch) those with the estimate. With A the
    posterior precision of n switches' sizes, and b = ``cross``,

    .. math:: \log p = \tfrac12 \left(b^T A^{-1} b - \log|A| - n \log \tau^2\right), \qquad
              A = G + \tau^{-2} 1

    The eigenvalues of the Gram matrix G serve all priors. Balanced sizes have the condition that
    their sum is zero, whose posterior mean is :math:`1^T A^{-1} b`, and variance :math:`1^T A^{-1}
    1`. One switch more updates the formulas by a row and a column, so that there may be many
    ``further`` ones, each beside a single set. Their products with that set are the second part.
    """
    prior, count = np.square(SWITCH_SIZES)[:, None] ** -1.0, cross.shape[-1]
    values, vectors = np.linalg.eigh(gram)
    precision = np.maximum(values, 0.0) + prior[:, :, None]
    along, ones = (cross[:, None] @ vectors)[:, 0], vectors.sum(axis=1)
    square, total, variance = (
        np.sum(each / precision, axis=-1) for each in (along**2, along * ones, ones**2)
    )
    log_determinant = np.log(precision).sum(axis=-1)
    if further is not None:
        steps, count = further[0], count + 1
        mixed = vectors[0].T @ further[1]
        left = np.maximum(steps.power - (1 / precision[:, 0]) @ mixed**2, 0.0) + prior
        answer = steps.cross - (along / precision[:, 0]) @ mixed
        one = 1 - (ones / precision[:, 0]) @ mixed
        square, total = square + answer**2 / left, total + answer * one / left
        variance = variance + one**2 / left
        log_determinant = log_determinant + np.log(left)
    free = np.asarray(0.5 * (square - log_determinant + count * np.log(prior)))
    if not periodic:
        return free
    if count < 2:  # one balanced switch is none
        return np.concatenate([free, np.full(free.shape, -np.inf)])
    condition = total**2 / variance + np.log(variance * prior / count)
    return np.concatenate([free, free - 0.5 * condition])


def size_covariance(gram: Array, prior: SizePrior) -> Array:
    """Return the posterior covariance (..., switch, switch) of the sizes of switches."""
    inverse = np.linalg.inv(gram + np.eye(gram.shape[-1]) / prior.spread**2)
    if prior.balanced:
        ones = inverse.sum(axis=-1, keepdims=True)
        inverse = inverse - ones @ ones.swapaxes(-1, -2) / ones.sum(axis=-2, keepdims=True)
    return np.asarray(inverse)


def few_harmonics(estimate: FreeEstimate, positions: Array) -> Iterator[SmoothPrior]:
    """Yield priors of sums of few cosines and sines.

    The most evident one is added to a constant and steps at positions, again and again. Each has a
    standard deviation of its own, one of AMPLITUDES.
    """
    count = 2 * min(MAX_HARMONIC, estimate.axis.harmonics)
    columns, values = np.hsplit(estimate.white, [-1])
    both = np.hstack([columns[:, : count + 1], estimate.steps(positions).columns, values])
    moments, sizes = Moments.of(both.T @ both, len(both)), np.square(AMPLITUDES)[:, None]
    variances = np.r_[LEVEL**2, np.zeros(count), np.full(len(positions), STEP**2)]
    log_prior = math.log(WAVES_PROBABILITY)
    log_prior -= count / 2 * math.log1p(FIRST_ODDS * (2 + SECOND_ODDS))
    waves = variances[1 : count + 1]
    for _ in range(min(MAX_WAVES, count)):
        known = np.flatnonzero(variances)
        fit, gram = solve(moments.take(known), 1 / variances[known]), moments.gram[:, 1 : count + 1]
        explained = fit.inverse_factor @ gram[known]
        power = np.diag(gram[1:]) - np.sum(explained**2, axis=0)
        left = 1 + sizes * np.maximum(power, 0.0)
        cross = moments.cross[1 : count + 1] - fit.mean @ gram[known]
        has_other = waves.reshape(-1, 2)[:, ::-1].ravel() > 0
        odds = np.where(has_other, SECOND_ODDS, FIRST_ODDS) / len(sizes)
        evidence = np.log(odds) + 0.5 * (sizes * cross**2 / left - np.log(left))
        evidence[:, waves > 0] = -np.inf
        size, wave = np.unravel_index(np.argmax(evidence), evidence.shape)
        log_prior += math.log(odds[wave])
        waves[wave] = sizes[size, 0]
        rest = np.zeros(columns.shape[1] - count - 1)
        yield SmoothPrior(
            "few harmonics",
            amplitude=math.sqrt(waves.sum() / 2),
            length=estimate.axis.period / (np.flatnonzero(waves)[-1] // 2 + 1),
            log_prior=log_prior,
            variances=np.concatenate([variances[: count + 1], rest]),
        )
