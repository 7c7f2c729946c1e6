"""Build estimates of a joint's impedance with their standard errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.dataset_layout import UNITS
from tvsysid.models import IMPEDANCE, Estimate, StandardError
from tvsysid.numerics import Array

# Standard errors by quantity, or a function that computes them when they are first needed.
Errors = Mapping[str, StandardError] | Callable[[], Mapping[str, StandardError]]


def impedance_estimates(impedance: Array, errors: Errors) -> dict[str, Estimate]:
    """Return estimates of stiffness, viscosity and inertia over time from an array (time, 3)."""
    computed = cache(errors if callable(errors) else lambda: errors)

    def of(name: str) -> StandardError | None:
        return computed().get(name)

    return {
        name: Estimate(values, UNITS[name], error=partial(of, name))
        for name, values in zip(IMPEDANCE, impedance.T, strict=True)
    }


def standard_errors(
    values: Array, freedom: ArrayLike, arcs: Sequence[float] = (np.inf,) * 3, absent: str = ""
) -> dict[str, StandardError]:
    """Return standard errors of stiffness, viscosity and inertia from arrays (time, 3)."""
    columns = zip(values.T, np.broadcast_to(freedom, values.shape).T, arcs, strict=True)
    return {
        name: StandardError(*column, absent)
        for name, column in zip(IMPEDANCE, columns, strict=True)
    }
