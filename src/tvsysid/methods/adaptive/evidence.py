"""What the data say of a smooth part and of switches, by small matrices: nothing here knows of realizations."""

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
    """Cholesky factor; of a matrix that is singular to rounding, that of one that is not."""
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
    """Inverse of a covariance."""
    scale = np.sqrt(np.diag(matrix))
    units = np.outer(scale, scale)
    lower = np.tril(dpotri(factor_of(matrix / units), lower=1)[0])
    return np.asarray((lower + np.tril(lower, -1).T) / units)


def solved_by(factor: Array, right: Array) -> Array:
    """Inverse of a Cholesky factor times something."""
    return np.asarray(dtrtrs(factor, right, lower=1)[0])


@attrs.frozen(eq=False)
class Line:
    """Something ``seen`` at each time of an axis, with the ``precision`` (time, time) of its error.

    Both count in the mean ``size``.
    """

    axis: Axis
    seen: Array
    precision: Array
    size: float

    @classmethod
    def of(cls, axis: Axis, seen: Array, covariance: Array, size: float) -> Line:
        """Of what is seen, and the covariance of its error."""
        return cls(axis, seen / size, inverse_of(covariance) * size**2, size)

    @cached_property
    def weighted(self) -> Array:
        """Precision times what is seen, (time,)."""
        return self.precision @ self.seen

    @cached_property
    def features(self) -> Array:
        """Of the smooth part, (time, feature)."""
        return self.axis.features()

    @cached_property
    def gram(self) -> Array:
        """Features times the precision times features."""
        return self.features.T @ (self.precision @ self.features)

    @cached_property
    def cross(self) -> Array:
        """Features times what is seen, weighted."""
        return self.features.T @ self.weighted

    def columns(self, positions: Array) -> Columns:
        """Steps at positions in samples as they are seen, with their products."""
        steps = self.axis.seen(positions)
        weighted = self.precision @ steps
        power = np.einsum("tc,tc->c", steps, weighted)
        return Columns(
            positions, steps, weighted, self.features.T @ weighted, power, steps.T @ self.weighted
        )


class Columns(NamedTuple):
    """Steps at ``positions`` as they are ``seen`` (time, step), and their products.

    They are ``weighted`` with the precision, multiplied by the ``features`` (feature, step), by
    themselves as ``power`` (step,), and by what is seen, as ``cross`` (step,).
    """

    positions: Array
    seen: Array
    weighted: Array
    features: Array
    power: Array
    cross: Array

    def take(self, index: NDArray[np.intp] | slice) -> Columns:
        """Some of them; a slice copies nothing."""
        return Columns(*(each[..., index] for each in self))


class Smooth:
    """A line explained by one smooth part.

    ``evidence`` is its log, more than that of nothing at all.
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
        """Log evidence and prior."""
        return self.evidence + self.roughness.log_prior

    @property
    def left(self) -> float:
        """Return the chi-square that the smooth part leaves."""
        return float(self.line.seen @ self.line.weighted - self.answer @ self.answer)

    def solved(self, right: Array) -> Array:
        """Inverse of the Cholesky factor times something."""
        return solved_by(self.factor, right)

    def reduced(self, features: Array) -> Array:
        """What the smooth part takes of columns with these products with the features, (coefficient, column)."""
        return self.solved(self.root[:, None] * features[self.kept])

    def products(self, columns: Columns) -> Products:
        """Of columns, less what the smooth part takes."""
        taken = self.reduced(columns.features)
        return Products(columns, taken, columns.cross - self.answer @ taken)

    @cached_property
    def spread(self) -> Array:
        """Factor (coefficient, time) of the smooth part's posterior covariance."""
        return self.solved(self.root[:, None] * self.line.features[:, self.kept].T)


class Products(NamedTuple):
    """Columns beside a smooth part: what it takes of them (coefficient, column), and the ``cross`` that it leaves."""

    columns: Columns
    taken: Array
    cross: Array

    def diagonal(self) -> Array:
        """Squares of the columns (column,)."""
        return np.asarray(self.columns.power - np.einsum("kc,kc->c", self.taken, self.taken))

    def between(self, other: Products) -> Array:
        """Products with other columns (column, other)."""
        return np.asarray(self.columns.seen.T @ other.columns.weighted - self.taken.T @ other.taken)

    def take(self, index: NDArray[np.intp] | slice) -> Products:
        """Of some columns."""
        return Products(self.columns.take(index), self.taken[:, index], self.cross[index])

    def put(self, place: int, other: Products, index: int) -> Products:
        """With another's column in the place of one."""
        out = self.take(np.arange(len(self.cross)))
        for mine, theirs in zip(
            (*out.columns, out.taken, out.cross),
            (*other.columns, other.taken, other.cross),
            strict=True,
        ):
            mine[..., place] = theirs[..., index]
        return out


class Sizes(NamedTuple):
    """How large switches may be: standard deviation in mean sizes, and whether those over a period add up to zero."""

    spread: float
    balanced: bool


@lru_cache(maxsize=4)
def every_sizes(periodic: bool) -> tuple[Sizes, ...]:
    """Priors of sizes, equally likely.

    Where the end goes on at the beginning, ramps between switches may cancel.
    """
    return tuple(
        Sizes(spread, balanced)
        for balanced in ((False, True) if periodic else (False,))
        for spread in SIZES
    )


@lru_cache(maxsize=64)
def directions(count: int, balanced: bool) -> Array:
    """Orthonormal directions (switch, direction) of the sizes of so many switches."""
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
    """Of the products of switches with each other (switch, switch) and with what is seen."""
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
    """Log evidence for some switches (..., size) with each of :func:`every_sizes`.

    Of the products of switches with each other (..., switch, switch) and with what is seen (...,
    switch). The eigenvalues of their products serve all sizes.
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
    """Log evidence (spread, column) for some switches and each of many others in turn, by rank-one updates.

    The others' ``own`` products with what is seen, their squares ``power`` (column,), and those
    ``mixed`` with the switches (column, switch), whose own products are ``gram`` and ``cross``.
    The eigenvalues of these serve all ``spreads`` of :class:`Sizes`.
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
