"""Mixtures of normal distributions: the posterior at each time, of one candidate or of all."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.adaptive.evidence import Jumps, Products, Sizes, Smooth, directions, jumps
from tvsysid.methods.adaptive.placing import Placed, distance
from tvsysid.methods.adaptive.prior import Axis, Roughness
from tvsysid.numerics import Array

LIGHTEST = 0.002  # weight of a model, and share of a position's, that count
MOST_POSITIONS = 24  # of a switch, in a model that has all the weight


class Hypothesis(NamedTuple):
    """A smooth part, and switches at positions in samples, smeared as an axis says."""

    axis: Axis
    roughness: Roughness
    positions: Array


class Candidate(NamedTuple):
    """A smooth part, switches and the prior of their sizes.

    ``evidence`` is the log evidence, including the prior.
    """

    smooth: Smooth
    evidence: float
    placed: Placed
    sizes: Sizes | None


class Mixture(NamedTuple):
    """Weights, means, variances of normal distributions at each time, (time, component)."""

    weights: Array
    means: Array
    variances: Array

    def mean(self) -> Array:
        """Return the mean of the mixture, shape (time,)."""
        return np.asarray(np.einsum("tc,tc->t", self.weights, self.means))

    def above(self, least: float) -> Mixture:
        """Return the same distributions with no mean below ``least``."""
        return self._replace(means=np.maximum(self.means, least))

    def variance(self) -> Array:
        """Return the variance of the mixture, shape (time,)."""
        apart = self.means - self.mean()[:, None]
        return np.asarray(np.einsum("tc,tc->t", self.weights, self.variances + apart**2))


class Path(NamedTuple):
    """Posterior of a candidate whose switches lie at their modes.

    It has a ``mean`` (time,) and a ``factor`` of the covariance (time, coefficient).
    """

    mean: Array
    factor: Array
    found: Jumps
    products: Products
    answers: Array


def path(candidate: Candidate) -> Path:
    """Return the posterior over time; its covariance is ``factor @ factor.T``."""
    smooth, placed = candidate.smooth, candidate.placed
    mean, products = smooth.answer @ smooth.spread, smooth.products(placed.columns)
    if candidate.sizes is None:
        none = Jumps(0.0, np.zeros(0), np.zeros((0, 0)))
        return Path(mean, smooth.spread.T, none, products, np.zeros((len(mean), 0)))
    found = jumps(products.between(products), products.cross, candidate.sizes)
    answers = smooth.line.axis.steps(placed.positions) - smooth.spread.T @ products.taken
    values, vectors = np.linalg.eigh(found.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return Path(
        mean + answers @ found.mean,
        np.concatenate([smooth.spread.T, answers @ root], axis=1),
        found,
        products,
        answers,
    )


def mixture_of(candidate: Candidate, weight: float) -> Mixture:
    """Return the mixture of a candidate at each time.

    The nearest switch takes all its positions. The others lie at their modes.
    """
    own, placed = path(candidate), candidate.placed
    times = len(own.mean)
    variance = np.einsum("tc,tc->t", own.factor, own.factor)
    if candidate.sizes is None:
        return Mixture(np.ones((times, 1)), own.mean[:, None], variance[:, None])
    uneven = candidate.smooth.line.axis.uneven(placed.positions) @ own.found.mean**2
    most = max(4, round(MOST_POSITIONS * weight))
    nearest = np.argmin(
        [
            distance(candidate.smooth.line, np.arange(float(times)), position)
            for position in placed.positions
        ],
        axis=0,
    )
    parts = []
    for place in range(len(placed.positions)):
        window, share = thinned(placed.windows[place], placed.shares[place], most)
        rows = np.flatnonzero(nearest == place)
        means, variances = _moved(candidate, own, place, window, rows)
        parts.append((rows, share, means, variances + uneven[rows, None]))
    widest = max(len(share) for _, share, _, _ in parts)
    out = Mixture(*(np.zeros((times, widest)), np.zeros((times, widest)), np.ones((times, widest))))
    for rows, share, means, variances in parts:
        for target, values in zip(
            out, (np.broadcast_to(share, means.shape), means, variances), strict=True
        ):
            target[rows, : len(share)] = values
    return out


def thinned(window: Array, share: Array, most: int) -> tuple[Array, Array]:
    """Thin positions to at most ``most``, each of which represents its neighbours."""
    kept = np.flatnonzero(share > LIGHTEST)
    if not len(kept):
        kept = np.array([int(np.argmax(share))])
    group = np.minimum(
        (np.cumsum(share[kept]) - share[kept] / 2) / share[kept].sum() * most, most - 1
    ).astype(int)
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    best = [part[np.argmax(share[part])] for part in np.split(kept, starts[1:])]
    weights = np.add.reduceat(share[kept], starts)
    return window[best], weights / weights.sum()


def _moved(
    candidate: Candidate, own: Path, place: int, window: Array, rows: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return means and variances (row, position) with one switch moved through a window.

    The other switches stay at their modes.
    """
    smooth, sizes, factor = candidate.smooth, candidate.sizes, candidate.smooth.spread.T[rows]
    assert sizes is not None
    modes, moving = own.products, smooth.products(smooth.line.columns(window))
    count, many = len(modes.cross), len(moving.cross)
    gram = np.repeat(modes.between(modes)[None], many, axis=0)
    between = moving.between(modes)
    gram[:, place], gram[:, :, place] = between, between
    gram[:, place, place] = moving.diagonal()
    cross = np.repeat(modes.cross[None], many, axis=0)
    cross[:, place] = moving.cross
    turn = directions(count, sizes.balanced)
    system = turn.T @ gram @ turn + np.eye(turn.shape[1]) / sizes.spread**2
    covariance = turn @ np.linalg.inv(system) @ turn.T
    answers = np.repeat(own.answers[None, rows], many, axis=0)
    answers[:, :, place] = (smooth.line.axis.steps(window)[rows] - factor @ moving.taken).T
    spread = answers @ covariance
    means = smooth.answer @ factor.T + (spread @ cross[:, :, None])[:, :, 0]
    base = np.einsum("rk,rk->r", factor, factor)
    return means.T, (base + np.einsum("mri,mri->mr", spread, answers)).T
