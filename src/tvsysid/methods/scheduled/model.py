"""Model of a scheduled joint: its properties as polynomials in a variable."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import ArrayLike

from tvsysid.arrays import read_only
from tvsysid.dataset_layout import UNITS
from tvsysid.models import Estimate, Model, StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.signals import Array, Ensemble

GRID = 61  # values of the variable at which estimates are stated
REFLEXES = {"positive": 1, "negative": -1}  # of the velocity that drives a reflex


class Orders(NamedTuple):
    """Degrees of the polynomials of each part of the torque; -1 for a reflex that there is not.

    A reflex is driven by ``positive`` or by ``negative`` velocity.
    """

    rest: int
    intrinsic: int
    positive: int = -1
    negative: int = -1
    inertia: int = 0


class Part(NamedTuple):
    """Part of the torque that is linear in some coefficients.

    The ``regressors`` have the shape (signal, degree, realization, time). They are NaN where
    something was not recorded. ``quantities`` are weights (signal,) that turn the signals'
    coefficients into each quantity.
    """

    regressors: Array
    quantities: Mapping[str, Array]


Parts = dict[str, Part]  # by the names of Orders


class Curves(NamedTuple):
    """Quantities as Chebyshev polynomials in a variable, whose ``limits`` are mapped to -1 and 1.

    Each quantity has coefficients (degree,) and their covariance.
    """

    limits: tuple[float, float]
    quantities: Mapping[str, tuple[Array, Array]]
    freedom: float

    @property
    def grid(self) -> Array:
        """Values of the variable at which estimates are stated, and along which bands hold."""
        return np.linspace(*self.limits, GRID)

    def at(self, values: Array, axes: tuple[str, ...]) -> dict[str, Estimate]:
        """Return estimates at values of the variable, constant beyond its limits."""
        estimates = {}
        for name, (coefficients, covariance) in self.quantities.items():
            features, along = (
                chebyshev_of(each, self.limits, len(coefficients)) for each in (values, self.grid)
            )
            variance = np.einsum("...j,...j->...", features @ covariance, features)
            error = StandardError(
                np.sqrt(np.maximum(variance, 0.0)),
                np.array(self.freedom),
                arc_length(along, covariance),
            )
            estimates[name] = Estimate(features @ coefficients, UNITS[name], axes, error)
        return estimates


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ScheduledModel(Model):
    r"""Stiffness, viscosity, inertia and reflex gain as polynomials in a measured variable.

    The estimates named ``scheduled_stiffness`` and so on have an axis with the name of the
    variable's channel, and values of the variable as coordinates. ``stiffness`` and so on are the
    estimates at each time of each realization. The ``coefficients`` (coefficient,) are those of the
    ``parts`` of the torque of an ensemble.
    """

    parts: Callable[[Ensemble], Parts]
    coefficients: Array
    curves: Curves

    def at(self, values: ArrayLike) -> dict[str, Estimate]:
        """Return estimates of each quantity at values of the variable, shape (value,).

        Beyond the range that was recorded, they keep their values at the nearer limit.
        """
        return self.curves.at(np.atleast_1d(read_only(values)), tuple(self.coordinates))

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        torques: dict[str, Array] = {}
        coefficients = self.coefficients
        for name, (regressors, _) in self.parts(ensemble).items():
            own, coefficients = np.split(coefficients, [regressors[..., 0, 0].size])
            pathway = "reflex" if name in REFLEXES else "intrinsic"
            torque = np.tensordot(own.reshape(regressors.shape[:2]), regressors, 2)
            torques[pathway] = torques.get(pathway, 0.0) + torque
        return torques
