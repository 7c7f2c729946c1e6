"""What identification returns: immutable models that predict torque.

Axis order and the sign of a lag are decided here and nowhere else::

    axes                    realization, time, lag (or frequency)
    impulse response        y(t) = Σ h(t, τ) u(t - τ) Δt,  τ = -max_lag … +max_lag
                            h[:, 0] is the lag -max_lag, h[:, -1] the lag +max_lag
    positive lag            the input comes before the output
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.numerics.bands import critical_value, simultaneous_value
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.moments import convolve_lags
from tvsysid.signals import Ensemble

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Labelled = dict[str, tuple[tuple[str, ...], Any]]
"""Values with the names of their axes, by name."""

QUANTITIES = ("stiffness", "viscosity", "inertia")
UNITS = {
    "stiffness": "N m/rad",
    "viscosity": "N m s/rad",
    "inertia": "kg m2",
    "stiffness_deviation": "N m/rad",
    "viscosity_deviation": "N m s/rad",
    "inertia_deviation": "kg m2",
    "impulse_response": "N m/rad/s",
    "frequency_response": "N m/rad",
    "coherence": "1",
    "rank": "1",
    "time": "s",
    "lag": "s",
    "frequency": "Hz",
}


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """How an identification went.

    Parameters
    ----------
    parameters
        Effective number of parameters: of the whole model, or the mean over time where each time has its own.
    rank
        Number of singular values kept at each time, shape (time,); None for methods that keep all or have none.
    warnings
        What was legal but doubtful.
    seconds
        Time taken.
    details
        Further numbers by name, such as the noise variance.
    """

    parameters: float
    rank: Array | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    details: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))
        if self.rank is not None:
            self.rank.flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        # A read-only mapping, unlike a dict, cannot be pickled.
        return type(self), (self.parameters, self.rank, self.warnings, self.seconds, dict(self.details))


@dataclass(frozen=True, eq=False)
class Spread:
    """Random error of what was identified: what other noise of the same kind would have changed.

    Parameters
    ----------
    deviation
        Standard deviations of stiffness, viscosity and inertia, shape (3, time); NaN where there is none.
    freedom
        Degrees of freedom from which they were estimated, shape (3, time).
    arcs
        Of each quantity, how far it moves over the period apart from its size; see
        :func:`tvsysid.numerics.bands.simultaneous_value`.
    absent
        Why there is none of some quantity at any time, if so.
    """

    deviation: Array
    freedom: Array
    arcs: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    absent: str = ""

    def __post_init__(self) -> None:
        for name in ("deviation", "freedom"):
            values = np.array(getattr(self, name))
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    def __reduce__(self) -> tuple[Any, ...]:
        # Arrays that come out of a pickle can be written to; those of an object that is made anew cannot.
        return type(self), (self.deviation, self.freedom, self.arcs, self.absent)

    @classmethod
    def none(cls, times: int, why: str) -> Spread:
        """Nothing is known of the random error."""
        return cls(np.full((3, times), np.nan), np.full((3, times), np.inf), absent=why)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Model(ABC):
    """A joint's impedance over one realization.

    Parameters
    ----------
    method
        The method and its settings, in words.
    sampling_rate
        In Hz.
    time
        Time within a realization in s, shape (time,).
    stiffness, viscosity, inertia
        In N·m/rad, N·m·s/rad and kg·m², shape (time,); NaN where not identified.
    diagnostics
        How the identification went.
    spread
        Its random error, from which the bands follow, or what works it out when a band is first asked for; None where
        the method tells nothing of it.

    Notes
    -----
    A band covers the random error: the truth lies within it in a share ``level`` of repetitions with other noise, as
    far as the method is without bias. What a method's assumptions distort (a change that is smoothed, directions of
    the input that are left out) is no noise and is not in the band; nor is what differs between realizations beyond
    the noise, for which there is :func:`tvsysid.uncertainty.bootstrap`.
    """

    method: str
    sampling_rate: float
    time: Array
    stiffness: Array
    viscosity: Array
    inertia: Array
    diagnostics: Diagnostics
    spread: Spread | Callable[[], Spread] | None = None

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value = value.view()
                value.flags.writeable = False
                object.__setattr__(self, item.name, value)

    @cached_property
    def random_error(self) -> Spread | None:
        """Standard deviations of stiffness, viscosity and inertia, and how well they are known; None if unknown."""
        return self.spread() if callable(self.spread) else self.spread

    def __getstate__(self) -> dict[str, Any]:
        # What works out the random error holds the data; a model that travels takes the result instead.
        return self.__dict__ | {"spread": self.random_error}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # Arrays that come out of a pickle can be written to.
        Model.__post_init__(self)

    def predict(self, ensemble: Ensemble) -> Array:
        """Torque that the model gives for the ensemble's angle.

        Parameters
        ----------
        ensemble
            Realizations of the model's sampling rate and duration; not necessarily those identified from.

        Returns
        -------
        Array
            In N·m, shape (realization, time), context not counted; NaN where lags reach beyond the samples or
            the model does not.

        Raises
        ------
        InputError
            For another sampling rate or duration.
        """
        if ensemble.samples != len(self.time) or abs(ensemble.sampling_rate / self.sampling_rate - 1) > 1e-9:
            raise InputError(
                f"predict: the model has {len(self.time)} samples at {self.sampling_rate:g} Hz, the ensemble "
                f"{ensemble.samples} at {ensemble.sampling_rate:g} Hz; decimate and segment it in the same way"
            )
        return self._predict(ensemble)

    def stiffness_band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Band about the stiffness at each time by itself.

        Parameters
        ----------
        level
            Probability, between 0 and 1, with which the band holds the true value at a time.

        Returns
        -------
        lower, upper : Array
            In N·m/rad, shape (time,); NaN where there is none.

        Raises
        ------
        InputError
            For a level that is not between 0 and 1.

        Warns
        -----
        DataQualityWarning
            If there is none at any time; it says why.
        """
        return self._band(0, level)

    def viscosity_band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Band about the viscosity in N·m·s/rad, as :meth:`stiffness_band`."""
        return self._band(1, level)

    def inertia_band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Band about the inertia in kg·m², as :meth:`stiffness_band`."""
        return self._band(2, level)

    def simultaneous_stiffness_band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Band that holds the true stiffness at all times together with a probability of at least ``level``.

        Wider than :meth:`stiffness_band`, whose parameters and result it has; see
        :func:`tvsysid.numerics.bands.simultaneous_value`.
        """
        return self._band(0, level, simultaneous=True)

    def _band(self, quantity: int, level: float, simultaneous: bool = False) -> tuple[Array, Array]:
        given = self._given_band(f"{'simultaneous_' * simultaneous}{QUANTITIES[quantity]}_band", level)
        if given is not None:
            return given
        spread = self.random_error or Spread.none(len(self.time), "the method tells nothing of its random error")
        deviation = spread.deviation[quantity]
        width = np.full(len(self.time), np.nan)
        known = np.isfinite(deviation)
        if spread.absent and not known.any():
            warnings.warn(f"{QUANTITIES[quantity]}_band: {spread.absent}", DataQualityWarning, stacklevel=3)
        freedom = spread.freedom[quantity][known]
        if simultaneous:
            width[known] = simultaneous_value(level, freedom, spread.arcs[quantity])
        else:
            width[known] = critical_value(level, freedom)
        width *= deviation
        estimate = getattr(self, QUANTITIES[quantity])
        return estimate - width, estimate + width

    def _given_band(self, name: str, level: float) -> tuple[Array, Array] | None:
        """Band that the model has by other means than its spread."""
        return None

    @abstractmethod
    def _predict(self, ensemble: Ensemble) -> Array: ...

    def __repr__(self) -> str:
        known = int(np.isfinite(self.stiffness).sum())
        if known:
            low, high = float(np.nanmin(self.stiffness)), float(np.nanmax(self.stiffness))
            span = f"stiffness {low:.1f} to {high:.1f} N·m/rad"
        else:
            span = "no stiffness"
        doubts = "".join(f"\n  warning: {text}" for text in self.diagnostics.warnings)
        return (
            f"{type(self).__name__}({self.method}: {span} over {len(self.time) / self.sampling_rate:g} s, "
            f"identified at {known} of {len(self.time)} samples, "
            f"{self.diagnostics.parameters:.3g} effective parameters){doubts}"
        )

    def to_xarray(self) -> xr.Dataset:
        """Everything identified as an xarray.Dataset, with units as attributes.

        A frequency response is complex; :func:`tvsysid.recordings.write_models` splits it for the NetCDF file.
        """
        import xarray as xr  # noqa: PLC0415  # heavy

        variables: Labelled = {name: (("time",), getattr(self, name)) for name in QUANTITIES}
        if self.random_error is not None:
            for name, deviation in zip(QUANTITIES, self.random_error.deviation, strict=True):
                variables[f"{name}_deviation"] = (("time",), deviation)
        coordinates: Labelled = {"time": (("time",), self.time)}
        if self.diagnostics.rank is not None:
            variables["rank"] = (("time",), self.diagnostics.rank)
        extra, extra_coordinates = self._identified()
        variables |= extra
        coordinates |= extra_coordinates

        def with_unit(items: Labelled) -> dict[str, Any]:
            return {
                name: (dims, values, {"units": UNITS[name]} if name in UNITS else {})
                for name, (dims, values) in items.items()
            }

        return xr.Dataset(
            with_unit(variables),
            with_unit(coordinates),
            attrs={
                "method": self.method,
                "sampling_rate_hz": self.sampling_rate,
                "effective_parameters": self.diagnostics.parameters,
                "seconds": self.diagnostics.seconds,
                "warnings": "\n".join(self.diagnostics.warnings),
                **self.diagnostics.details,
            },
        )

    def _repr_html_(self) -> str:
        return str(self.to_xarray()._repr_html_())

    def _identified(self) -> tuple[Labelled, Labelled]:
        """Variables and coordinates beyond stiffness, viscosity and inertia."""
        return {}, {}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ImpulseResponseModel(Model):
    """Two-sided impulse response at each time.

    Parameters
    ----------
    impulse_response
        In N·m/rad per second, shape (time, lag).
    lags
        In s, shape (lag,); positive where the input comes before the output.
    """

    impulse_response: Array
    lags: Array

    def _predict(self, ensemble: Ensemble) -> Array:
        n = len(self.lags) // 2
        return _convolve(ensemble, self.impulse_response / self.sampling_rate, n, n)

    def _identified(self) -> tuple[Labelled, Labelled]:
        return {"impulse_response": (("time", "lag"), self.impulse_response)}, {"lag": (("lag",), self.lags)}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FrequencyResponseModel(Model):
    """Frequency response at each time.

    Its prediction convolves the angle with the response's inverse Fourier transform: as many lags as the segments
    that it was estimated from have samples, half of them negative. Frequencies without input are left out. It is good
    where the perturbation reaches a fair part of the Nyquist frequency, as at 100 Hz; decimate first.

    Parameters
    ----------
    frequency_response
        In N·m/rad, complex, shape (time, frequency).
    frequencies
        In Hz, shape (frequency,).
    coherence
        Share of the torque's power that is linearly related to the angle, 0 to 1, shape (time, frequency).
    excited
        Where the angle has at least a millionth of its strongest frequency's power, shape (time, frequency).
    segment
        Samples of the segments.
    """

    frequency_response: ComplexArray
    frequencies: Array
    coherence: Array
    excited: NDArray[np.bool_]
    segment: int

    def _predict(self, ensemble: Ensemble) -> Array:
        response = np.where(self.excited, self.frequency_response, 0.0)
        weights = np.fft.fftshift(np.fft.irfft(response, self.segment, axis=1), axes=1)
        weights[np.isnan(self.frequency_response).any(axis=1)] = np.nan
        return _convolve(ensemble, weights, self.segment // 2, (self.segment - 1) // 2)

    def _identified(self) -> tuple[Labelled, Labelled]:
        variables: Labelled = {
            "frequency_response": (("time", "frequency"), self.frequency_response),
            "coherence": (("time", "frequency"), self.coherence),
        }
        return variables, {"frequency": (("frequency",), self.frequencies)}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SecondOrderModel(Model):
    r"""Stiffness, viscosity and inertia that are sums of known functions of time.

    Its prediction is :math:`k(t)\theta + b(t)\dot\theta + I(t)\ddot\theta`, with the derivatives of
    :func:`tvsysid.numerics.differentiation.differentiate`.

    Parameters
    ----------
    coefficients
        Posterior mean of the coefficients, shape (coefficient,).
    covariance
        Their posterior covariance, shape (coefficient, coefficient).
    labels
        What each coefficient multiplies.
    """

    coefficients: Array
    covariance: Array
    labels: tuple[str, ...]

    def impedance(self, ensemble: Ensemble) -> tuple[Array, Array, Array]:
        """Stiffness, viscosity and inertia that hold for the ensemble, each (time,) or (realization, time)."""
        return self.stiffness, self.viscosity, self.inertia

    def _predict(self, ensemble: Ensemble) -> Array:
        missing = max(0, HALF_WIDTH - ensemble.context)
        out = np.full((len(ensemble), ensemble.samples), np.nan)
        inner = slice(missing, ensemble.samples - missing)
        if inner.stop <= inner.start:
            return out
        first = ensemble.context + missing - HALF_WIDTH
        last = ensemble.angle.shape[1] - first
        signals = differentiate(ensemble.angle[:, first:last], ensemble.sampling_rate)
        impedance = self.impedance(ensemble)
        out[:, inner] = sum(
            coefficient[..., inner] * signal for coefficient, signal in zip(impedance, signals, strict=True)
        )
        return out

    def _identified(self) -> tuple[Labelled, Labelled]:
        variables: Labelled = {
            "coefficients": (("coefficient",), self.coefficients),
            "covariance": (("coefficient", "other_coefficient"), self.covariance),
        }
        return variables, {"coefficient": (("coefficient",), list(self.labels))}


def _convolve(ensemble: Ensemble, weights: Array, before: int, after: int) -> Array:
    """Convolution of the angle with weights (time, lag) for lags from -before to after samples.

    A negative lag needs samples that come after. NaN where the lags reach beyond the ensemble's samples.
    """
    early, late = max(0, after - ensemble.context), max(0, before - ensemble.context)
    out = np.full((len(ensemble), ensemble.samples), np.nan)
    inner = slice(early, ensemble.samples - late)
    if inner.stop > inner.start:
        first = ensemble.context + early - after
        last = ensemble.context + ensemble.samples - late + before
        out[:, inner] = convolve_lags(ensemble.angle[:, first:last], weights[inner])
    return out
