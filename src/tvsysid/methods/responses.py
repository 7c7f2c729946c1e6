"""Models that several methods return: impulse response, frequency response, second-order joint."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.arrays import read_only
from tvsysid.dataset_layout import Labelled
from tvsysid.models import Model
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import FittedWeights, Posterior
from tvsysid.numerics.moments import convolve_lags
from tvsysid.signals import Ensemble


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ImpulseResponseModel(Model):
    """Two-sided impulse response at each time, in N·m/rad per second, shape (time, lag).

    ``lags`` are in s.
    """

    impulse_response: Array = attrs.field(converter=read_only)
    lags: Array = attrs.field(converter=read_only)

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        n = len(self.lags) // 2
        return {"intrinsic": _convolve(ensemble, self.impulse_response / self.sampling_rate, n, n)}

    def _further_variables(self) -> tuple[Labelled, Labelled]:
        return {"impulse_response": (("time", "lag"), self.impulse_response)}, {
            "lag": (("lag",), self.lags)
        }


@attrs.frozen(eq=False, repr=False, kw_only=True)
class FrequencyResponseModel(Model):
    """Frequency response at each time, in N·m/rad.

    Its prediction convolves the angle with the inverse Fourier transform of the response. That has
    as many lags as the segments have samples, half of them negative. The prediction leaves out
    frequencies without input. It is good where the perturbation reaches a fair part of the Nyquist
    frequency, as at 100 Hz; decimate first.

    The complex response, the ``coherence`` and ``excited`` have the shape (time, frequency). The
    ``frequencies`` are in Hz. The coherence is the share of the torque's power that depends
    linearly on the angle. A frequency is excited where the angle has at least a millionth of the
    power at its strongest frequency. ``segment`` is the number of samples of a segment.
    """

    frequency_response: NDArray[np.complex128] = attrs.field(converter=read_only)
    frequencies: Array = attrs.field(converter=read_only)
    coherence: Array = attrs.field(converter=read_only)
    excited: NDArray[np.bool_] = attrs.field(converter=read_only)
    segment: int

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        response = np.where(self.excited, self.frequency_response, 0.0)
        weights = np.fft.fftshift(np.fft.irfft(response, self.segment, axis=1), axes=1)
        weights[np.isnan(self.frequency_response).any(axis=1)] = np.nan
        before, after = self.segment // 2, (self.segment - 1) // 2
        return {"intrinsic": _convolve(ensemble, weights, before, after)}

    def _further_variables(self) -> tuple[Labelled, Labelled]:
        variables: Labelled = {
            "frequency_response": (("time", "frequency"), self.frequency_response),
            "coherence": (("time", "frequency"), self.coherence),
        }
        return variables, {"frequency": (("frequency",), self.frequencies)}


@attrs.frozen(eq=False, repr=False, kw_only=True)
class SecondOrderModel(Model):
    """Stiffness, viscosity and inertia that are sums of known functions of time.

    ``labels`` name the function that each coefficient multiplies.
    """

    posterior: Posterior | FittedWeights
    labels: tuple[str, ...]

    @property
    def coefficients(self) -> Array:
        """Return the posterior mean of the coefficients (coefficient,)."""
        return self.posterior.mean

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance of the coefficients (coefficient, coefficient)."""
        return self.posterior.covariance

    def _further_variables(self) -> tuple[Labelled, Labelled]:
        variables: Labelled = {
            "coefficients": (("coefficient",), self.coefficients),
            "covariance": (("coefficient", "other_coefficient"), self.covariance),
        }
        return variables, {"coefficient": (("coefficient",), list(self.labels))}


def _convolve(ensemble: Ensemble, weights: Array, before: int, after: int) -> Array:
    """Convolve the angle with weights (time, lag) for lags from -before to after samples.

    A negative lag needs samples that come later. The result is NaN where lags reach beyond the
    ensemble's samples.
    """
    early, late = max(0, after - ensemble.context), max(0, before - ensemble.context)
    torque = np.full((len(ensemble), ensemble.samples), np.nan)
    inner = slice(early, ensemble.samples - late)
    if inner.stop > inner.start:
        first = ensemble.context + early - after
        last = ensemble.context + ensemble.samples - late + before
        torque[:, inner] = convolve_lags(ensemble.angle[:, first:last], weights[inner])
    return torque
