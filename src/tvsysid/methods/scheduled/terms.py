"""Terms of a scheduled joint's torque: signals times polynomials in a measured variable."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.methods.cascade.pathways import Stretch, history
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.signals import Array, Ensemble


@attrs.frozen
class Schedule:
    """Scheduling variable: the name of its channel, and the limits that are mapped to -1 and 1."""

    name: str
    limits: tuple[float, float]

    @classmethod
    def of(cls, ensemble: Ensemble, name: str) -> Schedule:
        """Return the schedule whose limits are the smallest and largest value in an ensemble."""
        values = ensemble.signal(name)[:, ensemble.core]
        return cls(name, (float(values.min()), float(values.max())))

    def polynomials(self, values: Array, order: int) -> Array:
        """Return Chebyshev polynomials of degree 0 to ``order``, shape (degree, *values.shape)."""
        return np.moveaxis(chebyshev_of(values, self.limits, order + 1), -1, 0)


@attrs.frozen
class Term:
    """Signals, each times a polynomial in the variable at the same time.

    Parameters
    ----------
    part
        Part of the torque: ``"rest"`` or ``"intrinsic"``.
    signals
        Function of an ensemble that returns the signals, shape (signal, realization, time).
    order
        Degree of the polynomials.
    quantities
        Weights (signal,) that turn the signals' coefficients into each quantity.
    """

    part: str
    signals: Callable[[Ensemble], Array]
    order: int
    quantities: Mapping[str, Array]

    def columns(self, ensemble: Ensemble, schedule: Schedule) -> Array:
        """Return the regressors, shape (signal, degree, realization, time)."""
        variable = ensemble.signal(schedule.name)[:, ensemble.core]
        return self.signals(ensemble)[:, None] * schedule.polynomials(variable, self.order)


@attrs.frozen
class Reflex:
    """Filtered stretch: what passes the filters has a polynomial in the variable at its time.

    Parameters
    ----------
    drive
        Stretch of the joint.
    delay
        Samples between stretch and torque.
    responses
        Impulse responses of the filters, shape (filter, lag).
    order
        Degree of the polynomials.
    """

    drive: Stretch
    delay: int
    responses: Array
    order: int

    part = "reflex"

    @property
    def quantities(self) -> dict[str, Array]:
        """Return the weights (filter,) of the reflex gain, the area under the response."""
        return {"reflex_gain": self.responses.sum(axis=1)}

    def columns(self, ensemble: Ensemble, schedule: Schedule) -> Array:
        """Return the regressors, shape (filter, degree, realization, time).

        They are NaN where the memory was not recorded.
        """
        memory = self.responses.shape[1]
        before, reach = self.delay + memory - 1, memory - 1 + ensemble.samples
        polynomials = schedule.polynomials(ensemble.signal(schedule.name), self.order)
        found = []
        for drive in polynomials * self.drive(ensemble):
            past = history(ensemble, drive, before)[:, :reach]
            windows = sliding_window_view(past, memory, axis=1)
            found.append(np.tensordot(self.responses[:, ::-1], windows, axes=(1, 2)))
        return np.stack(found, axis=1)


AnyTerm = Term | Reflex


def columns_of(terms: Sequence[AnyTerm], ensemble: Ensemble, schedule: Schedule) -> list[Array]:
    """Return the regressors of each term, shape (column, realization, time).

    They lose their mean over realizations where the ensemble has lost its own.
    """
    found = []
    for term in terms:
        columns = term.columns(ensemble, schedule).reshape(-1, len(ensemble), ensemble.samples)
        if ensemble.mean_subtracted:
            columns -= mean_known(columns.swapaxes(0, 1))[:, None]
        found.append(columns)
    return found


def at_rest(ensemble: Ensemble) -> Array:
    """Return the signal of the torque at rest: 1 at all times."""
    return np.ones((1, len(ensemble), ensemble.samples))


def lagged_angles(ensemble: Ensemble, centre: float, lags: int) -> Array:
    """Return the angle less ``centre`` at lags from -lags to lags; NaN beyond the context."""
    missing = max(0, lags - ensemble.context)
    edges = ((0, 0), (missing, missing))
    angle = np.pad(ensemble.angle - centre, edges, constant_values=np.nan)
    first = ensemble.context + missing - lags
    windows = sliding_window_view(angle, ensemble.samples, axis=1)[:, first : first + 2 * lags + 1]
    return np.asarray(windows[:, ::-1].transpose(1, 0, 2))


def angle_and_velocity(ensemble: Ensemble, centre: float) -> Array:
    """Return the angle less ``centre`` and its velocity; NaN where filters reach too far."""
    angle, velocity = ensemble.derivatives(1)
    return np.stack([angle - centre, velocity])


def acceleration(ensemble: Ensemble) -> Array:
    """Return the acceleration; NaN where filters reach beyond the context."""
    return ensemble.derivatives()[2:]
