"""Compute what checks share: deviations from the mean over realizations, and a fit to them."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from tvsysid.errors import InputError
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.decimation import resampled
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.interpolation import advanced
from tvsysid.numerics.second_order import second_order_fit
from tvsysid.quality.checks import Finding, NotApplicable, judge
from tvsysid.quality.statistics import TINY, filtered, over_usual, whitener
from tvsysid.signals import Array, Ensemble, check_ensemble

MIN_BIN_SAMPLES, MIN_POOLED_SAMPLES = 5, 100  # of a bin: in a realization, and in all together
MIN_BINS = 10  # of a realization, if its bins are longer than MIN_BIN_SAMPLES
NOISE_PAST = 10  # samples from which noise is predicted
MIN_RATE_HZ = 100.0
MIN_KNOWN_SAMPLES = 30  # of a realization, with known derivatives
# Standard deviation in samples of a low-pass. Near half the sampling rate, noise in the angle, the
# decimator's aliases and the errors of derivatives look like a delay or a smaller inertia.
LOW_PASS_SAMPLES = 1.0
MIN_EXPLAINED = 0.1  # smallest share of the torque that an impedance explains
SI_UNITS = {"angle": "rad", "torque": "N·m"}
NO_RESPONSE = "the torque does not respond to the angle"


@attrs.frozen(eq=False)
class SecondOrderFit:
    r"""Least-squares fit of :math:`y = k(t)\theta + b(t)\dot\theta + I\ddot\theta`.

    Each bin of time has its own k and b. I is common to all bins.

    Parameters
    ----------
    motion
        Angle, velocity and acceleration, shape (3, realization, time).
    torque
        y in N·m, shape (realization, time).
    """

    motion: Array
    torque: Array

    @cached_property
    def bins(self) -> NDArray[np.int64]:
        """Bin of each sample, shape (time,). Few realizations need longer bins."""
        realizations, samples = self.torque.shape
        enough = min(math.ceil(MIN_POOLED_SAMPLES / realizations), samples // MIN_BINS)
        length = max(MIN_BIN_SAMPLES, enough)
        return np.minimum(np.arange(samples) // length, samples // length - 1)

    @cached_property
    def impedance(self) -> Array:
        """Stiffness, viscosity and inertia at each sample, shape (3, time).

        The least-squares problem is partitioned: acceleration and torque are first regressed on
        the angle and velocity of each bin, and the inertia is fitted to what is left of both.
        """
        products = np.einsum("art,brt->tab", self.motion, [*self.motion, self.torque])
        sums = np.add.reduceat(products, np.flatnonzero(np.diff(self.bins, prepend=-1)))
        inner, cross = np.split(sums[:, :2], 2, axis=2)  # sums of each bin are (3, 4)
        ridge = 1e-12 * np.trace(inner, axis1=1, axis2=2).mean() + TINY
        weights = np.linalg.solve(inner + ridge * np.eye(2), cross)
        left = np.sum(sums[:, 2, 2:], axis=0) - np.einsum("ba,bac->c", cross[..., 0], weights)
        inertia = left[1] / left[0] if left[0] > 0 else 0.0
        weights = weights[..., 1] - inertia * weights[..., 0]
        return np.insert(weights, 2, inertia, axis=1)[self.bins].T

    @cached_property
    def parts(self) -> Array:
        """Torque of stiffness, viscosity and inertia in N·m, shape (3, realization, time)."""
        return self.motion * self.impedance[:, None]

    @cached_property
    def residual(self) -> Array:
        """Torque that the fit does not explain in N·m, shape (realization, time)."""
        return self.torque - self.parts.sum(axis=0)

    @cached_property
    def explained(self) -> float:
        """Share of the torque's power that the fit explains, 0 for a torque of zero."""
        total = np.sum(self.torque**2)
        return float((total - np.sum(self.residual**2)) / max(total, TINY))

    @property
    def mean_impedance(self) -> tuple[Array, Array]:
        """Constant stiffness, viscosity and inertia, and their standard errors, shape (3,) each."""
        return constant_impedance(self.motion, self.torque)

    @property
    def smooth_impedance(self) -> tuple[Array, Array]:
        """The same after a low-pass, where noise in the angle hardly lowers the inertia."""
        return constant_impedance(*map(low_passed, (self.motion, self.torque)))

    @cached_property
    def _whitener(self) -> Array:
        return whitener(self.residual, NOISE_PAST)

    def whitened(self, signal: Array) -> Array:
        """Return a signal through the filter that whitens the residual, shape (..., time - w).

        Slow noise, such as that of voluntary torque, would hide what single realizations show.
        """
        return filtered(signal, self._whitener)

    @cached_property
    def white_parts(self) -> Array:
        """Whitened torque of stiffness, viscosity and inertia, (3, realization, time - w)."""
        return self.whitened(self.parts)

    @cached_property
    def white_residual(self) -> Array:
        """Whitened residual, shape (realization, time - w)."""
        return self.whitened(self.residual)

    @cached_property
    def own_moments(self) -> tuple[Array, Array, Array]:
        """Second moments in each realization, whitened: of the parts, and with the residual.

        Their shapes are (realization, 3, 3) and (realization, 3). The last are inverses of the
        former.
        """
        parts = self.white_parts.transpose(1, 0, 2)
        grams = parts @ parts.transpose(0, 2, 1)
        inverses = np.asarray(np.linalg.pinv(grams, hermitian=True), float)
        return grams, (parts @ self.white_residual[..., None])[..., 0], inverses

    @property
    def relative_stiffness(self) -> Array:
        """Stiffness of each realization over the median, shape (realization,)."""
        _, moments, inverses = self.own_moments
        return over_usual(1 + np.einsum("rb,rb->r", inverses[:, 0], moments), 0.5)

    @property
    def relative_noise(self) -> Array:
        """RMS of the whitened residual of each realization over the median, (realization,)."""
        return over_usual(np.sqrt(np.mean(self.white_residual**2, axis=1)), 0.5)

    def of(self, realizations: NDArray[np.int64] | slice) -> SecondOrderFit:
        """Return the fit to some of the realizations, as deviations from their own mean."""
        motion = self.motion[:, realizations]
        torque = self.torque[realizations]
        motion = motion - motion.mean(axis=1, keepdims=True)
        return SecondOrderFit(motion, torque - torque.mean(axis=0))


@attrs.frozen(eq=False)
class FittedEnsemble:
    """Ensemble for checks: as it was given, and at some 100 Hz with a second-order fit."""

    given: Ensemble
    ensemble: Ensemble
    _findings: dict[str, Finding] = attrs.field(factory=dict, init=False)

    @classmethod
    def of(cls, ensemble: Ensemble) -> FittedEnsemble:
        """Lower the ensemble's rate to some 100 Hz. Raise InputError if it cannot be fitted."""
        check_ensemble("diagnose", ensemble)
        data = cls(ensemble, at_diagnosis_rate(ensemble))
        known = data.region.stop - data.region.start
        if len(ensemble) < 2 or known < MIN_KNOWN_SAMPLES:
            raise InputError(
                f"diagnose: expected at least 2 realizations with {MIN_KNOWN_SAMPLES} samples at "
                f"which derivatives are known, got {len(ensemble)} with {known} at {data.rate:g} "
                f"Hz; cut with another period, or with {HALF_WIDTH / data.rate:g} s of context"
            )
        return data

    def __len__(self) -> int:
        return len(self.ensemble)

    def finding(self, name: str) -> Finding:
        """Check for a fault, once."""
        if name not in self._findings:
            self._findings[name] = judge(name, self)
        return self._findings[name]

    def require(self, realizations: int = MIN_TESTED_REALIZATIONS, response: bool = True) -> None:
        """Raise NotApplicable for too few realizations, or a torque that ignores the angle."""
        if len(self) < realizations:
            raise NotApplicable(f"it takes {realizations} realizations")
        if response and self.fit.explained < MIN_EXPLAINED:
            raise NotApplicable(NO_RESPONSE)

    @property
    def rate(self) -> float:
        """Sampling rate in Hz."""
        return self.ensemble.sampling_rate

    def signal(self, which: str) -> Array:
        """Return the deviation of angle, torque or a channel from its mean over realizations.

        Its shape is (realization, time), context included.
        """
        values = self.ensemble.signal(which)
        return values - values.mean(axis=0)

    def core(self, which: str) -> Array:
        """Return the same deviation without context."""
        return self.signal(which)[:, self.ensemble.core]

    @cached_property
    def angle(self) -> Array:
        """Deviation of the angle in rad."""
        return self.signal("angle")

    @cached_property
    def torque(self) -> Array:
        """Deviation of the torque in N·m."""
        return self.signal("torque")

    @property
    def region(self) -> slice:
        """Samples that are fitted, context counted: all but those at the edges of a record.

        Their derivatives are known.
        """
        context = self.ensemble.context
        margin = max(context, HALF_WIDTH)
        return slice(margin, max(margin, self.ensemble.samples + 2 * context - margin))

    @cached_property
    def fit(self) -> SecondOrderFit:
        """Second-order fit with stiffness and viscosity in bins."""
        shown = slice(self.region.start - HALF_WIDTH, self.region.stop - HALF_WIDTH)
        motion = differentiate(self.angle, self.rate)[:, :, shown]
        return SecondOrderFit(motion, self.torque[:, self.region])

    def unpredicted(self, signal: Array) -> Array:
        """Return the part of a signal that its past does not predict, at the whitened samples."""
        first = self.region.start - HALF_WIDTH
        stop = self.region.stop - HALF_WIDTH
        return filtered(signal, whitener(signal, HALF_WIDTH))[:, first + NOISE_PAST : stop]

    @property
    def order(self) -> NDArray[np.int64]:
        """Realizations in the order of recording."""
        return np.concatenate(self.ensemble.runs)

    @property
    def halves(self) -> list[NDArray[np.int64]]:
        """Realizations of the first and of the second half of the experiment."""
        return np.split(self.order, [len(self) // 2])

    def changed(self, **signals: Any) -> FittedEnsemble:
        """Return the ensemble with other signals."""
        if not signals:
            return self  # with all that is already fitted to it
        return FittedEnsemble(self.given, attrs.evolve(self.ensemble, **signals))

    def advance(self, samples: float) -> FittedEnsemble:
        """Return the ensemble with its torque so many samples earlier."""
        return self.changed(torque=advanced(self.ensemble.torque, samples))


def low_passed(signal: Array, deviation: float = LOW_PASS_SAMPLES) -> Array:
    """Return a signal (..., time) through a Gaussian low-pass of so many samples."""
    return gaussian_filter1d(signal, deviation, axis=-1)


def constant_impedance(motion: Array, torque: Array) -> tuple[Array, Array]:
    """Fit constant stiffness, viscosity and inertia. Return values and standard errors, (3,) each.

    The errors come from the scatter over realizations, so the noise may have any colour. Both are
    NaN if the three are not separately identifiable.
    """
    count = len(torque)
    grams = np.einsum("art,brt->rab", motion, motion)
    cross = np.einsum("art,rt->ra", motion, torque)
    fit = second_order_fit(grams.sum(axis=0)[None], cross.sum(axis=0)[None])
    values, inverse = (each[0] for each in fit)
    influence = (cross - grams @ values) @ inverse
    return values, np.sqrt(np.sum(influence**2, axis=0) * count / (count - 1))


def at_diagnosis_rate(ensemble: Ensemble) -> Ensemble:
    """Return an ensemble at some 100 Hz, with a whole number of samples per realization.

    The signals pass the low-pass of :func:`tvsysid.preprocess.decimate`, a windowed sinc, which
    also interpolates where the new samples lie between the old ones.
    """
    samples, context = ensemble.samples, ensemble.context
    wanted = math.ceil(samples * MIN_RATE_HZ / ensemble.sampling_rate)
    count = max(wanted, MIN_KNOWN_SAMPLES + 2 * HALF_WIDTH)
    if count > samples // 2:
        return ensemble
    step, margin = samples / count, context * count // samples
    places = context + step * np.arange(-margin, count + margin)
    signals = attrs.evolve(ensemble, recorded_angle=None).mapped(
        lambda values: resampled(values, places, step)
    )
    if step.is_integer():
        recorded = ensemble.angle_as_recorded[:, int(places[0]) : int(places[-1] + step)]
        signals["recorded_angle"] = recorded.reshape(*signals["angle"].shape, -1)
    return attrs.evolve(
        ensemble, **signals, context=margin, sampling_rate=ensemble.sampling_rate / step
    )
