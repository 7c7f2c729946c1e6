"""Model a joint with two pathways: an intrinsic response to the angle, and a driven reflex."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Self

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.dataset_layout import UNITS, Labelled
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.stretch import recorded_velocity, stretch
from tvsysid.signals import Array, Ensemble

DIRECTIONS = (1, -1)  # of stretch
PATHWAYS = ("intrinsic", "reflex")


@attrs.frozen
class Stretch:
    """Velocity of the total angle beyond a ``threshold`` in rad/s.

    ``direction`` is that of stretch, 1 or -1; 0 is none. If a channel of ``emg`` is named, its
    signal takes the place of the velocity.
    """

    threshold: float = 0.0
    direction: int = 1
    emg: str | None = None

    @property
    def gain_unit(self) -> str:
        """Return the unit of the reflex gain."""
        return UNITS["reflex_gain"] if self.emg is None else "N m/V"

    def __call__(self, ensemble: Ensemble) -> Array:
        """Return the signal. See :func:`tvsysid.numerics.stretch.stretch`."""
        if self.emg is not None:
            return ensemble.signal(self.emg)
        return stretch(*velocity_of(ensemble), self.threshold, self.direction)


# A drive returns the signal (realization, context + time + context) that drives a reflex.
Drive = Callable[[Ensemble], Array]


@lru_cache(maxsize=1)  # drives of the same ensemble follow each other
def velocity_of(ensemble: Ensemble) -> tuple[Array, int]:
    """Return the velocity of the total angle in rad/s, and the ratio of the sampling rates.

    The velocity (realization, time * ratio) has the recorded rate.
    """
    recorded = ensemble.angle_as_recorded
    return recorded_velocity(recorded, ensemble.sampling_rate), recorded.shape[-1]


def history(ensemble: Ensemble, values: Array, samples: int) -> Array:
    """Return the values of each realization with ``samples`` samples of history before it.

    The shape is (realization, samples + time); later context is cut. The history comes from the
    realization before where the two follow each other, and from the context of the first one. It
    is NaN where nothing was recorded. ``values`` have shape
    (realization, context + time + context).
    """
    core = ensemble.core
    out = np.empty((len(ensemble), samples + ensemble.samples))
    for run in ensemble.runs:
        line = np.concatenate([values[run[0], : core.start], values[run, core].ravel()])
        line = np.pad(line, (samples, 0), constant_values=np.nan)[core.start :]
        out[run] = sliding_window_view(line, out.shape[1])[:: ensemble.samples]
    return out


@lru_cache(maxsize=1)  # fits with one threshold follow each other
def driven(ensemble: Ensemble, drive: Drive, samples: int) -> Array:
    """Return the signal of a drive with its :func:`history`."""
    return history(ensemble, drive(ensemble), samples)


@attrs.frozen(eq=False, repr=False, kw_only=True)
class TwoPathwayModel(ImpulseResponseModel):
    r"""Intrinsic and reflex pathway, side by side.

    .. math:: y(t) = \sum_\tau h(t, \tau)\, \theta(t - \tau)\, \Delta t
              + \sum_\tau p(t, \tau)\, f(t - \tau)\, \Delta t

    The ``reflex_response`` p, shape (time, lag), is in N·m/rad where the ``drive`` f is a
    velocity in rad/s; the ``reflex_lags`` in s are evenly spaced, none of them negative. f is a
    static function of the velocity, or a measured signal. At the last ``optional_lags`` of them,
    it counts as the mean of the realizations where it was not recorded. Where the ensemble's mean
    is subtracted, the reflex's torque loses its mean too.
    """

    reflex_response: Array
    reflex_lags: Array
    drive: Drive
    optional_lags: int = 0

    def with_details(self, ensemble: Ensemble) -> Self:
        """Return the model with details: explained shares of the torque, direction of stretch.

        They are shares of the torque's variance in %, of both pathways together and of each alone.
        """
        pathways = self.pathways(ensemble)
        parts = {f"vaf_{name}": part for name, part in pathways.items()}
        parts["vaf"] = np.sum([*pathways.values()], axis=0)
        # NaN where a pathway is unknown
        torque = ensemble.torque[:, ensemble.core] + 0 * parts["vaf"]
        details = dict(self.diagnostics.details)
        for name, part in parts.items():
            details[name] = 100 * float(1 - np.nanvar(torque - part) / np.nanvar(torque))
        if isinstance(self.drive, Stretch):
            details["direction"] = float(self.drive.direction)
        return attrs.evolve(self, diagnostics=attrs.evolve(self.diagnostics, details=details))

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        return {**super()._pathways(ensemble), "reflex": self._reflex_torque(ensemble)}

    def _reflex_torque(self, ensemble: Ensemble) -> Array:
        first, late = round(self.reflex_lags[0] * self.sampling_rate), len(self.reflex_lags) - 1
        past = driven(ensemble, self.drive, first + late)[:, : late + ensemble.samples]
        filled = np.nan_to_num(np.where(np.isnan(past), mean_known(past), past))
        reflex = convolve_lags(filled, self.reflex_response / self.sampling_rate)
        # Only the first values are missing. So a sample lacks some if it lacks its earliest one.
        earliest = slice(self.optional_lags, self.optional_lags + ensemble.samples)
        reflex[np.isnan(past[:, earliest])] = np.nan
        if ensemble.mean_subtracted:
            reflex -= mean_known(reflex)
        return reflex

    def _further_variables(self) -> tuple[Labelled, Labelled]:
        variables, coordinates = super()._further_variables()
        variables["reflex_response"] = (("time", "reflex_lag"), self.reflex_response)
        coordinates = {**coordinates, "reflex_lag": (("reflex_lag",), self.reflex_lags)}
        return variables, coordinates
