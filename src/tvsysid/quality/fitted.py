"""Compute what checks share: deviations from the mean, a second-order fit, whitened signals."""

from __future__ import annotations

from functools import cached_property

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, gaussian_filter1d, maximum_filter1d, median_filter

from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.interpolation import between
from tvsysid.quality.checks import FAULTS, Finding, NotApplicable, judge
from tvsysid.quality.fit import Regressors, SecondOrderFit, constant_impedance
from tvsysid.quality.resampling import known_region, lowered
from tvsysid.quality.statistics import innovations, over_usual, prediction_error
from tvsysid.signals import Array, Ensemble

NOISE_PAST_S, SIGNAL_PAST_S = 0.1, 0.12  # from which noise and signals are predicted
# Standard deviation in samples of a low-pass. Near half the sampling rate, noise in the angle, the
# decimator's aliases and the errors of derivatives look like a delay or a smaller inertia.
LOW_PASS_SAMPLES = 1.0
# Quantiles over which spikes are measured. A PRBS surprises at every switch, noise never.
USUAL_SURPRISE, USUAL_RESIDUAL = 0.99, 0.9
SPIKE_SAMPLES, SPREAD_SAMPLES = 7, 13  # widths of a median filter, and of a spike's derivatives
MIN_ALONE = 1.2  # distance from the median beside it, over the usual, of a spike
MIN_DISTURBANCE = 4.5  # residual beside a spike in the angle, over the usual
SCATTER = 2.0  # of the residual's level at one time by chance, over the usual level
MIN_EXPLAINED = 0.1  # share of the torque without which the joint has no impedance to speak of
NO_RESPONSE = "the torque does not respond to the angle"
NOT_IDENTIFIABLE = "stiffness, viscosity and inertia are not separately identifiable"


@attrs.frozen(eq=False)
class FittedEnsemble:
    """Ensemble for checks: as it was given, and at some 100 Hz with a second-order fit."""

    given: Ensemble
    ensemble: Ensemble
    _findings: dict[str, Finding] = attrs.field(factory=dict, init=False)

    @classmethod
    def of(cls, ensemble: Ensemble) -> FittedEnsemble:
        """Lower the ensemble's rate to some 100 Hz."""
        return cls(ensemble, lowered(ensemble))

    def __len__(self) -> int:
        return len(self.ensemble)

    def finding(self, name: str) -> Finding:
        """Check for a fault, once."""
        if name not in self._findings:
            self._findings[name] = judge(name, self)
        return self._findings[name]

    def require(self, realizations: int = 0, *, response: bool = True) -> None:
        """Raise NotApplicable for too few realizations, or a torque that ignores the angle."""
        if len(self) < realizations:
            raise NotApplicable(f"it takes {realizations} realizations")
        if response and self.explained < MIN_EXPLAINED:
            raise NotApplicable(NO_RESPONSE)

    @property
    def rate(self) -> float:
        """Sampling rate in Hz."""
        return self.ensemble.sampling_rate

    @cached_property
    def angle(self) -> Array:
        """Deviation of the angle from its mean over realizations in rad, (realization, time).

        Time includes the context.
        """
        return self.signal("angle")

    @cached_property
    def torque(self) -> Array:
        """Deviation of the torque from its mean over realizations in N·m, likewise."""
        return self.signal("torque")

    def signal(self, which: str) -> Array:
        """Return the deviation of angle, torque or a channel from its mean over realizations."""
        values = self.ensemble.signal(which)
        return np.asarray(values - values.mean(axis=0))

    def core(self, which: str) -> Array:
        """Return the same deviation without context."""
        return self.signal(which)[:, self.ensemble.core]

    @property
    def region(self) -> slice:
        """Samples that are fitted: those with known derivatives, context counted."""
        return known_region(self.ensemble.samples, self.ensemble.context)

    @cached_property
    def regressors(self) -> Regressors:
        """Angle, velocity and acceleration of the fit."""
        shown = slice(self.region.start - HALF_WIDTH, self.region.stop - HALF_WIDTH)
        return Regressors(differentiate(self.angle, self.rate)[:, :, shown], self.rate)

    @cached_property
    def fit(self) -> SecondOrderFit:
        """Second-order fit with stiffness and viscosity in bins."""
        return self.regressors.fit(self.torque[:, self.region])

    @property
    def explained(self) -> float:
        """Share of the torque's variance that the fit explains."""
        return 1.0 - self.fit.unexplained

    @property
    def whitening(self) -> int:
        """Samples of the past from which noise is predicted, w; at most a third of the fit's."""
        return int(max(2, min(round(NOISE_PAST_S * self.rate), self.fit.torque.shape[1] // 3)))

    @cached_property
    def _whitener(self) -> Array:
        return prediction_error(self.fit.residual, self.whitening)

    def whitened(self, signal: Array) -> Array:
        """Return a signal through the filter that whitens the residual, shape (..., time - w).

        Slow noise, such as that of voluntary torque, would hide what single realizations show.
        """
        taps = self._whitener
        filtered = convolve1d(signal, taps, axis=-1, origin=-(len(taps) // 2))
        return np.asarray(filtered[..., self.whitening :])

    @cached_property
    def white_parts(self) -> Array:
        """Whitened torque of stiffness, viscosity and inertia, (3, realization, time - w)."""
        return self.whitened(self.fit.parts)

    @cached_property
    def white_residual(self) -> Array:
        """Whitened residual, shape (realization, time - w)."""
        return self.whitened(self.fit.residual)

    @cached_property
    def white_fit(self) -> SecondOrderFit:
        """Correction of the fit, in shares of it, by the whitened residual."""
        return Regressors(self.white_parts, self.rate).fit(self.white_residual)

    @property
    def white_region(self) -> slice:
        """Samples of the ensemble, context counted, that are left after whitening."""
        return slice(self.region.start + self.whitening, self.region.stop)

    def seconds(self, white_sample: int) -> float:
        """Return the time of a whitened sample within its realization."""
        return float((white_sample + self.white_region.start - self.ensemble.context) / self.rate)

    def unpredicted(self, signal: Array) -> Array:
        """Return what its past does not predict of a signal, at the whitened samples."""
        region = self.white_region
        order = min(max(2, round(SIGNAL_PAST_S * self.rate)), region.start)
        return innovations(signal, order)[:, region.start - order : region.stop - order]

    @cached_property
    def mean_impedance(self) -> tuple[Array, Array]:
        """Constant stiffness, viscosity and inertia, and their standard errors, shape (3,) each."""
        return constant_impedance(self.fit.motion, self.fit.torque)

    @cached_property
    def smooth_impedance(self) -> tuple[Array, Array]:
        """The same after a low-pass, where noise in the angle hardly lowers the inertia."""
        signals = (self.fit.motion, self.fit.torque)
        return constant_impedance(
            *(gaussian_filter1d(each, LOW_PASS_SAMPLES, axis=-1) for each in signals)
        )

    @cached_property
    def own_fits(self) -> tuple[Array, Array]:
        """Second moments in each realization, whitened: of the parts, and with the residual.

        Their shapes are (realization, 3, 3) and (realization, 3).
        """
        parts = self.white_parts.transpose(1, 0, 2)
        return parts @ parts.transpose(0, 2, 1), (parts @ self.white_residual[..., None])[..., 0]

    @cached_property
    def relative_stiffness(self) -> Array:
        """Stiffness of each realization over the median, shape (realization,)."""
        grams, moments = self.own_fits
        inverse = np.linalg.pinv(grams, hermitian=True)
        return _over_median(1 + np.einsum("rb,rb->r", inverse[:, 0], moments))

    @cached_property
    def relative_noise(self) -> Array:
        """RMS of the whitened residual of each realization over the median, (realization,)."""
        return _over_median(np.sqrt(np.mean(self.white_residual**2, axis=1)))

    def loneliness(self, which: str) -> Array:
        """Return the distance of each sample from the median beside it, over the usual.

        A step has none, and a spike all of its height. Shape (realization, time - w).
        """
        values = self.signal(which)
        distance = np.abs(values - median_filter(values, (1, SPIKE_SAMPLES)))
        return over_usual(distance, USUAL_SURPRISE)[:, self.white_region]

    @cached_property
    def spike_heights(self) -> dict[str, Array]:
        """Height of spikes in angle and torque over the usual, zero elsewhere.

        Neither its past nor its neighbours predict a spike in the angle, and the torque does not
        respond to it. Neither the fit nor the past predicts one in the torque, and none in the
        angle explains it. Shape (realization, time - w).
        """
        angle, torque = (
            over_usual(np.abs(self.unpredicted(own)), USUAL_SURPRISE)
            for own in (self.angle, self.torque)
        )
        residual = over_usual(np.abs(self.white_residual), USUAL_RESIDUAL)
        is_alone = self.loneliness("angle") > MIN_ALONE
        is_disturbed = maximum_filter1d(residual, SPREAD_SAMPLES, axis=1) > MIN_DISTURBANCE
        # A residual that is high at this time in most realizations is no spike, but a change of
        # stiffness within a bin. Spikes at one time leave their mean in all others.
        deviation = self.white_residual - np.median(self.white_residual, axis=0)
        level = np.median(np.abs(deviation), axis=0)
        usual = max(SCATTER * float(np.median(level)), np.finfo(float).tiny)
        residual = residual / np.maximum(1.0, level / usual)
        of_angle = (
            maximum_filter1d(angle, 2 * SPREAD_SAMPLES - 1, axis=1) > FAULTS["angle-spikes"].limit
        )
        return {
            "angle": np.where((angle > 0) & is_alone & is_disturbed, angle, 0.0),
            "torque": np.where((torque > angle) & ~of_angle, residual, 0.0),
        }

    @property
    def order(self) -> NDArray[np.int64]:
        """Realizations in the order of recording."""
        return np.concatenate(self.ensemble.runs)

    @property
    def half_orders(self) -> list[NDArray[np.int64]]:
        """Realizations of the first and of the second half of the experiment."""
        return np.split(self.order, [len(self) // 2])

    @cached_property
    def halves(self) -> list[FittedEnsemble]:
        """First and second half of the experiment, fitted separately."""
        return [FittedEnsemble(self.given, self.ensemble.select(half)) for half in self.half_orders]

    def subtract(self, angle: Array, torque: Array) -> FittedEnsemble:
        """Return the ensemble less an offset of each realization, shape (realization,)."""
        if not angle.any() and not torque.any():
            return self
        old = self.ensemble
        angle, torque = old.angle - angle[:, None], old.torque - torque[:, None]
        return FittedEnsemble(self.given, attrs.evolve(old, angle=angle, torque=torque))

    def advance(self, samples: float) -> FittedEnsemble:
        """Return the ensemble with its torque so many samples earlier, at the cost of context."""
        old, width, whole = self.ensemble, self.ensemble.angle.shape[1], round(samples)
        cut = abs(whole)
        if samples == 0 or old.context < cut:
            return self
        signals = old.mapped(lambda values: values[:, cut : width - cut])
        later = between(old.torque, samples - whole)
        signals["torque"] = later[:, cut + whole : width - cut + whole]
        return FittedEnsemble(self.given, attrs.evolve(old, **signals, context=old.context - cut))


def _over_median(values: Array) -> Array:
    usual = np.median(values)
    return np.asarray(values / usual if usual > 0 else values)
