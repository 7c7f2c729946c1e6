"""Build estimates of a joint's impedance. Their standard errors are computed when needed."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Protocol

import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.models import IMPEDANCE, Estimate, StandardError
from tvsysid.numerics import Array


class ErrorStatistics(Hashable, Protocol):
    """Small arrays from which standard errors are computed."""

    def standard_errors(self) -> Mapping[str, StandardError]:
        """Return the standard errors of a model's estimates, by quantity."""
        ...  # pragma: no cover


Errors = ErrorStatistics | Mapping[str, StandardError]


def impedance_estimates(
    stiffness: Array, viscosity: Array, inertia: Array, errors: Errors
) -> dict[str, Estimate]:
    """Return estimates of stiffness, viscosity and inertia over time.

    The statistics of their errors are kept, and evaluated when a band is first needed.
    """
    return {
        name: Estimate(
            values,
            UNITS[name],
            error=errors.get(name)
            if isinstance(errors, Mapping)
            else partial(_error_of, errors, name),
        )
        for name, values in zip(IMPEDANCE, (stiffness, viscosity, inertia), strict=True)
    }


def _error_of(statistics: ErrorStatistics, quantity: str) -> StandardError | None:
    return _standard_errors(statistics).get(quantity)


@lru_cache(maxsize=16)
def _standard_errors(statistics: ErrorStatistics) -> Mapping[str, StandardError]:
    """Compute the standard errors of all quantities together, once."""
    return statistics.standard_errors()


def standard_errors(
    values: Array, freedom: Array, arcs: Sequence[float] = (np.inf,) * 3, absent: str = ""
) -> dict[str, StandardError]:
    """Return standard errors of stiffness, viscosity and inertia from arrays (time, 3)."""
    columns = zip(values.T, freedom.T, arcs, strict=True)
    return {
        name: StandardError(*column, absent)
        for name, column in zip(IMPEDANCE, columns, strict=True)
    }


def no_errors(times: int, why: str) -> dict[str, StandardError]:
    """Return unknown standard errors of stiffness, viscosity and inertia, with the reason."""
    return dict.fromkeys(IMPEDANCE, StandardError.none(times, why))
