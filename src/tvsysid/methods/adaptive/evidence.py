r"""Evidence for smooth parts and switches, by small matrices.

An estimate z that is free at each time, with the covariance N of its error, is explained by a
smooth part and by switches,

.. math:: z = F w + H \Delta + e, \qquad w \sim N(0, V), \quad \Delta \sim N(0, \tau^2),
          \quad e \sim N(0, N)

Each combination of a smooth prior V, positions of switches (columns of H) and their size
:math:`\tau` has an evidence: the probability of z with w and :math:`\Delta` integrated out. A
smooth part that changes faster explains more, but its prior is spread over more functions. So
the evidence decides how fast stiffness may change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from operator import attrgetter
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.adaptive.prior import (
    AMPLITUDES,
    LEVEL,
    SWITCH_SIZES,
    USUAL_SWITCH_SIZE,
    Axis,
    SmoothPrior,
    fourier_features,
    smooth_priors,
)
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments, solve

MIN_DISTANCE = 1.0  # samples between two switches
MAX_HARMONIC = 12  # highest harmonic in a sum of few
MAX_WAVES = 8  # number of cosines and sines in such a sum
WAVES_PROBABILITY = 0.1  # prior weight of all such sums, besides the 1 of ``smooth_priors``
WAVE_ODDS = 1 / 20  # prior odds that a cosine or a sine is in the sum


class Steps(NamedTuple):
    """Unit steps at ``positions``, and what is left of them beside a smooth part.

    ``columns`` (time, step) are the steps as they are recorded, whitened by the noise.
    ``feature_products`` (feature, step) are their products with the features of the smooth part,
    ``explained`` (coefficient, step) those with the standardized features of a :class:`SmoothFit`,
    without rows before a fit. What is left of the steps has the products
    columnsᵀ columns - explainedᵀ explained. ``power`` (step,) are the squares of what is left, and
    ``cross`` (step,) its products with the estimate.
    """

    positions: Array
    columns: Array
    feature_products: Array
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
        return self.columns.T @ other.columns - self.explained.T @ other.explained


@attrs.frozen(eq=False)
class FreeEstimate:
    """Estimate of a function at each time of an axis, divided by its mean ``size``.

    ``whitener`` (time, time) makes its error white, with unit variance.
    """

    axis: Axis
    values: Array
    whitener: Array
    size: float
    similar: FreeEstimate | None = None  # one that differs by the smear of steps alone

    @cached_property
    def features(self) -> Array:
        """Features of the smooth part, shape (time, feature)."""
        return fourier_features(self.axis)

    @cached_property
    def white(self) -> Array:
        """Features and, as the last column, values; all whitened by the noise."""
        if self.similar is not None:
            return self.similar.white
        return self.whitener @ np.column_stack([self.features, self.values])

    @cached_property
    def moments(self) -> Moments:
        """Moments of the whitened features and values."""
        if self.similar is not None:
            return self.similar.moments
        return Moments.of(self.white.T @ self.white, len(self.values))

    def with_misfit(self) -> FreeEstimate:
        """Return the estimate with errors scaled up to explain the residual of a smooth part.

        The smooth part is the most probable one without switches.
        """
        smooths = (SmoothFit(self, prior) for prior in smooth_priors(self.axis))
        posterior = max(smooths, key=attrgetter("score")).posterior
        misfit = max(posterior.residual / (posterior.number - posterior.effective), 1.0)
        return attrs.evolve(self, whitener=self.whitener / math.sqrt(misfit))

    def steps(self, positions: Array) -> Steps:
        """Return steps at positions, before any smooth part is fitted."""
        columns = self.whitener @ self.axis.steps(positions, recorded=True)
        products = self.white.T @ columns
        none = np.zeros((0, len(positions)))
        power = np.sum(columns**2, axis=0)
        return Steps(positions, columns, products[:-1], none, power, products[-1])

    @cached_property
    def steps_around(self) -> Callable[[int, float, float], Steps]:
        """Function that returns steps on a grid around a sample, of a given spacing and reach.

        Its cache lives as long as the estimate.
        """

        @cache
        def steps(centre: int, spacing: float, reach: float) -> Steps:
            axis = self.axis
            count = round(reach / spacing)
            positions = centre + spacing * np.arange(-count, count + 1.0)
            if axis.periodic:
                return self.steps(np.mod(positions, axis.times))
            return self.steps(positions[(positions > 0) & (positions <= axis.times - 1)])

        return steps


class SmoothFit:
    """Free estimate explained by a constant and a smooth part with one prior.

    The features are standardized: they are combined so that the posterior covariance of their
    coefficients is the identity. ``mean`` (coefficient,) is the posterior mean of these
    coefficients. ``score`` is the log evidence plus the log prior, relative to the log evidence
    of noise alone.
    """

    def __init__(self, estimate: FreeEstimate, prior: SmoothPrior) -> None:
        self.estimate, self.prior = estimate, prior
        self._kept = np.flatnonzero(prior.variances)
        self.posterior = solve(estimate.moments.take(self._kept), 1 / prior.variances[self._kept])
        self.mean = self.standardized(estimate.moments.cross)
        explained = float(self.mean @ self.mean)
        self.score = prior.log_prior + 0.5 * (explained - self.posterior.log_determinant)

    def standardized(self, products: Array) -> Array:
        """Turn products with features (feature, ...) into those with standardized ones."""
        return self.posterior.inverse_factor @ products[self._kept]

    @cached_property
    def features(self) -> Array:
        """Standardized features, shape (time, coefficient)."""
        return self.standardized(self.estimate.features.T).T

    def steps(self, positions: Array) -> Steps:
        """Return steps at positions beside the smooth part."""
        return self.beside(self.estimate.steps(positions))

    def beside(self, steps: Steps) -> Steps:
        """Return steps with what is left of them beside the smooth part."""
        explained = self.standardized(steps.feature_products)
        return steps._replace(
            explained=explained,
            power=steps.power - np.sum(explained**2, axis=0),
            cross=steps.cross - self.mean @ explained,
        )

    def scores_of(self, switches: Steps) -> Array:
        """Return the score with switches for each prior of their sizes, shape (size prior,)."""
        gram = switches.products(switches)[None]
        cross = switches.cross[None]
        return self.score + switch_evidence(self.estimate.axis, gram, cross)[:, 0]

    def scores_with(self, switches: Steps, further: Steps) -> Array:
        """Return the scores with switches and each further one, shape (size prior, further).

        They are -inf where a further switch is too close.
        """
        axis = self.estimate.axis
        gram = switches.products(switches)[None]
        more = switches.products(further), further.power, further.cross
        evidence = switch_evidence(axis, gram, switches.cross[None], more)
        distances = np.abs(axis.offset(switches.positions[:, None], further.positions))
        return np.where((distances < MIN_DISTANCE).any(axis=0), -np.inf, self.score + evidence)


def column_evidence(power: Array, cross: Array, variance: float | Array) -> Array:
    """Return the log evidence for a column whose coefficient has a prior variance.

    ``power`` is the square of what is left of the column, ``cross`` its product with the estimate.
    """
    ratio = 1 + variance * np.maximum(power, 0.0)
    return 0.5 * (variance * cross**2 / ratio - np.log(ratio))


def size_covariances(gram: Array) -> Array:
    """Return the posterior covariance of the sizes of switches for each of their prior variances.

    ``gram`` (set, switch, switch) are the products of the switches with each other. The result has
    shape (variance, set, switch, switch).
    """
    prior = np.multiply.outer(np.square(SWITCH_SIZES) ** -1.0, np.eye(gram.shape[-1]))
    return np.asarray(np.linalg.inv(gram + prior[:, None]), dtype=np.float64)


def switch_evidence(
    axis: Axis, gram: Array, cross: Array, further: tuple[Array, Array, Array] | None = None
) -> Array:
    r"""Return the log evidence for sets of switches, shape (size prior, set).

    It is relative to that without switches, and includes the prior of the positions: all times
    are equally likely. With G the ``gram`` of n switches, g = ``cross``, and a prior variance
    :math:`\tau^2` of each size, one of three,

    .. math:: \log p = \tfrac12 \left(g^T A^{-1} g - \log|A| - n \log \tau^2\right), \qquad
              A = G + \tau^{-2} 1

    On a periodic axis, three more rows follow, for priors of sizes that add up to zero (balanced).
    For them, p is multiplied by the density of the sum at zero, posterior over prior. Both are
    normal, with means :math:`1^T A^{-1} g` and 0, and variances :math:`1^T A^{-1} 1` and
    :math:`n \tau^2`.

    Parameters
    ----------
    gram, cross
        Products of the switches with each other (set, switch, switch), and with the estimate (set,
        switch).
    further
        Candidates for one more switch, added to a single set. The result then has a column for each
        candidate. Their products with that set (switch, candidate), their squares (candidate,), and
        their products with the estimate (candidate,). They update all terms by a row and a column
        of A.
    """
    prior_precision = np.square(SWITCH_SIZES)[:, None] ** -1.0
    count = cross.shape[-1]
    covariance = size_covariances(gram)  # A⁻¹
    mean = (covariance @ cross[..., None])[..., 0]  # A⁻¹ g
    row_sums = covariance.sum(axis=-1)  # A⁻¹ 1
    square = np.sum(mean * cross, axis=-1)  # gᵀ A⁻¹ g
    total = mean.sum(axis=-1)  # 1ᵀ A⁻¹ g
    variance = row_sums.sum(axis=-1)  # 1ᵀ A⁻¹ 1
    log_determinant = -np.linalg.slogdet(covariance)[1]  # log |A|
    if further is not None:
        mixed, power, own_cross = further
        count += 1
        # The same terms for A with one more row and column; its Schur complement is ``precision``
        explained = np.sum(covariance[:, 0] @ mixed * mixed, axis=1)
        precision = np.maximum(power - explained, 0.0) + prior_precision
        own_cross = own_cross - mean[:, 0] @ mixed
        own_one = 1 - row_sums[:, 0] @ mixed
        square = square + own_cross**2 / precision
        total = total + own_cross * own_one / precision
        variance = variance + own_one**2 / precision
        log_determinant = log_determinant + np.log(precision)
    free = 0.5 * (square - log_determinant + count * np.log(prior_precision))
    free -= count * math.log(axis.times)
    if not axis.periodic:
        return free
    if count < 2:  # the size of a single balanced switch is 0, so it has no evidence
        return np.concatenate([free, np.full_like(free, -np.inf)])
    log_loss = 0.5 * (total**2 / variance + np.log(variance * prior_precision / count))
    return np.concatenate([free, free - log_loss])


def few_harmonics(estimate: FreeEstimate, positions: Array) -> Iterator[SmoothPrior]:
    """Yield priors of sums of one, two and more cosines and sines beside switches at ``positions``.

    Each sum extends the previous one by the cosine or sine with the most evidence. The prior
    standard deviation of the new coefficient is one of AMPLITUDES.
    """
    columns = np.hstack([estimate.steps(positions).columns, estimate.white])
    moments = Moments.of(columns.T @ columns, len(columns))
    first = len(positions)  # the columns are switches, constant, waves, estimate
    variances = np.zeros(columns.shape[1] - 1)
    variances[:first] = USUAL_SWITCH_SIZE**2
    variances[first] = LEVEL**2
    count = 2 * min(MAX_HARMONIC, estimate.axis.harmonics)
    waves = slice(first + 1, first + 1 + count)
    wave_variances = np.square(AMPLITUDES)[:, None]
    log_prior = math.log(WAVES_PROBABILITY) - count * math.log1p(WAVE_ODDS)
    for _ in range(min(MAX_WAVES, count)):
        own = np.flatnonzero(variances)
        fit = solve(moments.take(own), 1 / variances[own])
        mixed = moments.gram[own, waves]
        explained = fit.inverse_factor @ mixed
        power = moments.gram.diagonal()[waves] - np.sum(explained**2, axis=0)
        evidence = column_evidence(power, moments.cross[waves] - fit.mean @ mixed, wave_variances)
        evidence[:, variances[waves] > 0] = -np.inf
        size, wave = np.unravel_index(np.argmax(evidence), evidence.shape)
        variances[waves.start + wave] = wave_variances[size, 0]
        log_prior += math.log(WAVE_ODDS / len(wave_variances))
        yield SmoothPrior(log_prior, variances[first:].copy())
