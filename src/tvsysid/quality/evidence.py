"""What all checks start from: deviations from the mean, the second-order fit, what it leaves, and statistics."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import correlate1d
from scipy.signal import firwin, lfilter, oaconvolve
from scipy.special import stdtr

from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.preprocess import decimate
from tvsysid.quality.fit import SecondOrder, fit_motion, fit_second_order
from tvsysid.signals import Ensemble, Recording

Array = NDArray[np.float64]

LOWEST_RATE = 100.0
"""Rate in Hz that the checks need; what is above is taken down to it or little more."""
LEAST_REALIZATIONS = 8
"""Fewer give no spread over realizations to judge by."""
SHORTEST = 30
"""Samples of a realization whose derivatives must be known."""
CHANCE = 1e-5
"""Probability below which no check takes what it sees for chance."""
WHITENING = 0.1
"""Seconds before from which noise is foretold."""
TAPS = 3
"""Samples of the lower rate that the low-pass of a rate which does not divide is long, as that to a tenth is."""
SINC = 12
"""Samples to either side that a value between samples is made from."""
RIDGE = 1e-9
"""Share of the regressors' mean power that keeps their fit from falling apart."""


@dataclass(frozen=True, eq=False)
class Evidence:
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
    def of(cls, ensemble: Ensemble) -> Evidence:
        """Take the ensemble down to some 100 Hz."""
        return cls(ensemble, lowered(ensemble))

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
        """Samples before from which noise is foretold, w; never so many that little is left."""
        return int(max(2, min(round(WHITENING * self.rate), self.fit.torque.shape[1] // 3)))

    @cached_property
    def _whitener(self) -> Array:
        return np.concatenate([[1.0], -_prediction(self.residual, self.whitening)[::-1]])

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
    def mean_impedance(self) -> tuple[Array, Array]:
        """Stiffness, viscosity and inertia that are constant in time, and their standard errors, each of shape (3,).

        The errors come from the scatter over realizations, so that the noise may have any colour.
        """
        motion = self.fit.motion
        gram = np.einsum("art,brt->ab", motion, motion)
        with_torque = np.einsum("art,rt->ra", motion, self.fit.torque)
        scale = np.sqrt(np.diag(gram))
        scale = np.where(scale > 0, scale, 1.0)
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
        values = inverse @ with_torque.sum(axis=0)
        grams = np.einsum("art,brt->rab", motion, motion)
        influence = (with_torque - grams @ values) @ inverse
        count = len(influence)
        return values, np.sqrt(np.sum(influence**2, axis=0) * count / max(count - 1, 1))

    def levelled(self, angle: Array, torque: Array) -> Evidence:
        """Evidence of the same ensemble less an offset of each realization, shape (realization,)."""
        if not angle.any() and not torque.any():
            return self
        given = self.ensemble
        return Evidence(
            self.given,
            replace(given, angle=given.angle - angle[:, None], torque=given.torque - torque[:, None]),
        )

    def synchronised(self, late: float) -> Evidence:
        """Evidence of the same ensemble with the torque taken so many samples later."""
        given, width, whole = self.ensemble, self.ensemble.angle.shape[1], round(late)
        cut = abs(whole)
        if late == 0 or given.context < cut:
            return self
        ensemble = Ensemble(
            given.angle[:, cut : width - cut],
            between(given.torque, late - whole)[:, cut + whole : width - cut + whole],
            given.sampling_rate,
            context=given.context - cut,
            onsets=given.onsets,
            trials=given.trials,
        )
        return Evidence(self.given, ensemble)

    @cached_property
    def halves(self) -> tuple[Evidence, Evidence]:
        """First and second half of the experiment, each by itself."""
        order, middle = self.order, len(self.order) // 2
        first, second = (Evidence(self.given, self.ensemble.select(half)) for half in (order[:middle], order[middle:]))
        return first, second

    @property
    def order(self) -> NDArray[np.int64]:
        """Realizations in the order in which they were recorded."""
        return np.concatenate(self.ensemble.runs)

    def lagged(self, signal: Array, lags: NDArray[np.int64]) -> tuple[Array, slice]:
        """Signal so many samples before, shape (lag, realization, time), and the fit's samples at which all are known.

        Parameters
        ----------
        signal
            Shape (realization, context + time + context).
        lags
            In samples, none negative.
        """
        first, count = self.fit.first, self.fit.torque.shape[1]
        start = max(first, int(lags.max()))
        stop = first + count
        if stop - start < 2 * HALF_WIDTH:
            return np.empty((len(lags), len(signal), 0)), slice(0, 0)
        windows = sliding_window_view(signal, stop - start, axis=1)
        return np.stack([windows[:, start - lag] for lag in lags]), slice(start - first, count)


def known_samples(samples: int, context: int) -> int:
    """Samples of a realization at which derivatives are known."""
    return max(0, min(samples, samples + 2 * (context - HALF_WIDTH)))


def lowered(ensemble: Ensemble) -> Ensemble:
    """Ensemble at some 100 Hz, at which a realization is a whole number of samples.

    Where the samples of realization and context share a factor, that is the decimation of
    :func:`tvsysid.preprocess.decimate`; where they do not, its low-pass, and samples between the old ones.
    """
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    factors = [
        factor
        for factor in range(2, int(rate / LOWEST_RATE) + 1)
        if math.gcd(samples, context) % factor == 0 and known_samples(samples // factor, context // factor) >= SHORTEST
    ]
    factor = factors[-1] if factors else 1
    if rate / factor > 2 * LOWEST_RATE and (between := _resampled(ensemble)) is not None:
        return between
    if factor == 1:
        return ensemble
    # Every realization is filtered by itself, as a trial is.
    starts = tuple(range(0, ensemble.angle.size, samples + 2 * context))
    recording = Recording(ensemble.angle.ravel(), ensemble.torque.ravel(), rate, trial_starts=starts)
    low = decimate(recording, rate / factor)
    shape = (len(ensemble), -1)
    return _at(ensemble, low.angle.reshape(shape), low.torque.reshape(shape), rate / factor, context // factor)


def _resampled(ensemble: Ensemble) -> Ensemble | None:
    """Ensemble at a lower rate that does not divide its own; none if realizations are too short for that."""
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    for count in range(math.ceil(samples * LOWEST_RATE / rate), samples // 2 + 1):
        margin = context * count // samples
        if known_samples(count, margin) >= SHORTEST:
            break
    else:
        return None
    step = samples / count
    places = context + step * np.arange(-margin, count + margin)
    taps = firwin(2 * round(TAPS * step / 2) + 1, 1 / step)
    half = len(taps) // 2

    def lower(values: Array) -> Array:
        extended = np.pad(values, ((0, 0), (half, half)), "reflect", reflect_type="odd")
        smooth = oaconvolve(extended, taps[None], mode="valid", axes=1)
        return np.asarray(make_interp_spline(np.arange(values.shape[1]), smooth, axis=1)(places))

    return _at(ensemble, lower(ensemble.angle), lower(ensemble.torque), rate / step, margin)


def _at(ensemble: Ensemble, angle: Array, torque: Array, rate: float, context: int) -> Ensemble:
    return Ensemble(angle, torque, rate, context=context, onsets=ensemble.onsets, trials=ensemble.trials)


def _deviation(values: Array) -> Array:
    return values - values.mean(axis=0) if len(values) > 1 else values


def chance(scores: Array) -> float:
    """Probability that scores of independent realizations, shape (realization,), have so large a mean by chance."""
    count = len(scores)
    if count < LEAST_REALIZATIONS:
        return 1.0
    error = float(scores.std(ddof=1)) / math.sqrt(count)
    if error == 0:
        return 0.0 if scores.mean() != 0 else 1.0
    return float(2 * stdtr(count - 1, -abs(float(scores.mean())) / error))


FOLDS = 4


def gained(target: Array, regressors: Array) -> tuple[float, float]:
    """Share of a signal's variance that regressors predict in realizations they were not fitted to, and its chance.

    Parameters
    ----------
    target
        Shape (realization, time).
    regressors
        Shape (regressor, realization, time).

    Returns
    -------
    share : float
        Below zero where they predict nothing.
    probability : float
        That so much is gained by chance, from the scatter of the gain over realizations.
    """
    if len(target) < LEAST_REALIZATIONS or not target.shape[1]:
        return math.nan, 1.0
    gained = gains(target, regressors)
    total = float(np.sum(target**2))
    share = float(gained.sum()) / total if total > 0 else math.nan
    return share, chance(gained)


def gains(target: Array, regressors: Array) -> Array:
    """Sum of squares that regressors take from each realization, fitted to others; shapes as above."""
    count = len(target)
    rows = np.ascontiguousarray(regressors.transpose(1, 0, 2))
    grams = rows @ rows.transpose(0, 2, 1)
    moments = (rows @ target[..., None])[..., 0]
    taken = np.empty(count)
    # Neighbours are left out together: slow noise is alike in them.
    for out in np.array_split(np.arange(count), FOLDS):
        kept = np.setdiff1d(np.arange(count), out)
        weights = solved(grams[kept].sum(axis=0), moments[kept].sum(axis=0))
        taken[out] = 2 * moments[out] @ weights - np.einsum("a,rab,b->r", weights, grams[out], weights)
    return taken


def without(target: Array, regressors: Array) -> Array:
    """Signal less what regressors explain of it; shapes (..., realization, time) and (regressor, realization, time)."""
    rows = regressors.reshape(len(regressors), -1)
    weights = solved(rows @ rows.T, rows @ target.reshape(-1, rows.shape[1]).T)
    return target - (weights.T @ rows).reshape(target.shape)


def solved(gram: Array, moments: Array) -> Array:
    """Least squares from second moments, safe where regressors are nearly the same."""
    ridge = RIDGE * np.trace(gram) / len(gram) + np.finfo(float).tiny
    return np.asarray(np.linalg.solve(gram + ridge * np.eye(len(gram)), moments))


def innovations(signal: Array, order: int) -> Array:
    """What so many samples of a signal's past do not foretell, shape (realization, time - order)."""
    taps = np.concatenate([[1.0], -_prediction(signal, order)[::-1]])
    return np.asarray(lfilter(taps, 1.0, signal, axis=1)[:, order:])


def _prediction(signal: Array, order: int) -> Array:
    """Weights of the samples before, the farthest first, that foretell a signal of shape (realization, time)."""
    rows = sliding_window_view(signal, order + 1, axis=1).reshape(-1, order + 1)
    gram = rows.T @ rows
    return solved(gram[:order, :order], gram[:order, order])


def left_by(fit: SecondOrder, residual: Array) -> float:
    """Share of the torque's variance that a fit leaves; all of it where there is none."""
    total = float(np.sum(fit.torque**2))
    return float(np.sum(residual**2)) / total if total > 0 else 1.0


def refitted(evidence: Evidence, shift: float) -> SecondOrder:
    """Fit with the torque taken so many samples later."""
    fit = evidence.fit
    whole = round(shift)
    torque = between(evidence.torque, shift - whole)
    late = np.clip(np.arange(fit.first, fit.first + fit.torque.shape[1]) + whole, 0, torque.shape[1] - 1)
    return fit_motion(fit.motion, torque[:, late], evidence.rate, fit.first)


def between(values: Array, later: float) -> Array:
    """Values a fraction of a sample later, shape (realization, time): a windowed sinc, which smooths hardly at all."""
    if later == 0:
        return values
    lags = np.arange(-SINC, SINC + 1)
    taps = np.sinc(lags - later) * np.kaiser(2 * SINC + 1, 5.0)
    return np.asarray(correlate1d(values, taps / taps.sum(), axis=1, mode="nearest"))
