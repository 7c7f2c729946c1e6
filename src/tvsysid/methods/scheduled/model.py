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
from tvsysid.methods.scheduled.regression import Fit
from tvsysid.methods.scheduled.terms import AnyTerm, Schedule, columns_of
from tvsysid.models import Estimate, Model, StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.signals import Array, Ensemble

GRID = 61  # values of the variable at which estimates are stated
MAX_BEYOND = 1e-3  # share of the samples that may be beyond the limits without a warning


@attrs.frozen(eq=False)
class Curve:
    """Polynomial of a quantity in the variable: its weights (degree,) and their covariance."""

    schedule: Schedule
    unit: str
    weights: Array
    covariance: Array
    freedom: float

    def at(self, values: Array, axes: tuple[str, ...]) -> Estimate:
        """Return the estimate at values of the variable, constant beyond its limits."""
        limits, order = self.schedule.limits, len(self.weights) - 1
        features = np.moveaxis(self.schedule.polynomials(values, order), 0, -1)
        grid = self.schedule.polynomials(np.linspace(*limits, GRID), order).T
        variance = np.einsum("...j,...j->...", features @ self.covariance, features)
        arc = arc_length(grid, self.covariance)
        error = StandardError(np.sqrt(np.maximum(variance, 0.0)), np.array(self.freedom), arc)
        return Estimate(features @ self.weights, self.unit, axes, error)


def curves_of(fit: Fit, covariance: Array, freedom: float) -> dict[str, Curve]:
    """Return the curve of each quantity from a fit and the covariance of its coefficients."""
    found = {}
    for place, term in enumerate(fit.rows.terms):
        own = fit.rows.owner == place
        for name, weights in term.quantities.items():
            readout = np.kron(weights, np.eye(term.order + 1))  # columns are (signal, degree)
            moved = readout @ covariance[np.ix_(own, own)] @ readout.T
            mean = readout @ fit.coefficients[own]
            found[name] = Curve(fit.rows.schedule, UNITS[name], mean, moved, freedom)
    return found


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ScheduledModel(Model):
    r"""Stiffness, viscosity, inertia and reflex gain as polynomials in a measured variable.

    The estimates named ``scheduled_stiffness`` and so on have an axis with the name of the
    variable's channel, and values of the variable as coordinates. ``stiffness`` and so on are the
    estimates at each time of each realization. The ``coefficients`` (coefficient,) are those of the
    torque at rest, the intrinsic and the reflex pathway, in this order.
    """

    schedule: Schedule
    terms: tuple[AnyTerm, ...]
    coefficients: Array
    curves: Mapping[str, Curve]

    def at(self, values: ArrayLike) -> dict[str, Estimate]:
        """Return estimates of each quantity at values of the variable, shape (value,).

        Beyond the range that was recorded, they keep their values at the nearer limit.
        """
        values, axes = np.atleast_1d(read_only(values)), (self.schedule.name,)
        return {name: curve.at(values, axes) for name, curve in self.curves.items()}

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        self._warn_beyond_limits(ensemble)
        columns = columns_of(self.terms, ensemble, self.schedule)
        weights = np.split(self.coefficients, np.cumsum([len(own) for own in columns])[:-1])
        parts = [np.tensordot(*pair, 1) for pair in zip(weights, columns, strict=True)]
        if self.terms[-1].part == "reflex":
            return {"intrinsic": np.sum(parts[:-1], axis=0), "reflex": parts[-1]}
        return {"intrinsic": np.sum(parts, axis=0)}

    def _identified(self) -> tuple[Labelled, Labelled]:
        return {"coefficients": (("coefficient",), self.coefficients)}, {}

    def _warn_beyond_limits(self, ensemble: Ensemble) -> None:
        values = ensemble.signal(self.schedule.name)[:, ensemble.core]
        low, high = self.schedule.limits
        share = float(np.mean((values < low) | (values > high)))
        if share > MAX_BEYOND:
            text = (
                f"{self.schedule.name} is beyond the {low:.3g} to {high:.3g} that the model was "
                f"identified from at {100 * share:.2g} % of the samples ({values.min():.3g} to "
                f"{values.max():.3g}): there, the joint is taken as it is at the nearer limit"
            )
            warnings.warn(text, DataQualityWarning, stacklevel=5)
