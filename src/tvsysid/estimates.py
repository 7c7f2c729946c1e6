"""What is known of one quantity: its values, their standard errors, and the bands that follow."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Protocol, TypeVar

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.numerics import Array
from tvsysid.numerics.bands import critical_value, simultaneous_value

Scalar = TypeVar("Scalar", bound=np.generic)
IMPEDANCE = ("stiffness", "viscosity", "inertia")
"""Quantities of a joint of second order, in the order of the angle's derivatives that they multiply."""
UNITS = {
    "stiffness": "N m/rad",
    "viscosity": "N m s/rad",
    "inertia": "kg m2",
    "reflex_gain": "N m s/rad",
    "impulse_response": "N m/rad/s",
    "reflex_response": "N m/rad",
    "frequency_response": "N m/rad",
    "coherence": "1",
    "rank": "1",
    "instrument_strength": "1",
    "time": "s",
    "lag": "s",
    "reflex_lag": "s",
    "velocity": "rad/s",
    "nonlinearity": "rad/s",
    "frequency": "Hz",
}
"""Units of what the package itself estimates or simulates."""


def frozen(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """The array, read-only: a copy of one that somebody can write to."""
    array = array.copy(order="K") if array.flags.writeable else array.view()
    array.flags.writeable = False
    return array


def plain_array(what: str, given: object) -> NDArray[Any]:
    """Array of what somebody gave, whatever it holds.

    An InputError where numbers could be taken for others.
    """
    if isinstance(given, np.ma.MaskedArray):
        raise InputError(
            f"{what}: got a masked array; fill what is masked with NaN: values.filled(np.nan)"
        )
    if isinstance(given, np.ndarray) and type(given) not in (np.ndarray, np.memmap):
        raise InputError(
            f"{what}: expected a plain NumPy array, got one of type {type(given).__name__}"
        )
    try:
        return np.asarray(given)
    except Exception as error:
        raise InputError(
            f"{what}: expected an array of numbers, got {describe_error(error)}"
        ) from error


def read_only(values: ArrayLike) -> Array:
    """Floating-point numbers that nobody can write to."""
    return frozen(np.asarray(values, dtype=np.float64))


@attrs.frozen(eq=False)
class StandardError:
    """Random error of an estimate: what other noise of the same kind would have changed.

    The ``values`` have the estimate's shape and unit; NaN where they are not known. ``freedom``
    are the degrees of freedom from which they were estimated, one number or an array of the same
    shape; ``arc`` says how far the estimate moves over the period apart from its size
    (:func:`tvsysid.numerics.bands.simultaneous_value`), ``absent`` why there is no standard
    error at any time, if so.
    """

    values: Array
    freedom: Array
    arc: float = np.inf
    absent: str = ""

    def __attrs_post_init__(self) -> None:
        object.__setattr__(self, "values", read_only(self.values))
        object.__setattr__(
            self, "freedom", np.broadcast_to(read_only(self.freedom), np.shape(self.values))
        )

    def limits(
        self, values: Array, level: float, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        """Lower and upper limits about ``values``; see :meth:`Estimate.band`."""
        known = np.isfinite(self.values)
        freedom = self.freedom[known]
        multiple = (
            simultaneous_value(level, freedom, self.arc)
            if simultaneous
            else critical_value(level, freedom)
        )
        width = np.full(self.values.shape, np.nan)
        width[known] = multiple * self.values[known]
        return values - width, values + width

    @classmethod
    def none(cls, times: int, why: str) -> StandardError:
        """Nothing is known of the random error."""
        return cls(np.full(times, np.nan), np.array(np.inf), absent=why)


class ErrorStatistics(Hashable, Protocol):
    """Small arrays from which standard errors are worked out when somebody asks for a band.

    Pickled as they are.
    """

    def standard_errors(self) -> Mapping[str, StandardError]:
        """Return the standard errors of a model's estimates, by quantity."""
        ...  # pragma: no cover


@attrs.frozen(eq=False)
class DeferredError:
    """Standard error of one quantity that nobody has asked for yet."""

    statistics: ErrorStatistics
    quantity: str


@lru_cache(maxsize=16)
def _worked_out(statistics: ErrorStatistics) -> Mapping[str, StandardError]:
    """Standard errors of all quantities: they are worked out together, and asked for one after the other."""
    return statistics.standard_errors()


@attrs.frozen(eq=False, repr=False)
class Estimate:
    """One quantity that was identified.

    Parameters
    ----------
    values
        In ``unit``; NaN where not identified.
    unit
        SI unit, such as ``"N m/rad"``.
    axes
        Names of the axes of ``values``: ``("time",)``; ``("realization", "time")`` where a method
        tells realizations apart; or that of a measured variable, whose coordinates are the model's.
    error
        Its random error, or what it is worked out from; None where the method states none.

    Raises
    ------
    InputError
        For values that are not real numbers, are infinite, or have another number of axes.

    Notes
    -----
    A band covers the random error: the truth lies within it in a share ``level`` of repetitions with other noise, as
    far as the method has no bias. What a method's assumptions distort (a change that is smoothed, directions of the
    input that are left out) is not noise and not in the band; nor is what differs between realizations beyond the
    noise, for which there is :func:`tvsysid.uncertainty.bootstrap`.

    Examples
    --------
    >>> estimate = Estimate([100.0, 110.0], "N m/rad", error=StandardError([1.0, 2.0], np.inf))
    >>> lower, upper = estimate.band(0.95)
    >>> upper.round(2)
    array([101.96, 113.92])
    """

    values: Array
    unit: str
    axes: tuple[str, ...] = ("time",)
    error: StandardError | DeferredError | None = None

    def __attrs_post_init__(self) -> None:
        values = plain_array("estimate", self.values)
        if values.dtype.kind not in "fiu" or np.isinf(values).any():
            infinite = ", some of them infinite" if values.dtype.kind == "f" else ""
            raise InputError(
                "estimate: expected real numbers, NaN where there is none, got values of type "
                f"{values.dtype}{infinite}"
            )
        if isinstance(self.axes, str):
            raise InputError(
                f"estimate: expected a tuple of axes, got {self.axes!r}; write ({self.axes!r},)"
            )
        if values.ndim != len(self.axes):
            raise InputError(
                f"estimate: expected values over {', '.join(self.axes)}, got an array of shape "
                f"{values.shape}"
            )
        object.__setattr__(self, "values", read_only(values))
        object.__setattr__(self, "axes", tuple(self.axes))
        if isinstance(self.error, StandardError) and self.error.values.shape != values.shape:
            raise InputError(
                f"estimate: expected standard errors of the values' shape {values.shape}, got "
                f"{self.error.values.shape}"
            )

    def __repr__(self) -> str:
        known = self.values[np.isfinite(self.values)]
        span = (
            f"{known.min():.3g} to {known.max():.3g} {self.unit}"
            if known.size
            else f"no value ({self.unit})"
        )
        return f"Estimate({span} over {', '.join(self.axes)})"

    @property
    def standard_error(self) -> StandardError | None:
        """Standard error, worked out if need be; None where the method states none."""
        if isinstance(self.error, DeferredError):
            return _worked_out(self.error.statistics).get(self.error.quantity)
        return self.error

    def band(self, level: float = 0.95, simultaneous: bool = False) -> tuple[Array, Array]:
        """Lower and upper limits of the band about the estimate, in its unit and shape.

        NaN where there is none.

        Parameters
        ----------
        level
            Probability, between 0 and 1, with which the band holds the true value.
        simultaneous
            Whether it holds the truth at all times together with at least that probability, rather
            than at each time by itself; see :func:`tvsysid.numerics.bands.simultaneous_value`.

        Raises
        ------
        InputError
            For a level that is not between 0 and 1.

        Warns
        -----
        DataQualityWarning
            If there is none at any time; says why.
        """
        error = self.standard_error
        if error is None:
            error = StandardError(
                np.full(self.values.shape, np.nan), np.array(np.inf), absent=NO_ERROR
            )
        if error.absent and not np.isfinite(error.values).any():
            warnings.warn(f"no band: {error.absent}", DataQualityWarning, stacklevel=2)
        return error.limits(self.values, level, simultaneous)


NO_ERROR = "the method states no standard error"


def impedance_estimates(
    stiffness: Array,
    viscosity: Array,
    inertia: Array,
    errors: ErrorStatistics | Mapping[str, StandardError] | None,
) -> dict[str, Estimate]:
    """Estimates of a joint's impedance over time, with their standard errors or what these are worked out from."""

    def error_of(name: str) -> StandardError | DeferredError | None:
        if errors is None or isinstance(errors, Mapping):
            return (errors or {}).get(name)
        return DeferredError(errors, name)

    return {
        name: Estimate(values, UNITS[name], error=error_of(name))
        for name, values in zip(IMPEDANCE, (stiffness, viscosity, inertia), strict=True)
    }


def standard_errors(
    values: Array, freedom: Array, arcs: Sequence[float] = (np.inf,) * 3, absent: str = ""
) -> dict[str, StandardError]:
    """Standard errors of stiffness, viscosity and inertia from arrays (time, 3)."""
    columns = zip(values.T, freedom.T, arcs, strict=True)
    return {
        name: StandardError(*column, absent)
        for name, column in zip(IMPEDANCE, columns, strict=True)
    }


def no_errors(times: int, why: str) -> dict[str, StandardError]:
    """Nothing is known of the random error of stiffness, viscosity and inertia."""
    return dict.fromkeys(IMPEDANCE, StandardError.none(times, why))
