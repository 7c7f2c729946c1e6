"""Model of a scheduled joint: its properties over the variable and over time."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import attrs
import numpy as np
from numpy.typing import ArrayLike

from tvsysid.arrays import read_only
from tvsysid.dataset_layout import UNITS, Labelled
from tvsysid.errors import DataQualityWarning
from tvsysid.methods.scheduled.structure import Structure
from tvsysid.models import Estimate, Model, StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.signals import Array, Ensemble

GRID = 61  # values of the variable at which estimates are stated
BEYOND = 1e-3  # share of the samples beyond the limits from which on they are worth a warning


@attrs.frozen(eq=False)
class Curves:
    """Quantities that are polynomials in the variable.

    Each name has its weights (degree,) and their covariance.
    """

    structure: Structure
    weights: Mapping[str, Array]
    covariances: Mapping[str, Array]
    freedom: float

    @classmethod
    def of(
        cls,
        structure: Structure,
        coefficients: Array,
        covariance: Array,
        rate: float,
        freedom: float,
    ) -> Curves:
        """Return the curves by the coefficients of all columns and their covariance."""
        readouts = structure.readouts(rate)
        weights = {name: coefficients @ readout for name, readout in readouts.items()}
        covariances = {name: readout.T @ covariance @ readout for name, readout in readouts.items()}
        return cls(structure, weights, covariances, freedom)

    def at(self, values: Array, axes: tuple[str, ...]) -> dict[str, Estimate]:
        """Return estimates at values of the variable.

        Beyond the variable's limits, they keep their values at the nearer limit.
        """
        polynomials = self.structure.polynomials(values)
        grid = self.structure.polynomials(np.linspace(*self.structure.limits, GRID))
        found = {}
        for name, weights in self.weights.items():
            own, covariance = polynomials[..., : len(weights)], self.covariances[name]
            variance = np.einsum("...j,jk,...k->...", own, covariance, own, optimize=True)
            arc = arc_length(grid[:, : len(weights)], covariance)
            error = StandardError(np.sqrt(np.maximum(variance, 0.0)), np.array(self.freedom), arc)
            found[name] = Estimate(own @ weights, UNITS[name], axes, error)
        return found


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ScheduledModel(Model):
    r"""Stiffness, viscosity, inertia and reflex gain as polynomials in a measured variable.

    The estimates named ``scheduled_stiffness`` and so on have an axis with the name of the
    variable's channel, and values of the variable as coordinates. ``stiffness`` and so on are the
    estimates at each time of each realization. The ``coefficients`` (coefficient,) are those of the
    torque at rest, the intrinsic and the reflex pathway, in this order.
    """

    structure: Structure
    curves: Curves
    coefficients: Array

    def at(self, values: ArrayLike) -> dict[str, Estimate]:
        """Return estimates of each quantity at values of the variable, shape (value,).

        Beyond the range that was recorded, they keep their values at the nearer limit.
        """
        return self.curves.at(np.atleast_1d(read_only(values)), (self.structure.variable,))

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        _warn_beyond(self.structure, ensemble)
        parts = self.structure.parts(ensemble)
        each = np.split(self.coefficients, np.cumsum([len(part) for part in parts])[:-1])
        rest, *torques = (
            np.tensordot(weights, part, 1) for weights, part in zip(each, parts, strict=True)
        )
        torques[0] += rest
        return dict(zip(("intrinsic", "reflex"), torques, strict=False))

    def _identified(self) -> tuple[Labelled, Labelled]:
        return {"coefficients": (("coefficient",), self.coefficients)}, {}


def _warn_beyond(structure: Structure, ensemble: Ensemble) -> None:
    values = ensemble.signal(structure.variable)[:, ensemble.core]
    low, high = structure.limits
    share = float(np.mean((values < low) | (values > high)))
    if share > BEYOND:
        text = (
            f"{structure.variable} is beyond the {low:.3g} to {high:.3g} that the model was "
            f"identified from at {100 * share:.2g} % of the samples ({values.min():.3g} to "
            f"{values.max():.3g}): there, the joint is taken as it is at the nearer limit"
        )
        warnings.warn(text, DataQualityWarning, stacklevel=4)
