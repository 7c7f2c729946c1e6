"""Basis functions of normalised time, with which time variation is described.

A basis is any callable from normalised time, shape (time,), to values, shape (time, function).
Its attribute ``periodic`` (False where there is none) says what normalised time is: from 0 at
the first to 1 at the last sample for a clamped basis; sample / samples, so that 1 is the next
period's 0, for a periodic one.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from typing import Any, ClassVar

import attrs
import numpy as np
import scipy
from numpy.polynomial.chebyshev import chebvander

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.validators import Validator, at_least, positive

Basis = Callable[[Array], Array]


def evaluate(basis: Basis, samples: int) -> Array:
    """Return values (time, function) of a basis over a realization of so many samples."""
    periodic = getattr(basis, "periodic", False)
    return np.asarray(basis(np.linspace(0.0, 1.0, samples, endpoint=not periodic)), dtype=float)


def chebyshev_of(values: Array, limits: tuple[float, float], count: int) -> Array:
    """Evaluate Chebyshev polynomials of degree 0 to count - 1.

    The values are mapped from their limits to -1 and 1. Values beyond the limits count as the
    nearer limit. The result has shape (..., polynomial).

    Examples
    --------
    >>> chebyshev_of(np.array([0.0, 1.0, 2.0, 5.0]), (0.0, 2.0), 3)
    array([[ 1., -1.,  1.],
           [ 1.,  0., -1.],
           [ 1.,  1.,  1.],
           [ 1.,  1.,  1.]])
    """
    low, high = limits
    mapped = np.clip((2 * values - low - high) / (high - low), -1.0, 1.0)
    return np.asarray(chebvander(mapped, count - 1))


A_BASIS = Validator(
    "a callable from normalised time to values, such as CubicBSplines(10)", callable
)


@attrs.frozen
class CubicBSplines:
    """Cubic B-splines on equal intervals, four functions at least.

    Of a ``periodic`` basis the last interval joins the first; otherwise the knots are clamped at
    both ends.

    Examples
    --------
    >>> CubicBSplines(10)(np.linspace(0, 1, 5)).sum(axis=1)  # a partition of unity
    array([1., 1., 1., 1., 1.])
    """

    functions: int = attrs.field(default=10, validator=at_least(4))
    periodic: bool = False

    def __call__(self, time: Array) -> Array:
        """Values at normalised times, shape (time, function)."""
        if self.periodic:
            step = 1.0 / self.functions
            knots = np.arange(-3, self.functions + 4) * step
            wide = scipy.interpolate.BSpline.design_matrix(time % 1.0, knots, 3).toarray()
            wide[:, :3] += wide[:, self.functions :]
            return wide[:, : self.functions]
        inner = np.linspace(0.0, 1.0, self.functions - 2)
        knots = np.concatenate([np.zeros(3), inner, np.ones(3)])
        return scipy.interpolate.BSpline.design_matrix(time, knots, 3).toarray()


@attrs.frozen
class GaussianBumps:
    """Gaussian bumps at equal distances; what the Kearney lab's toolbox uses.

    The ``width`` is their standard deviation in normalised time. The outer ones lie on the ends.
    """

    functions: int = attrs.field(default=10, validator=at_least(1))
    width: float = attrs.field(default=0.1, validator=positive)

    def __call__(self, time: Array) -> Array:
        """Values at normalised times, shape (time, function)."""
        distance = (time[:, None] - np.linspace(0.0, 1.0, self.functions)) / self.width
        return np.exp(-(distance**2) / 2) / math.sqrt(2 * math.pi * self.width)


@attrs.frozen
class HaarWavelets:
    """The constant and the first Haar wavelets: steps, for stiffness that switches.

    A power of two gives as many equal steps as functions.

    Examples
    --------
    >>> HaarWavelets(4)(np.array([0.0, 0.25, 0.5, 0.75]))
    array([[ 1.        ,  1.        ,  1.41421356,  0.        ],
           [ 1.        ,  1.        , -1.41421356,  0.        ],
           [ 1.        , -1.        ,  0.        ,  1.41421356],
           [ 1.        , -1.        ,  0.        , -1.41421356]])
    """

    functions: int = attrs.field(default=16, validator=at_least(1))
    periodic: ClassVar[bool] = True

    def __call__(self, time: Array) -> Array:
        """Values at normalised times, shape (time, function)."""
        time = time % 1.0
        values = np.ones((len(time), self.functions))
        for function in range(1, self.functions):
            scale = 2 ** (function.bit_length() - 1)
            phase = time * scale - (function - scale)
            sign = np.where(phase < 0.5, 1.0, -1.0)
            values[:, function] = np.where((phase >= 0) & (phase < 1), math.sqrt(scale) * sign, 0.0)
        return values


@attrs.frozen
class FourierSeries:
    """The constant, and a cosine and a sine for each harmonic of the period.

    These are 2 x harmonics + 1 functions.
    """

    harmonics: int = attrs.field(default=4, validator=at_least(0))
    periodic: ClassVar[bool] = True

    def __call__(self, time: Array) -> Array:
        """Values at normalised times, shape (time, function)."""
        phase = 2 * np.pi * time[:, None] * np.arange(1, self.harmonics + 1)
        waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(time), -1)
        return np.concatenate([np.ones((len(time), 1)), math.sqrt(2) * waves], axis=1)


@attrs.frozen
class ChebyshevPolynomials:
    """Chebyshev polynomials of the first kind over the realization.

    The highest degree is one less than the number of functions.
    """

    functions: int = attrs.field(default=10, validator=at_least(1))

    def __call__(self, time: Array) -> Array:
        """Values at normalised times, shape (time, function)."""
        return chebyshev_of(time, (0.0, 1.0), self.functions)


BASES = (CubicBSplines, GaussianBumps, HaarWavelets, FourierSeries, ChebyshevPolynomials)


def basis_from_text(text: str) -> Basis:
    """Basis from its ``repr``, by position or by name; nothing is executed.

    Examples
    --------
    >>> basis_from_text("CubicBSplines(functions=12, periodic=True)")
    CubicBSplines(functions=12, periodic=True)
    >>> basis_from_text("FourierSeries(3)")
    FourierSeries(harmonics=3)
    """
    known = {kind.__name__: kind for kind in BASES}
    try:
        call: Any = ast.parse(text.strip(), mode="eval").body
        values = [ast.literal_eval(value) for value in call.args]
        named = {word.arg: ast.literal_eval(word.value) for word in call.keywords}
        return known[call.func.id](*values, **named)
    except InputError:
        raise
    except (AttributeError, SyntaxError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"expected a basis such as CubicBSplines(functions=10), of {', '.join(known)}; got "
            f"{text!r}"
        ) from error
