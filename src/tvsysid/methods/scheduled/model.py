"""Model of a scheduled joint: terms of its torque, and its properties over the variable."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from tvsysid.arrays import read_only
from tvsysid.methods.cascade.pathways import Stretch, history
from tvsysid.models import Estimate, Model, StandardError
from tvsysid.numerics.bands import arc_length, mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.signals import Array, Ensemble

GRID = 61  # values of the variable at which estimates are stated


class Term(NamedTuple):
    """Part of the torque that is linear in some coefficients.

    Parameters
    ----------
    part
        ``"rest"``, ``"intrinsic"`` or ``"reflex"``.
    order
        Degree of the polynomials in the variable.
    regressors
        Function of an ensemble and the Chebyshev polynomials (degree, realization, context + time +
        context) that returns the regressors, shape (signal, degree, realization, time). They are
        NaN where something was not recorded.
    quantities
        Weights (signal,) that turn the signals' coefficients into each quantity.
    """

    part: str
    order: int
    regressors: Callable[[Ensemble, Array], Array]
    quantities: Mapping[str, Array]


class Design(NamedTuple):
    """Terms of the torque of a joint that follows a variable.

    The ``limits`` are the lowest and the highest value of the variable. They are mapped to -1 and
    1; values beyond them count as the nearer one.
    """

    variable: str
    limits: tuple[float, float]
    terms: tuple[Term, ...]

    def columns(self, ensemble: Ensemble) -> list[Array]:
        """Return the regressors of each term, shape (column, realization, time).

        They lose their mean over realizations where the ensemble has lost its own.
        """
        found = []
        for term in self.terms:
            powers = chebyshev_of(ensemble.signal(self.variable), self.limits, term.order + 1)
            regressors = term.regressors(ensemble, np.moveaxis(powers, -1, 0))
            columns = regressors.reshape(-1, len(ensemble), ensemble.samples)
            if ensemble.mean_subtracted:
                columns = columns - mean_known(columns.swapaxes(0, 1))[:, None]
            found.append(columns)
        return found


def rest(ensemble: Ensemble, powers: Array) -> Array:
    """Return the regressors of the torque at rest."""
    return powers[None, :, :, ensemble.core]


def lagged_angles(centre: float, lags: int, ensemble: Ensemble, powers: Array) -> Array:
    """Return regressors by the angle less ``centre`` at lags from -lags to lags."""
    angle = np.pad(ensemble.angle - centre, ((0, 0), (lags, lags)), constant_values=np.nan)
    windows = sliding_window_view(angle, ensemble.samples, axis=1)[:, ensemble.context :]
    signals = windows[:, 2 * lags :: -1].swapaxes(0, 1)
    return np.asarray(signals[:, None] * rest(ensemble, powers))


def derivatives(centre: float, orders: slice, ensemble: Ensemble, powers: Array) -> Array:
    """Return regressors by some of the angle less ``centre``, velocity and acceleration."""
    signals = ensemble.derivatives()
    signals[0] -= centre
    return np.asarray(signals[orders, None] * rest(ensemble, powers))


def filtered_stretch(
    direction: int, delay: int, responses: Array, ensemble: Ensemble, powers: Array
) -> Array:
    """Return regressors by stretch times the polynomials at its time, behind delay and filters.

    The ``responses`` have the shape (filter, lag), the ``delay`` is in samples.
    """
    memory = responses.shape[1]
    found = []
    for driven in powers * Stretch(direction=direction)(ensemble):
        past = history(ensemble, driven, delay + memory - 1)[:, : memory - 1 + ensemble.samples]
        windows = sliding_window_view(past, memory, axis=1)
        found.append(np.tensordot(responses[:, ::-1], windows, axes=(1, 2)))
    return np.stack(found, axis=1)


@attrs.frozen(eq=False)
class Curve:
    """Polynomial of a quantity in the variable: its weights (degree,) and their covariance."""

    design: Design
    unit: str
    weights: Array
    covariance: Array
    freedom: float

    def at(self, values: Array, axes: tuple[str, ...]) -> Estimate:
        """Return the estimate at values of the variable, constant beyond its limits."""
        limits = self.design.limits
        features, along = (
            chebyshev_of(each, limits, len(self.weights))
            for each in (values, np.linspace(*limits, GRID))
        )
        variance = np.einsum("...j,...j->...", features @ self.covariance, features)
        arc = arc_length(along, self.covariance)
        error = StandardError(np.sqrt(np.maximum(variance, 0.0)), np.array(self.freedom), arc)
        return Estimate(features @ self.weights, self.unit, axes, error)


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ScheduledModel(Model):
    r"""Stiffness, viscosity, inertia and reflex gain as polynomials in a measured variable.

    The estimates named ``scheduled_stiffness`` and so on have an axis with the name of the
    variable's channel, and values of the variable as coordinates. ``stiffness`` and so on are the
    estimates at each time of each realization. The ``coefficients`` (coefficient,) are those of the
    torque at rest, the intrinsic and the reflex pathway, in this order.
    """

    design: Design
    coefficients: Array
    curves: Mapping[str, Curve]

    def at(self, values: ArrayLike) -> dict[str, Estimate]:
        """Return estimates of each quantity at values of the variable, shape (value,).

        Beyond the range that was recorded, they keep their values at the nearer limit.
        """
        values, axes = np.atleast_1d(read_only(values)), (self.design.variable,)
        return {name: curve.at(values, axes) for name, curve in self.curves.items()}

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        columns = self.design.columns(ensemble)
        ends = np.cumsum([len(own) for own in columns])[:-1]
        parts = [
            np.tensordot(own, several, 1)
            for own, several in zip(np.split(self.coefficients, ends), columns, strict=True)
        ]
        reflex = {"reflex": parts.pop()} if self.design.terms[-1].part == "reflex" else {}
        return {"intrinsic": np.sum(parts, axis=0)} | reflex
