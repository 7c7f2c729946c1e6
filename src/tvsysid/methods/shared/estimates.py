"""Build estimates of a joint's impedance with their standard errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.dataset_layout import UNITS
from tvsysid.models import IMPEDANCE, Estimate, StandardError
from tvsysid.numerics import Array


def impedance_estimates(
    impedance: Array, errors: Mapping[str, StandardError]
) -> dict[str, Estimate]:
    """Return estimates of stiffness, viscosity and inertia over time from an array (time, 3)."""
    return {
        name: Estimate(values, UNITS[name], error=errors.get(name))
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
