"""Results of identification: read-only models with estimates, which predict torque.

Conventions of the whole package::

    axes                    realization, time, lag (or frequency)
    impulse response        y(t) = Σ h(t, τ) u(t - τ) Δt,  τ = -max_lag … +max_lag
                            h[:, 0] is the lag -max_lag, h[:, -1] the lag +max_lag
    positive lag            the input comes before the output
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.arrays import read_only, to_array
from tvsysid.dataset_layout import UNITS, Labelled, to_dataset
from tvsysid.errors import InputError
from tvsysid.numerics.bands import (
    critical_value,
    half_width,
    mean_known,
    mean_of,
    simultaneous_value,
)
from tvsysid.signals import Array, Ensemble, check_ensemble

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

# Quantities of a joint of second order: factors of the angle and of its first two derivatives.
IMPEDANCE = ("stiffness", "viscosity", "inertia")
OVER_TIME = {("time",), ("realization", "time")}  # axes of estimates that have a value at each time


@attrs.frozen(eq=False)
class StandardError:
    """Standard error of an estimate, from measurement noise.

    Parameters
    ----------
    values
        Standard error of each value of the estimate, in its unit. NaN where unknown.
    freedom
        Degrees of freedom: one number, or one for each value.
    arc
        How much the errors at different times differ, for simultaneous bands: 0 rad if all times
        have the same error (:func:`tvsysid.numerics.bands.arc_length`).
    absent
        Reason why the standard error is unknown at all times. Empty if it is known.
    minimum
        Smallest value that the quantity can have. The band does not go below.
    """

    values: Array = attrs.field(converter=to_array)
    _freedom: Array = attrs.field(converter=to_array)
    arc: float = np.inf
    absent: str = ""
    minimum: float = -np.inf

    @property
    def freedom(self) -> Array:
        """Degrees of freedom of each value."""
        return np.broadcast_to(self._freedom, self.values.shape)

    def band_around(self, values: Array, level: float, simultaneous: bool) -> tuple[Array, Array]:
        """Return the lower and upper limit of the band around the estimates ``values``."""
        known = np.isfinite(self.values)
        width = np.full(self.values.shape, np.nan)
        width[known] = self.multiple(level, simultaneous) * self.values[known]
        return np.maximum(values - width, self.minimum), values + width

    def multiple(self, level: float, simultaneous: bool) -> Array:
        """Return the ratio of half width to standard error, for each known standard error."""
        freedom = self.freedom[np.isfinite(self.values)]
        if simultaneous:
            return simultaneous_value(level, freedom, self.arc)
        return critical_value(level, freedom)

    @classmethod
    def none(cls, shape: int | tuple[int, ...], why: str) -> StandardError:
        """Return a standard error that is NaN everywhere, with the reason ``why``."""
        return cls(np.full(shape, np.nan), np.inf, absent=why)


def _to_axes(axes: str | tuple[str, ...]) -> tuple[str, ...]:
    return (axes,) if isinstance(axes, str) else tuple(axes)


@attrs.frozen(eq=False, repr=False)
class Estimate:
    """Estimate of one quantity.

    A band covers measurement noise: without bias, it contains the true value in a share ``level``
    of repetitions. It does not cover bias from a method's assumptions, such as smoothing.

    Parameters
    ----------
    values
        Values in ``unit``, NaN where not identified.
    unit
        SI unit, such as ``"N m/rad"``.
    axes
        Names of the axes of ``values``: ``("time",)``, or ``("realization", "time")`` if each
        realization has its own estimate, or the name of a measured variable. The model's
        ``coordinates`` hold the values of such a variable.
    error
        Standard error, or a function that computes it when it is first needed, or None.

    Examples
    --------
    >>> estimate = Estimate([100.0, 110.0], "N m/rad", error=StandardError([1.0, 2.0], np.inf))
    >>> lower, upper = estimate.band(0.95)
    >>> upper.round(2)
    array([101.96, 113.92])
    """

    values: Array = attrs.field(converter=to_array)
    unit: str
    axes: tuple[str, ...] = attrs.field(default=("time",), converter=_to_axes)
    error: StandardError | Callable[[], StandardError | None] | None = None

    def __attrs_post_init__(self) -> None:
        values, error = self.values, self.error
        shape = values.shape
        is_real = values.dtype.kind == "f"
        if not is_real or np.isinf(values).any():
            raise InputError(
                "estimate: expected real numbers, NaN where not identified, got values of type "
                f"{values.dtype}{', some of them infinite' * is_real}"
            )
        expected = f"estimate: expected values over {', '.join(self.axes)}"
        if values.ndim != len(self.axes):
            raise InputError(f"{expected}, got an array of shape {shape}")
        if isinstance(error, StandardError) and error.values.shape != shape:
            raise InputError(f"{expected}, got standard errors of shape {error.values.shape}")

    def __repr__(self) -> str:
        known = self.values[np.isfinite(self.values)]
        span = f"{known.min():.3g} to {known.max():.3g}" if known.size else "no value"
        return f"Estimate({span} {self.unit} over {', '.join(self.axes)})"

    def __reduce__(self) -> tuple[Any, ...]:
        # Keep the standard error instead of its function, which holds all the data.
        return Estimate, (self.values, self.unit, self.axes, self.standard_error)

    @cached_property
    def standard_error(self) -> StandardError | None:
        """Standard error, None if the method states none."""
        return self.error() if callable(self.error) else self.error

    def band(self, level: float = 0.95, simultaneous: bool = False) -> tuple[Array, Array]:
        """Return the lower and upper limit of the band around the estimate.

        They are NaN where there is no band. ``standard_error.absent`` says why.

        Parameters
        ----------
        level
            Probability, between 0 and 1, with which the band contains the true value.
        simultaneous
            Whether the band contains the whole true curve with this probability, or the true value
            at each single time. See :func:`tvsysid.numerics.bands.simultaneous_value`.

        """
        error = self.standard_error or StandardError.none(self.values.shape, "")
        return error.band_around(self.values, level, simultaneous)


@attrs.frozen(eq=False)
class Diagnostics:
    """Diagnostics of an identification.

    Parameters
    ----------
    parameters
        Effective number of parameters. It is the mean over time if each time has its own.
    rank
        Number of singular values kept, shape (time,). None if the method does not truncate.
    warnings
        Reasons why the result may be wrong.
    seconds
        Duration of the identification in s.
    details
        Other numbers by name.
    """

    parameters: float = np.nan
    rank: Array | None = attrs.field(default=None, converter=attrs.converters.optional(to_array))
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    details: Mapping[str, float] = attrs.field(factory=dict)


def _to_dict(estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    return dict(estimates)


def _to_coordinates(coordinates: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
    return {name: read_only(values) for name, values in coordinates.items()}


@attrs.frozen(eq=False, repr=False, kw_only=True)
class Model:
    r"""Impedance and other quantities over the time of a realization, as a method identified them.

    It predicts the torque :math:`K(t)\theta + B(t)\dot\theta + I(t)\ddot\theta`, with the
    derivatives of :meth:`tvsysid.Ensemble.derivatives`, unless ``pathways`` is given.

    Parameters
    ----------
    sampling_rate
        In Hz.
    time
        Time within a realization in s, shape (time,).
    estimates
        Estimates by quantity, such as ``stiffness``, ``viscosity``, ``inertia``, ``reflex_gain``.
    method
        Method in words, with its settings.
    diagnostics
        Diagnostics of the identification.
    coordinates
        Values along each axis of the estimates, except time and realization.
    pathways
        Function that returns the torque of each pathway. By default, there is one pathway.
    """

    sampling_rate: float
    time: Array = attrs.field(converter=to_array)
    estimates: Mapping[str, Estimate] = attrs.field(converter=_to_dict)
    method: str = ""
    diagnostics: Diagnostics = attrs.field(factory=Diagnostics)
    coordinates: Mapping[str, NDArray[Any]] = attrs.field(factory=dict, converter=_to_coordinates)
    _torques: Callable[[Ensemble], Mapping[str, Array]] | None = attrs.field(
        default=None, alias="pathways"
    )

    @classmethod
    def of(
        cls,
        ensemble: Ensemble,
        stiffness: ArrayLike | None = None,
        viscosity: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        *,
        estimates: Mapping[str, Estimate] | None = None,
        coordinates: Mapping[str, ArrayLike] | None = None,
        pathways: Callable[[Ensemble], Mapping[str, Array]] | None = None,
        parameters: float = np.nan,
    ) -> Model:
        """Build the model from the results of your own method.

        Parameters
        ----------
        ensemble
            Realizations from which the model was identified.
        stiffness, viscosity, inertia
            Shape (time,), or one number; NaN where not identified.
        estimates
            Estimates of other quantities, and estimates with standard errors or other axes.
        coordinates
            Values along each axis of the estimates, except time and realization.
        pathways
            Function that returns the torque of each pathway for an ensemble, each of shape
            (realization, time). By default, stiffness, viscosity and inertia give the torque.
        parameters
            Effective number of parameters.
        """
        given: dict[str, Estimate] = {}
        for name, values in zip(IMPEDANCE, (stiffness, viscosity, inertia), strict=True):
            if values is not None:
                over_time = values if np.ndim(values) else np.full(ensemble.samples, values)
                given[name] = Estimate(over_time, UNITS[name])
        return Model(
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=given | dict(estimates or {}),
            diagnostics=Diagnostics(parameters),
            coordinates=coordinates or {},
            pathways=pathways,
        )

    @property
    def stiffness(self) -> Array:
        """Stiffness in N·m/rad, shape (time,), NaN where not identified."""
        return self.over_time("stiffness")

    @property
    def viscosity(self) -> Array:
        """Viscosity in N·m·s/rad, shape (time,), NaN where not identified."""
        return self.over_time("viscosity")

    @property
    def inertia(self) -> Array:
        """Inertia in kg·m², shape (time,), NaN where not identified."""
        return self.over_time("inertia")

    def over_time(self, quantity: str) -> Array:
        """Return an estimate over time (time,), or its mean over realizations; NaN if unknown."""
        estimate = self.estimates.get(quantity)
        if estimate is None or estimate.axes not in OVER_TIME:
            return np.full(len(self.time), np.nan)
        return estimate.values if estimate.axes == ("time",) else mean_known(estimate.values)

    def band(self, quantity: str) -> Array:
        """Return the limits of the 95 % band of an estimate over time, shape (2, time).

        NaN where there is no band. The mean over several realizations has no band.
        """
        estimate = self.estimates.get(quantity)
        size = len(self.time)
        if estimate is None or estimate.axes not in OVER_TIME or estimate.values.size != size:
            return np.full((2, size), np.nan)
        return np.reshape(estimate.band(), (2, size))

    def pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        """Return the torque of each pathway for the signals of an ensemble, by pathway.

        A single pathway has the name ``"intrinsic"``. The torque is in N·m, of shape
        (realization, time), without context. It is NaN where it is unknown.
        """
        check_ensemble("predict", ensemble)
        same_rate = abs(ensemble.sampling_rate / self.sampling_rate - 1) <= 1e-9
        if ensemble.samples != len(self.time) or not same_rate:
            raise InputError(
                f"predict: the model has {len(self.time)} samples at {self.sampling_rate:g} Hz, "
                f"the ensemble {ensemble.samples} at {ensemble.sampling_rate:g} Hz; decimate and "
                "segment it in the same way"
            )
        return self._pathways(ensemble)

    def predict(self, ensemble: Ensemble) -> Array:
        """Return the predicted torque for an ensemble: the sum of the :meth:`pathways`."""
        return np.sum([*self.pathways(ensemble).values()], axis=0)

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        if self._torques is None:
            parts = zip(IMPEDANCE, ensemble.derivatives(), strict=True)
            known = [self.over_time(name) * each for name, each in parts if name in self.estimates]
            return {"intrinsic": np.sum(known, axis=0)}
        shape = (len(ensemble), ensemble.samples)
        torques = {name: np.asarray(each) for name, each in self._torques(ensemble).items()}
        for name, torque in torques.items():
            if torque.shape != shape or torque.dtype.kind not in "fiu":
                raise InputError(
                    f"{self.method}: the torque of pathway {name!r} must be real numbers of shape "
                    f"(realization, time) = {shape}, got {torque.dtype} of shape {torque.shape}"
                )
        return torques

    def __repr__(self) -> str:
        known = self.stiffness[np.isfinite(self.stiffness)]
        band = mean_of(half_width(self.band("stiffness")))
        span = "unknown"
        if known.size:
            span = f"{known.min():.1f} to {known.max():.1f} N·m/rad, {known.mean():.1f} on average"
            span += f", 95 % band ± {band:.1f}," if np.isfinite(band) else ""
        warned = "".join(f"\n  warning: {text}" for text in self.diagnostics.warnings)
        samples = len(self.time)
        return (
            f"{type(self).__name__}({self.method}: stiffness {span} over "
            f"{samples / self.sampling_rate:g} s, identified at {known.size} of {samples} samples, "
            f"{self.diagnostics.parameters:.3g} effective parameters){warned}"
        )

    def plot(self, title: str = "", ax: Axes | None = None) -> Figure | SubFigure:
        """Draw the estimates over time, or, if ``ax`` is given, the stiffness into these axes."""
        from tvsysid.figures import draw_quantity, plot  # noqa: PLC0415  # figures import models

        if ax is None:
            return plot(self, title)
        draw_quantity(ax, "stiffness", {self.method: self})
        ax.set_title(title)
        return ax.figure

    def to_xarray(self, ensemble: Ensemble | None = None) -> xr.Dataset:
        """Return all results as an xarray.Dataset, with units as attributes.

        The suffixes ``_standard_error``, ``_freedom``, ``_lower`` and ``_upper`` mark an estimate's
        standard error, degrees of freedom and 95 % limits. With an ensemble, the dataset also
        holds its predicted torque, named ``torque_`` plus the pathway.
        """
        return to_dataset(self, ensemble)

    def _further_variables(self) -> tuple[Labelled, Labelled]:
        """Return the variables and coordinates that a subclass adds to the dataset."""
        return {}, {}
