"""What all checks start from: deviations from the mean, the second-order fit, and what it leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tvsysid.impedance import second_order_fit
from tvsysid.quality.finding import NotJudged
from tvsysid.quality.fit import SecondOrder, fit_motion, fit_second_order
from tvsysid.quality.resampling import between, lowered
from tvsysid.quality.statistics import prediction_error
from tvsysid.signals import Array, Ensemble

WHITENING = 0.1
"""Seconds of the past from which noise is predicted."""
ANSWERED = 0.1
"""Share of the torque that must be explained for the impedance to be spoken of."""
NO_ANSWER = "the torque does not answer the angle"


@dataclass(frozen=True, eq=False)
class FittedEnsemble:
    """An ensemble as the checks see it.

    Parameters
    ----------
    given
        What the user gave.
    ensemble
        The same at some 100 Hz.
    """

    given: Ensemble
    ensemble: Ensemble

    @classmethod
    def of(cls, ensemble: Ensemble) -> FittedEnsemble:
        """Take the ensemble down to some 100 Hz."""
        return cls(ensemble, lowered(ensemble))

    def __len__(self) -> int:
        return len(self.ensemble)

    def require(self, realizations: int = 0, *, answer: bool = True) -> None:
        """Raise NotJudged where there are fewer realizations, or where the torque does not answer the angle."""
        if len(self) < realizations:
            raise NotJudged(f"it takes {realizations} realizations")
        if answer and self.explained < ANSWERED:
            raise NotJudged(NO_ANSWER)

    @property
    def rate(self) -> float:
        """In Hz."""
        return self.ensemble.sampling_rate

    @cached_property
    def angle(self) -> Array:
        """Deviation from the mean over realizations in rad, shape (realization, context + time + context)."""
        return _deviation(self.ensemble.angle)

    @cached_property
    def torque(self) -> Array:
        """Deviation from the mean over realizations in N·m, likewise."""
        return _deviation(self.ensemble.torque)

    def core(self, which: str) -> Array:
        """Deviation of ``"angle"`` or ``"torque"`` from the mean, shape (realization, time), context not counted."""
        return (self.angle if which == "angle" else self.torque)[:, self.ensemble.core]

    @cached_property
    def fit(self) -> SecondOrder:
        """Second-order model with stiffness and viscosity free in each bin."""
        return fit_second_order(self.angle, self.torque, self.rate, self.ensemble.context)

    @cached_property
    def parts(self) -> Array:
        """Torque of stiffness, viscosity and inertia in N·m, shape (3, realization, time)."""
        return self.fit.parts

    @cached_property
    def residual(self) -> Array:
        """Torque that the model leaves in N·m, shape (realization, time)."""
        return np.asarray(self.fit.torque - self.parts.sum(axis=0))

    @cached_property
    def explained(self) -> float:
        """Share of the torque's variance that the model explains."""
        return 1.0 - left_by(self.fit, self.residual)

    @property
    def whitening(self) -> int:
        """Samples of the past from which noise is predicted, w; never so many that little is left."""
        return int(max(2, min(round(WHITENING * self.rate), self.fit.torque.shape[1] // 3)))

    @property
    def first_white(self) -> int:
        """Sample of the ensemble, context counted, that the first whitened one is."""
        return self.fit.first + self.whitening

    @cached_property
    def _whitener(self) -> Array:
        return prediction_error(self.residual, self.whitening)

    def whitened(self, signal: Array) -> Array:
        """Signal through the filter that makes the residual white, shape (..., time - w).

        Slow noise, such as that of voluntary torque, would otherwise hide what single realizations tell.
        """
        return np.asarray(lfilter(self._whitener, 1.0, signal, axis=-1)[..., self.whitening :])

    @cached_property
    def white_parts(self) -> Array:
        """Parts of the torque, whitened, shape (3, realization, time - w)."""
        return self.whitened(self.parts)

    @cached_property
    def white_residual(self) -> Array:
        """Residual, whitened, shape (realization, time - w)."""
        return self.whitened(self.residual)

    @cached_property
    def white_fit(self) -> SecondOrder:
        """Fit to what the fit left, whitened, which slow noise makes much less wrong; shares of the first's values."""
        return fit_motion(self.white_parts, self.white_residual, self.rate, 0)

    @cached_property
    def mean_impedance(self) -> tuple[Array, Array]:
        """Stiffness, viscosity and inertia that are constant in time, and their standard errors, each of shape (3,).

        The errors come from the scatter over realizations, so that the noise may have any colour. NaN where the data
        do not tell the three apart.
        """
        motion, count = self.fit.motion, len(self)
        grams = np.einsum("art,brt->rab", motion, motion)
        with_torque = np.einsum("art,rt->ra", motion, self.fit.torque)
        fit = second_order_fit(grams.sum(axis=0)[None], with_torque.sum(axis=0)[None])
        values = fit.impedance[0]
        influence = (with_torque - grams @ values) @ fit.inverse[0]
        return values, np.sqrt(np.sum(influence**2, axis=0) * count / max(count - 1, 1))

    @cached_property
    def own_fits(self) -> tuple[Array, Array]:
        """Second moments of each realization's torque parts, and theirs with its residual: (r, 3, 3) and (r, 3)."""
        parts = self.white_parts.transpose(1, 0, 2)
        return parts @ parts.transpose(0, 2, 1), (parts @ self.white_residual[..., None])[..., 0]

    @cached_property
    def relative_stiffness(self) -> Array:
        """Stiffness of each realization over the median of all, shape (realization,)."""
        grams, moments = self.own_fits
        stiffness = 1 + np.einsum("rb,rb->r", np.linalg.pinv(grams, hermitian=True)[:, 0], moments)
        usual = float(np.median(stiffness))
        return np.asarray(stiffness / usual) if usual > 0 else stiffness

    @cached_property
    def relative_noise(self) -> Array:
        """RMS of each realization's whitened residual over the median of all, shape (realization,)."""
        size = np.sqrt(np.mean(self.white_residual**2, axis=1))
        usual = float(np.median(size))
        return np.asarray(size / usual) if usual > 0 else np.ones_like(size)

    @property
    def order(self) -> NDArray[np.int64]:
        """Realizations in the order in which they were recorded."""
        return np.concatenate(self.ensemble.runs)

    @property
    def half_orders(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Realizations of the first and of the second half of the experiment."""
        order, middle = self.order, len(self) // 2
        return order[:middle], order[middle:]

    @cached_property
    def halves(self) -> tuple[FittedEnsemble, FittedEnsemble]:
        """First and second half of the experiment, each by itself."""
        first, second = (FittedEnsemble(self.given, self.ensemble.select(half)) for half in self.half_orders)
        return first, second

    def levelled(self, angle: Array, torque: Array) -> FittedEnsemble:
        """Fit of the same ensemble less an offset of each realization, shape (realization,)."""
        if not angle.any() and not torque.any():
            return self
        given = self.ensemble
        level = replace(given, angle=given.angle - angle[:, None], torque=given.torque - torque[:, None])
        return FittedEnsemble(self.given, level)

    def synchronised(self, late: float) -> FittedEnsemble:
        """Fit of the same ensemble with the torque taken so many samples later."""
        given, width, whole = self.ensemble, self.ensemble.angle.shape[1], round(late)
        cut = abs(whole)
        if late == 0 or given.context < cut:
            return self
        angle = given.angle[:, cut : width - cut]
        torque = between(given.torque, late - whole)[:, cut + whole : width - cut + whole]
        timely = replace(given, angle=angle, torque=torque, context=given.context - cut, channels={})
        return FittedEnsemble(self.given, timely)


def _deviation(values: Array) -> Array:
    return values - values.mean(axis=0) if len(values) > 1 else values


def left_by(fit: SecondOrder, residual: Array) -> float:
    """Share of the torque's variance that a fit leaves; all of it where there is none."""
    total = float(np.sum(fit.torque**2))
    return float(np.sum(residual**2)) / total if total > 0 else 1.0
