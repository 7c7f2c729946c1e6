"""Build estimates of a joint's impedance. Their standard errors are computed when needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.dataset_layout import UNITS
from tvsysid.models import IMPEDANCE, Estimate, StandardError
from tvsysid.numerics import Array

# Standard errors by quantity, or a hashable function that computes all of them from small arrays.
Errors = Mapping[str, StandardError] | Callable[[], Mapping[str, StandardError]]


def impedance_estimates(impedance: Array, errors: Errors) -> dict[str, Estimate]:
    """Return estimates of stiffness, viscosity and inertia over time from an array (time, 3).

    A function that computes the errors is kept, and called when a band is first needed.
    """
    return {
        name: Estimate(
            values,
            UNITS[name],
            error=errors.get(name) if isinstance(errors, Mapping) else partial(_of, errors, name),
        )
        for name, values in zip(IMPEDANCE, impedance.T, strict=True)
    }


def _of(errors: Callable[[], Mapping[str, StandardError]], quantity: str) -> StandardError:
    return _computed(errors)[quantity]


@lru_cache(maxsize=16)
def _computed(errors: Callable[[], Mapping[str, StandardError]]) -> Mapping[str, StandardError]:
    """Compute the standard errors of all quantities together, once."""
    return errors()


def standard_errors(
    values: Array, freedom: ArrayLike, arcs: Sequence[float] = (np.inf,) * 3, absent: str = ""
) -> dict[str, StandardError]:
    """Return standard errors of stiffness, viscosity and inertia from arrays (time, 3)."""
    columns = zip(values.T, np.broadcast_to(freedom, values.shape).T, arcs, strict=True)
    return {
        name: StandardError(*column, absent)
        for name, column in zip(IMPEDANCE, columns, strict=True)
    }
