"""What identification returns: immutable models with estimates, which predict torque.

Axis order and the sign of a lag are decided here and nowhere else::

    axes                    realization, time, lag (or frequency)
    impulse response        y(t) = Σ h(t, τ) u(t - τ) Δt,  τ = -max_lag … +max_lag
                            h[:, 0] is the lag -max_lag, h[:, -1] the lag +max_lag
    positive lag            the input comes before the output
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.checked import Frozen
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.estimates import IMPEDANCE, UNITS, Estimate, frozen
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.moments import convolve_lags
from tvsysid.showing import Shown
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import xarray as xr

ComplexArray = NDArray[np.complex128]
Labelled = dict[
    str, tuple[tuple[str, ...], ArrayLike]
]  # values with the names of their axes, by name
Variables = dict[
    str, tuple[tuple[str, ...], NDArray[Any], dict[str, str]]
]  # axes, values and attributes, by name


class Content(NamedTuple):
    """Content of a dataset or of a NetCDF group."""

    variables: Variables
    coordinates: Variables
    attributes: Mapping[str, str | float]


@attrs.frozen(eq=False)
class Diagnostics(Frozen):
    """How an identification went.

    The effective number of ``parameters`` is that of the whole model, or the mean over time
    where each time has its own; ``rank`` (time,) how many singular values were kept, None for
    methods that keep all or have none; ``strength`` (time,) that of the instrument in closed
    loop (:mod:`tvsysid.methods.shared.instrument`), None without a reference. ``warnings`` say
    what was legal, but makes the result doubtful; ``seconds`` what it took; ``details`` hold
    further numbers.
    """

    parameters: float
    rank: Array | None = None
    strength: Array | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    details: Mapping[str, float] = attrs.field(factory=dict)

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        for name in ("rank", "strength"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(values))


@attrs.frozen(eq=False, repr=False, kw_only=True)
class Model(Shown):
    """What was identified over one realization.

    By a ``method``, told in words with its settings; at a ``time`` in s within a realization,
    shape (time,). The ``estimates`` are by quantity: ``stiffness``, ``viscosity``, ``inertia``,
    ``reflex_gain`` …; ``coordinates`` are the values along their axes other than time and
    realization, by axis; ``diagnostics`` say how the identification went.
    """

    method: str
    sampling_rate: float
    time: Array
    estimates: Mapping[str, Estimate]
    diagnostics: Diagnostics
    coordinates: Mapping[str, Array] = attrs.field(factory=dict)
    torques: Callable[[Ensemble], Mapping[str, Array]] | None = None

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
        """Return the model that a method of your own identified from an ensemble.

        Parameters
        ----------
        ensemble
            Realizations that it was identified from.
        stiffness, viscosity, inertia
            Shape (time,), or one number; NaN where not identified.
        estimates
            Further estimates by quantity, or those with standard errors or other axes.
        coordinates
            Values along further axes of the estimates, by axis.
        pathways
            Function that returns the torque of each pathway for an ensemble, each of shape
            (realization, time). Without it, the torque is that of stiffness, viscosity and inertia.
        parameters
            Effective number of parameters.
        """
        impedance = zip(IMPEDANCE, (stiffness, viscosity, inertia), strict=True)
        given = {name: np.asarray(values) for name, values in impedance if values is not None}
        whole = {
            name: Estimate(
                values if values.ndim else np.full(len(ensemble.time), values), UNITS[name]
            )
            for name, values in given.items()
        }
        return Model(
            method="",
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=whole | dict(estimates or {}),
            diagnostics=Diagnostics(parameters),
            coordinates={name: np.asarray(each) for name, each in (coordinates or {}).items()},
            torques=pathways,
        )

    def __attrs_post_init__(self) -> None:
        for item in attrs.fields(type(self)):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value = value.view()
                value.flags.writeable = False
                object.__setattr__(self, item.name, value)
        coordinates = {
            name: frozen(np.asarray(values)) for name, values in self.coordinates.items()
        }
        object.__setattr__(self, "coordinates", coordinates)
        object.__setattr__(self, "estimates", dict(self.estimates))

    @property
    def stiffness(self) -> Array:
        """In N·m/rad, shape (time,); NaN where not identified."""
        return self.over_time("stiffness")

    @property
    def viscosity(self) -> Array:
        """In N·m·s/rad, shape (time,); NaN where not identified."""
        return self.over_time("viscosity")

    @property
    def inertia(self) -> Array:
        """In kg·m², shape (time,); NaN where not identified."""
        return self.over_time("inertia")

    def over_time(self, quantity: str) -> Array:
        """Estimate over time (time,): the mean over realizations where the method tells them apart, NaN where none."""
        estimate = self.estimates.get(quantity)
        if estimate is None or estimate.axes not in {("time",), ("realization", "time")}:
            return np.full(len(self.time), np.nan)
        return estimate.values if estimate.axes == ("time",) else mean_known(estimate.values)

    def pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        """Torque of each pathway for an ensemble's signals, not necessarily those that the model was identified from.

        By pathway (``"intrinsic"`` alone where the model has one), in N·m, shape (realization,
        time), context not counted; NaN where lags reach beyond the samples or the model does not.

        Raises
        ------
        InputError
            For anything but an ensemble of the model's sampling rate and duration.
        """
        if not isinstance(ensemble, Ensemble):
            raise InputError(
                f"predict: expected an Ensemble, got {type(ensemble).__name__}; cut a Recording "
                "with "
                "tvsysid.preprocess.segment, as the model's data were"
            )
        if (
            ensemble.samples != len(self.time)
            or abs(ensemble.sampling_rate / self.sampling_rate - 1) > 1e-9
        ):
            raise InputError(
                f"predict: the model has {len(self.time)} samples at {self.sampling_rate:g} Hz, "
                "the ensemble "
                f"{ensemble.samples} at {ensemble.sampling_rate:g} Hz; decimate and segment it in "
                "the same way"
            )
        return self._pathways(ensemble)

    def predict(self, ensemble: Ensemble) -> Array:
        """Torque that the model predicts for the ensemble's signals: the sum of its :meth:`pathways`."""
        return np.asarray(sum(self.pathways(ensemble).values()))

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        """Return the torque of each pathway: by default that of a joint of second order."""
        if self.torques is None:
            parts = zip(IMPEDANCE, ensemble.derivatives(), strict=True)
            known = [self.over_time(name) * each for name, each in parts if name in self.estimates]
            return {"intrinsic": np.asarray(sum(known))}
        shape = (len(ensemble), ensemble.samples)
        found = {name: np.asarray(torque) for name, torque in self.torques(ensemble).items()}
        for name, torque in found.items():
            if torque.shape != shape or torque.dtype.kind not in "fiu":
                raise InputError(
                    f"{self.method}: the torque of pathway {name!r} must be real numbers of shape "
                    f"(realization, time) = {shape}, got {torque.dtype} of shape {torque.shape}"
                )
        return found

    def __repr__(self) -> str:
        known = self.stiffness[np.isfinite(self.stiffness)]
        span = (
            f"stiffness {known.min():.1f} to {known.max():.1f} N·m/rad"
            if known.size
            else "no stiffness"
        )
        warned = "".join(f"\n  warning: {text}" for text in self.diagnostics.warnings)
        return (
            f"{type(self).__name__}({self.method}: {span} over "
            f"{len(self.time) / self.sampling_rate:g} s, "
            f"identified at {known.size} of {len(self.time)} samples, "
            f"{self.diagnostics.parameters:.3g} effective parameters){warned}"
        )

    def to_xarray(self, ensemble: Ensemble | None = None) -> xr.Dataset:
        """Everything identified as an xarray.Dataset, with units as attributes.

        Each estimate has beside it, where the method states it, its ``_standard_error``, degrees of
        ``_freedom``, and the ``_lower`` and ``_upper`` limits of its 95 % band. If an ensemble is
        given, the torque of each pathway for it is there too, as ``torque_`` and the pathway's
        name. A frequency response is complex;
        :func:`tvsysid.recordings.write_models` splits it for the NetCDF file.
        """
        import xarray as xr  # noqa: PLC0415  # heavy

        return xr.Dataset(*self.content(ensemble))

    def content(self, ensemble: Ensemble | None = None) -> Content:
        """Return what :meth:`to_xarray` holds, as plain arrays."""
        variables: Labelled = {}
        units = dict(UNITS)
        for name, estimate in self.estimates.items():
            parts: Labelled = {name: (estimate.axes, estimate.values)}
            if (error := estimate.standard_error) is not None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
                    lower, upper = estimate.band()
                beside = {"standard_error": error.values, "lower": lower, "upper": upper}
                parts |= {
                    f"{name}_{what}": (estimate.axes, values) for what, values in beside.items()
                }
                variables = _joined(variables, {f"{name}_freedom": (estimate.axes, error.freedom)})
            variables = _joined(variables, parts)
            units |= dict.fromkeys(parts, estimate.unit)
        coordinates: Labelled = {"time": (("time",), self.time)}
        coordinates = _joined(
            coordinates, {name: ((name,), values) for name, values in self.coordinates.items()}
        )
        over_time = {
            "rank": self.diagnostics.rank,
            "instrument_strength": self.diagnostics.strength,
        }
        found: Labelled = {
            name: (("time",), values) for name, values in over_time.items() if values is not None
        }
        variables = _joined(variables, found)
        extra, extra_coordinates = self._identified()
        variables, coordinates = _joined(variables, extra), _joined(coordinates, extra_coordinates)
        if ensemble is not None:
            torques = {f"torque_{name}": torque for name, torque in self.pathways(ensemble).items()}
            units |= dict.fromkeys(torques, "N m")
            variables = _joined(
                variables, {name: (("realization", "time"), each) for name, each in torques.items()}
            )
            told_apart = {
                len(each.values)
                for each in self.estimates.values()
                if each.axes[:1] == ("realization",)
            }
            if told_apart - {len(ensemble)}:
                raise InputError(
                    f"to_xarray: the model tells {max(told_apart)} realizations apart, the "
                    "ensemble has "
                    f"{len(ensemble)}; give the one that it was identified from, or none"
                )
        _joined(variables, coordinates)

        def with_unit(items: Labelled) -> Variables:
            return {
                name: (dims, np.asarray(values), {"units": units[name]} if name in units else {})
                for name, (dims, values) in items.items()
            }

        about: dict[str, str | float] = {
            "method": self.method,
            "sampling_rate_hz": self.sampling_rate,
            "effective_parameters": self.diagnostics.parameters,
            "seconds": self.diagnostics.seconds,
            "warnings": "\n".join(self.diagnostics.warnings),
            **self.diagnostics.details,
        }
        return Content(with_unit(variables), with_unit(coordinates), about)

    def _identified(self) -> tuple[Labelled, Labelled]:
        """Variables and coordinates beside the estimates."""
        return {}, {}


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ImpulseResponseModel(Model):
    """Two-sided impulse response at each time, in N·m/rad per second, shape (time, lag).

    ``lags`` in s.
    """

    impulse_response: Array
    lags: Array

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        n = len(self.lags) // 2
        return {"intrinsic": _convolve(ensemble, self.impulse_response / self.sampling_rate, n, n)}

    def _identified(self) -> tuple[Labelled, Labelled]:
        return {"impulse_response": (("time", "lag"), self.impulse_response)}, {
            "lag": (("lag",), self.lags)
        }


@attrs.frozen(eq=False, repr=False, kw_only=True)
class FrequencyResponseModel(Model):
    """Frequency response at each time.

    Its prediction convolves the angle with the response's inverse Fourier transform: as many lags
    as the segments that it was estimated from have samples, half of them negative. Frequencies
    without input are left out. It is good where the perturbation reaches a fair part of the Nyquist
    frequency, as at 100 Hz; decimate first.

    Response in N·m/rad, complex, at these ``frequencies`` in Hz; ``coherence``, the share of the
    torque's power that is linearly related to the angle; and whether a frequency is ``excited``:
    the angle has at least a millionth of its strongest frequency's power there; each of shape
    (time, frequency). ``segment``: samples of the segments.
    """

    frequency_response: ComplexArray
    frequencies: Array
    coherence: Array
    excited: NDArray[np.bool_]
    segment: int

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        response = np.where(self.excited, self.frequency_response, 0.0)
        weights = np.fft.fftshift(np.fft.irfft(response, self.segment, axis=1), axes=1)
        weights[np.isnan(self.frequency_response).any(axis=1)] = np.nan
        return {
            "intrinsic": _convolve(ensemble, weights, self.segment // 2, (self.segment - 1) // 2)
        }

    def _identified(self) -> tuple[Labelled, Labelled]:
        variables: Labelled = {
            "frequency_response": (("time", "frequency"), self.frequency_response),
            "coherence": (("time", "frequency"), self.coherence),
        }
        return variables, {"frequency": (("frequency",), self.frequencies)}


class Posterior(Protocol):
    """Posterior of coefficients."""

    @property
    def mean(self) -> Array:
        """Of shape (coefficient,)."""
        ...  # pragma: no cover

    @property
    def covariance(self) -> Array:
        """Of shape (coefficient, coefficient)."""
        ...  # pragma: no cover


@attrs.frozen(eq=False, repr=False, kw_only=True)
class SecondOrderModel(Model):
    r"""Stiffness, viscosity and inertia that are sums of known functions of time.

    Its prediction is :math:`k(t)\theta + b(t)\dot\theta + I(t)\ddot\theta`, with the derivatives of
    :meth:`tvsysid.Ensemble.derivatives`. It keeps the ``posterior`` of the coefficients, and what each multiplies
    (``labels``).
    """

    posterior: Posterior
    labels: tuple[str, ...]

    @property
    def coefficients(self) -> Array:
        """Posterior mean of the coefficients, shape (coefficient,)."""
        return frozen(self.posterior.mean)

    @property
    def covariance(self) -> Array:
        """Posterior covariance of the coefficients, shape (coefficient, coefficient)."""
        return frozen(self.posterior.covariance)

    def impedance(self, ensemble: Ensemble) -> tuple[Array, Array, Array]:
        """Stiffness, viscosity and inertia that hold for the ensemble, each (time,) or (realization, time)."""
        return self.stiffness, self.viscosity, self.inertia

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        derivatives = ensemble.derivatives()
        return {
            "intrinsic": np.asarray(sum(map(np.multiply, self.impedance(ensemble), derivatives)))
        }

    def _identified(self) -> tuple[Labelled, Labelled]:
        variables: Labelled = {
            "coefficients": (("coefficient",), self.coefficients),
            "covariance": (("coefficient", "other_coefficient"), self.covariance),
        }
        return variables, {"coefficient": (("coefficient",), list(self.labels))}


def _joined(items: Labelled, further: Labelled) -> Labelled:
    """Both, none of which may have the name of another."""
    if twice := items.keys() & further.keys():
        raise InputError(
            f"to_xarray: two variables have the name {min(twice)!r}; give the estimate another name"
        )
    return items | further


def _convolve(ensemble: Ensemble, weights: Array, before: int, after: int) -> Array:
    """Convolution of the angle with weights (time, lag) for lags from -before to after samples.

    A negative lag needs samples that come after. NaN where the lags reach beyond the ensemble's
    samples.
    """
    early, late = max(0, after - ensemble.context), max(0, before - ensemble.context)
    out = np.full((len(ensemble), ensemble.samples), np.nan)
    inner = slice(early, ensemble.samples - late)
    if inner.stop > inner.start:
        first = ensemble.context + early - after
        last = ensemble.context + ensemble.samples - late + before
        out[:, inner] = convolve_lags(ensemble.angle[:, first:last], weights[inner])
    return out
