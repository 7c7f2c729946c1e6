"""Model a joint with two pathways: an intrinsic response to the angle, and a driven reflex."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Protocol, Self

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.dataset_layout import UNITS, Labelled
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.models import Estimate, StandardError
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.stretch import recorded_velocity, stretch
from tvsysid.signals import Array, Ensemble

NO_BAND = "the method's authors state none for two pathways that are identified in turn"
DIRECTIONS = (1, -1)  # of stretch
PATHWAYS = ("intrinsic", "reflex")


class Drive(Hashable, Protocol):
    """Signal that drives the dynamics of a reflex: a small object that can be pickled."""

    def __call__(self, ensemble: Ensemble) -> Array:
        """Return the drive (realization, context + time + context), such as a velocity in rad/s."""
        ...  # pragma: no cover

    def curve(self) -> tuple[Array, Array] | None:
        """Return velocities in rad/s and the drive at each; it is linear between them.

        None if the drive is not a function of the velocity.
        """
        ...  # pragma: no cover


@attrs.frozen
class Stretch:
    """Velocity of the total angle beyond a ``threshold`` in rad/s.

    ``direction`` is that of stretch, 1 or -1.
    """

    threshold: float = 0.0
    direction: int = 1

    def __call__(self, ensemble: Ensemble) -> Array:
        """See :func:`tvsysid.numerics.stretch.stretch`."""
        return stretch(*velocity_of(ensemble), self.threshold, self.direction)

    def curve(self) -> tuple[Array, Array]:
        """See :meth:`Drive.curve`; as straight beyond it."""
        velocity = np.array([-1.0, self.threshold, self.threshold + 1.0])
        order = slice(None, None, self.direction)
        return self.direction * velocity[order], np.array([0.0, 0.0, self.direction])[order]


@attrs.frozen
class Measured:
    """Measured channel that drives the reflex."""

    name: str

    def __call__(self, ensemble: Ensemble) -> Array:
        """Return the signal of the channel, unchanged."""
        return ensemble.signal(self.name)

    def curve(self) -> None:
        """See :meth:`Drive.curve`."""


def rectified_velocities(ensemble: Ensemble) -> Array:
    """Return the velocity rectified in either direction.

    Its shape is (2, realization, context + time + context).
    """
    return np.stack([Stretch(direction=direction)(ensemble) for direction in DIRECTIONS])


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
        head = values[run[0], max(0, core.start - samples) : core.start]
        missing = np.full(samples - len(head), np.nan)
        line = np.concatenate([missing, head, values[run, core].ravel()])
        out[run] = sliding_window_view(line, out.shape[1])[:: ensemble.samples]
    return out


@attrs.frozen(eq=False, repr=False, kw_only=True)
class TwoPathwayModel(ImpulseResponseModel):
    r"""Intrinsic and reflex pathway, side by side.

    .. math:: y(t) = \sum_\tau h(t, \tau)\, \theta(t - \tau)\, \Delta t
              + \sum_\tau p(t, \tau)\, f(t - \tau)\, \Delta t

    The ``reflex_response`` p, shape (time, lag), is in N·m/rad where the ``drive`` f is a
    velocity in rad/s; the ``reflex_lags`` in s are evenly spaced, none of them negative. f is a
    static function of the velocity, or a measured signal. Where the ensemble's mean is
    subtracted, the reflex's torque loses its mean too.
    """

    reflex_response: Array
    reflex_lags: Array
    drive: Drive

    @classmethod
    def beside(
        cls,
        intrinsic: ImpulseResponseModel,
        ensemble: Ensemble,
        reflex: Array,
        drive: Drive,
        first: int,
        details: Mapping[str, float],
        unit: str = UNITS["reflex_gain"],
    ) -> Self:
        """Return a model of an intrinsic pathway with a reflex of weights (time, lag) beside it.

        The lags begin with ``first``. The gain is the area under the reflex's response. No
        estimate has a band.
        """
        rate, none = ensemble.sampling_rate, StandardError.none(ensemble.samples, NO_BAND)
        gain = Estimate(reflex.sum(axis=1), unit)
        estimates = {**intrinsic.estimates, "reflex_gain": gain}
        diagnostics = intrinsic.diagnostics
        known = {item.name: getattr(intrinsic, item.name) for item in attrs.fields(type(intrinsic))}
        known["estimates"] = {n: attrs.evolve(each, error=none) for n, each in estimates.items()}
        known["diagnostics"] = attrs.evolve(diagnostics, details={**diagnostics.details, **details})
        lags = (first + np.arange(reflex.shape[1])) / rate
        model = cls(**known, reflex_response=reflex * rate, reflex_lags=lags, drive=drive)
        return model.with_shares(ensemble)

    def with_shares(self, ensemble: Ensemble) -> Self:
        """Return the model with the shares of the torque that it and its pathways explain, in %."""
        shares = explained_shares(ensemble.torque[:, ensemble.core], self.pathways(ensemble))
        details = {**self.diagnostics.details, **shares}
        return attrs.evolve(self, diagnostics=attrs.evolve(self.diagnostics, details=details))

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        first, late = round(self.reflex_lags[0] * self.sampling_rate), len(self.reflex_lags) - 1
        past = history(ensemble, self.drive(ensemble), first + late)[:, : late + ensemble.samples]
        missing = np.isnan(past)
        reflex = convolve_lags(
            np.where(missing, 0.0, past), self.reflex_response / self.sampling_rate
        )
        reflex[missing[:, : ensemble.samples]] = np.nan  # what is missing lies before all else
        if ensemble.mean_subtracted:
            reflex -= mean_known(reflex)
        return {**super()._pathways(ensemble), "reflex": reflex}

    def _identified(self) -> tuple[Labelled, Labelled]:
        variables, coordinates = super()._identified()
        variables["reflex_response"] = (("time", "reflex_lag"), self.reflex_response)
        coordinates = {**coordinates, "reflex_lag": (("reflex_lag",), self.reflex_lags)}
        if curve := self.drive.curve():
            coordinates["velocity"], variables["nonlinearity"] = (
                (("velocity",), values) for values in curve
            )
        return variables, coordinates


def explained_shares(torque: Array, pathways: Mapping[str, Array]) -> dict[str, float]:
    """Return the shares of the torque's square that pathways explain, together and alone, in %."""
    parts = {"vaf": np.sum(list(pathways.values()), axis=0)}
    parts |= {f"vaf_{name}": part for name, part in pathways.items()}
    known = np.isfinite(parts["vaf"])
    power = float(np.sum(torque[known] ** 2))
    return {
        name: 100 * (1 - float(np.sum((torque - part)[known] ** 2)) / power)
        for name, part in parts.items()
    }
