"""Evidence for smooth parts and switches, by small matrices.

Nothing in this module depends on realizations.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dtrtrs

from tvsysid.methods.adaptive.prior import SIZES, Axis, Roughness
from tvsysid.numerics import Array

ROUNDING = 1e-10  # share of a matrix's trace that is rounding


def factor_of(matrix: Array) -> Array:
    """Return the Cholesky factor of a matrix.

    If the matrix is singular to rounding, its diagonal is raised a little first.
    """
    factor, failed = dpotrf(
        matrix, lower=1, clean=1
    )  # many are small: checks around it take longer than it does
    if failed:
        factor, failed = dpotrf(
            matrix + ROUNDING * np.trace(matrix) * np.eye(len(matrix)), lower=1, clean=1
        )
    if failed:
        raise np.linalg.LinAlgError("a matrix of products is not positive definite")
    return np.asarray(factor)


def inverse_of(matrix: Array) -> Array:
    """Return the inverse of a covariance."""
    scale = np.sqrt(np.diag(matrix))
    units = np.outer(scale, scale)
    lower = np.tril(dpotri(factor_of(matrix / units), lower=1)[0])
    return np.asarray((lower + np.tril(lower, -1).T) / units)


def solved_by(factor: Array, right: Array) -> Array:
    """Return the inverse of a Cholesky factor times an array."""
    return np.asarray(dtrtrs(factor, right, lower=1)[0])


@attrs.frozen(eq=False)
class Line:
    """Estimates ``seen`` at each time of an axis, with the ``precision`` (time, time) of errors.

    Both count in the mean ``size``.
    """

    axis: Axis
    seen: Array
    precision: Array
    size: float

    @classmethod
    def of(cls, axis: Axis, seen: Array, covariance: Array, size: float) -> Line:
        """Return the line of estimates with the covariance of their error."""
        return cls(axis, seen / size, inverse_of(covariance) * size**2, size)

    @cached_property
    def weighted(self) -> Array:
        """Return the precision times the estimates, shape (time,)."""
        return self.precision @ self.seen

    @cached_property
    def features(self) -> Array:
        """Return the features of the smooth part, shape (time, feature)."""
        return self.axis.features()

    @cached_property
    def gram(self) -> Array:
        """Return the features times the precision times the features."""
        return self.features.T @ (self.precision @ self.features)

    @cached_property
    def cross(self) -> Array:
        """Return the features times the weighted estimates."""
        return self.features.T @ self.weighted

    def columns(self, positions: Array) -> Columns:
        """Return steps at positions in samples, as they are recorded, with their products."""
        steps = self.axis.seen(positions)
        weighted = self.precision @ steps
        power = np.einsum("tc,tc->c", steps, weighted)
        return Columns(
            positions, steps, weighted, self.features.T @ weighted, power, steps.T @ self.weighted
        )


class Columns(NamedTuple):
    """Steps at ``positions`` as they are recorded, ``seen`` (time, step), and their products.

    ``weighted`` are the steps times the precision. Their products are ``features`` (feature, step)
    with the features, ``power`` (step,) with themselves, and ``cross`` (step,) with the estimates.
    """

    positions: Array
    seen: Array
    weighted: Array
    features: Array
    power: Array
    cross: Array

    def take(self, index: NDArray[np.intp] | slice) -> Columns:
        """Return some of the columns; a slice copies nothing."""
        return Columns(*(each[..., index] for each in self))


class Smooth:
    """A line explained by one smooth part.

    ``evidence`` is the log evidence relative to the empty model.
    """

    def __init__(self, line: Line, roughness: Roughness) -> None:
        self.line, self.roughness = line, roughness
        self.kept = np.flatnonzero(roughness.weights)
        self.root = np.sqrt(roughness.weights[self.kept])
        whole = len(self.kept) == len(roughness.weights)
        gram = line.gram if whole else line.gram[np.ix_(self.kept, self.kept)]
        system = gram * self.root[:, None] * self.root
        system.flat[:: len(system) + 1] += 1.0
        self.factor = factor_of(system)
        self.answer = self.solved(self.root * line.cross[self.kept])
        self.evidence = 0.5 * float(self.answer @ self.answer) - float(
            np.log(np.diag(self.factor)).sum()
        )

    @property
    def score(self) -> float:
        """Return the log evidence plus the log prior."""
        return self.evidence + self.roughness.log_prior

    @property
    def left(self) -> float:
        """Return the chi-square that the smooth part leaves."""
        return float(self.line.seen @ self.line.weighted - self.answer @ self.answer)

    def solved(self, right: Array) -> Array:
        """Return the inverse of the Cholesky factor times an array."""
        return solved_by(self.factor, right)

    def reduced(self, features: Array) -> Array:
        """Return the part of columns that the smooth part explains, shape (coefficient, column).

        ``features`` are the columns' products with the features.
        """
        return self.solved(self.root[:, None] * features[self.kept])

    def products(self, columns: Columns) -> Products:
        """Return the products of columns, less the part that the smooth part explains."""
        taken = self.reduced(columns.features)
        return Products(columns, taken, columns.cross - self.answer @ taken)

    @cached_property
    def spread(self) -> Array:
        """Return a factor of the smooth part's posterior covariance, shape (coefficient, time)."""
        return self.solved(self.root[:, None] * self.line.features[:, self.kept].T)


class Products(NamedTuple):
    """Columns beside a smooth part.

    ``taken`` (coefficient, column) is the part of them that the smooth part explains. ``cross`` are
    their products with the estimates that it leaves.
    """

    columns: Columns
    taken: Array
    cross: Array

    def diagonal(self) -> Array:
        """Return the squares of the columns, shape (column,)."""
        return np.asarray(self.columns.power - np.einsum("kc,kc->c", self.taken, self.taken))

    def between(self, other: Products) -> Array:
        """Return the products with other columns, shape (column, other)."""
        return np.asarray(self.columns.seen.T @ other.columns.weighted - self.taken.T @ other.taken)

    def take(self, index: NDArray[np.intp] | slice) -> Products:
        """Return the products of some columns."""
        return Products(self.columns.take(index), self.taken[:, index], self.cross[index])

    def put(self, place: int, other: Products, index: int) -> Products:
        """Return the products with one column replaced by another's."""
        out = self.take(np.arange(len(self.cross)))
        for mine, theirs in zip(
            (*out.columns, out.taken, out.cross),
            (*other.columns, other.taken, other.cross),
            strict=True,
        ):
            mine[..., place] = theirs[..., index]
        return out


class Sizes(NamedTuple):
    """Prior of the sizes of switches.

    ``spread`` is their standard deviation in mean sizes. ``balanced`` says whether the switches
    over a period add up to zero.
    """

    spread: float
    balanced: bool


@lru_cache(maxsize=4)
def every_sizes(periodic: bool) -> tuple[Sizes, ...]:
    """Return the priors of sizes; they are equally likely.

    If the interval is periodic, ramps between switches may cancel.
    """
    return tuple(
        Sizes(spread, balanced)
        for balanced in ((False, True) if periodic else (False,))
        for spread in SIZES
    )


@lru_cache(maxsize=64)
def directions(count: int, balanced: bool) -> Array:
    """Return orthonormal directions (switch, direction) of the sizes of ``count`` switches."""
    if not balanced:
        return np.eye(count)
    out = np.zeros((count, max(count - 1, 0)))
    for place in range(1, count):
        out[:place, place - 1], out[place, place - 1] = 1 / place, -1
        out[:, place - 1] /= np.sqrt(1 + 1 / place)
    return out


class Jumps(NamedTuple):
    """Log evidence for some switches, and posterior of their sizes."""

    evidence: float
    mean: Array
    covariance: Array


def jumps(gram: Array, cross: Array, sizes: Sizes) -> Jumps:
    """Return the evidence for switches, and their sizes, from products.

    ``gram`` (switch, switch) are the products of the switches with each other, ``cross`` (switch,)
    those with the estimates.
    """
    if sizes.balanced and len(cross) == 1:
        return Jumps(-np.inf, np.zeros(1), np.zeros((1, 1)))
    turn = directions(len(cross), sizes.balanced)
    system = turn.T @ gram @ turn
    system.flat[:: len(system) + 1] += sizes.spread**-2
    factor = factor_of(system)
    half = solved_by(factor, turn.T)
    answer = half @ cross
    log_determinant = 2 * float(np.log(np.diag(factor)).sum()) + 2 * len(system) * float(
        np.log(sizes.spread)
    )
    return Jumps(0.5 * float(answer @ answer) - 0.5 * log_determinant, answer @ half, half.T @ half)


def jumps_of_every_size(gram: Array, cross: Array, periodic: bool) -> Array:
    """Return the log evidence for switches (..., size) with each of :func:`every_sizes`.

    ``gram`` (..., switch, switch) are the products of switches with each other, ``cross`` (...,
    switch) those with the estimates. The eigenvalues of ``gram`` serve all sizes.
    """
    variance, out = np.square(SIZES)[:, None], []
    for balanced in (False, True) if periodic else (False,):
        turn = directions(cross.shape[-1], balanced)
        values, vectors = np.linalg.eigh(turn.T @ gram @ turn)
        answer = (cross @ turn)[..., None, :] @ vectors
        left = 1 + variance * np.maximum(values, 0.0)[..., None, :]
        found = 0.5 * np.sum(variance * answer**2 / left - np.log(left), axis=-1)
        out.append(found if turn.shape[1] else np.full(found.shape, -np.inf))
    return np.concatenate(out, axis=-1)


def one_more(
    own: Products,
    gram: Array,
    cross: Array,
    mixed: Array,
    power: Array,
    balanced: bool,
    spreads: tuple[float, ...],
) -> Array:
    """Return the log evidence (spread, column) for some switches and each other in turn.

    Rank-one updates add the others, one at a time. ``own`` are the products of the others with the
    estimates, ``power`` (column,) their squares, and ``mixed`` (column, switch) their products with
    the switches. The switches' own products are ``gram`` and ``cross``. The eigenvalues of ``gram``
    serve all ``spreads`` of :class:`Sizes`.
    """
    count, wanted = len(cross), own.cross
    if balanced and not count:
        return np.full((len(spreads), len(wanted)), -np.inf)
    turn = directions(count, balanced)
    turned = mixed @ turn
    if balanced:  # one switch more, and as much less of all others
        scale, mean = (1 + 1 / count) ** -0.5, np.full(count, 1 / count)
        power = (power - 2 * mixed @ mean + mean @ gram @ mean) * scale**2
        turned = ((mean @ gram - mixed) @ turn) * scale
        wanted = (mean @ cross - wanted) * scale
    values, vectors = np.linalg.eigh(turn.T @ gram @ turn)
    answer, turned = cross @ turn @ vectors, turned @ vectors
    variance = np.square(spreads)[:, None]
    taken = 1 + variance * np.maximum(values, 0.0)
    share = variance / taken
    before = 0.5 * np.sum(share * answer**2 - np.log(taken), axis=1, keepdims=True)
    left = 1 + variance * np.maximum(power - share @ (turned**2).T, 0.0)
    return np.asarray(
        before
        + 0.5 * variance * (wanted - share * answer @ turned.T) ** 2 / left
        - 0.5 * np.log(left)
    )
