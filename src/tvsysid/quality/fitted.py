"""Compute what all checks use: deviations from the mean, a second-order fit, its residual."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, gaussian_filter1d

from tvsysid.methods.cascade.reflex_test import ReflexTest, reflex_test_of
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.interpolation import between
from tvsysid.numerics.second_order import second_order_fit
from tvsysid.preprocess.trials import map_signals
from tvsysid.quality.resampling import known_region, lowered
from tvsysid.quality.statistics import innovations, prediction_error
from tvsysid.signals import Array, Ensemble

ROWS = 100  # samples of all realizations together that a bin should have at least
SHORTEST_BIN = 0.05  # in s
MOST_BINS_LONG = 10  # a bin is no longer than a realization divided by this
WHITENING, PAST = 0.1, 0.12  # seconds of the past from which noise is predicted, and signals
# Standard deviation in samples of a low-pass: near half the sampling rate, noise in the angle, what
# the decimation
# folded there and the errors of the derivatives' filters pass for a delay, and for a smaller
# inertia.
SMOOTH = 1.0
NO_STEP = 1e-6  # of a standard deviation: values that are as near as that are the same
ANSWERED = 0.1  # share of the torque that must be explained for the impedance to be spoken of
NO_ANSWER = "the torque does not answer the angle"
NOT_SEPARATE = "stiffness, viscosity and inertia are not separately identifiable"


class Seen(NamedTuple):
    """What a check returns: the value that is held against the limit, and the rest of a finding."""

    value: float
    what: str
    significant: bool = True
    realizations: tuple[int, ...] = ()


# Not an error: these data do not allow a check. Its text says why.
class NotJudged(Exception):  # noqa: N818
    """Raised by a check that these data do not allow, with the reason."""


def indices(concerned: NDArray[np.bool_] | np.bool_) -> tuple[int, ...]:
    """Indices of the realizations concerned."""
    return tuple(np.flatnonzero(concerned).tolist())


@attrs.frozen(eq=False)
class SecondOrder:
    r"""Fit of :math:`y = k(t)\theta + b(t)\dot\theta + I\ddot\theta` by least squares.

    Stiffness k and viscosity b are free in bins of time. ``motion`` is angle, velocity and
    acceleration, shape (3, realization, time), ``torque`` of shape (realization, time); their first
    sample is sample ``first`` of the ensemble, context counted. ``bins`` is the bin of each sample.
    """

    motion: Array
    torque: Array
    rate: float
    first: int
    bins: NDArray[np.int64]
    stiffness: Array
    viscosity: Array
    inertia: float

    @property
    def impedance(self) -> Array:
        """Stiffness, viscosity and inertia at each sample, shape (3, time)."""
        return np.stack(
            [
                self.stiffness[self.bins],
                self.viscosity[self.bins],
                np.full(len(self.bins), self.inertia),
            ]
        )

    @cached_property
    def parts(self) -> Array:
        """Torque of stiffness, viscosity and inertia in N·m, shape (3, realization, time)."""
        return self.motion * self.impedance[:, None]

    @cached_property
    def residual(self) -> Array:
        """Torque that the model leaves in N·m, shape (realization, time)."""
        return np.asarray(self.torque - self.parts.sum(axis=0))

    @property
    def squares(self) -> Array:
        """Sum of squares that it leaves of each realization."""
        return np.asarray(np.sum(self.residual**2, axis=1))

    @cached_property
    def left(self) -> float:
        """Share of the torque's variance that it leaves; all of it where there is none."""
        total = float(np.sum(self.torque**2))
        return float(np.sum(self.residual**2)) / total if total > 0 else 1.0

    def of(self, realizations: NDArray[np.int64] | slice) -> SecondOrder:
        """Fit to some of the realizations by themselves."""
        return fit_motion(
            self.motion[:, realizations], self.torque[realizations], self.rate, self.first
        )


def time_bins(samples: int, realizations: int, sampling_rate: float) -> NDArray[np.int64]:
    """Bin of each sample, shape (time,): bins are as short as the number of realizations allows."""
    shortest = max(1, round(SHORTEST_BIN * sampling_rate))
    length = max(shortest, min(math.ceil(ROWS / realizations), max(samples // MOST_BINS_LONG, 1)))
    count = max(1, samples // length)
    return np.minimum(np.arange(samples) // length, count - 1)


def fit_second_order(
    angle: Array, torque: Array, sampling_rate: float, context: int
) -> SecondOrder:
    """Fit to deviations from the mean at the samples with known derivatives.

    Angle and torque have shape (realization, context + time + context).
    """
    region = known_region(angle.shape[1] - 2 * context, context)
    motion = differentiate(angle, sampling_rate)[
        :, :, region.start - HALF_WIDTH : region.stop - HALF_WIDTH
    ]
    return fit_motion(motion, torque[:, region], sampling_rate, region.start)


class Regressors:
    """Angle, velocity and acceleration as regressors of any number of torques.

    They have shape (3, realization, time). Stiffness and viscosity are free in each bin of time and
    the inertia is common to all, which is a partitioned least-squares problem: what stiffness and
    viscosity explain of torque and acceleration is taken from both first.
    """

    def __init__(self, motion: Array, sampling_rate: float, first: int) -> None:
        self._motion, self._rate, self._first = motion, sampling_rate, first
        self._bins = time_bins(motion.shape[2], motion.shape[1], sampling_rate)
        self._edges = np.flatnonzero(np.diff(self._bins, prepend=-1))
        gram = np.array([[self._moment(a, b) for b in motion[:2]] for a in motion[:2]]).transpose(
            2, 0, 1
        )
        ridge = 1e-12 * np.trace(gram, axis1=1, axis2=2).mean() + np.finfo(float).tiny
        self._gram = gram + ridge * np.eye(2)
        self._with_acceleration = self._with(motion[2])
        self._by_motion = self._solve(self._with_acceleration)
        squares = np.sum(self._moment(motion[2], motion[2]))
        self._left = float(squares - np.sum(self._with_acceleration * self._by_motion))

    def _moment(self, a: Array, b: Array) -> Array:
        return np.asarray(np.add.reduceat(np.einsum("rt,rt->t", a, b), self._edges))

    def _with(self, signal: Array) -> Array:
        """Moments of angle and velocity with a signal, shape (bin, 2)."""
        return np.stack(
            [self._moment(self._motion[0], signal), self._moment(self._motion[1], signal)], axis=1
        )

    def _solve(self, moments: Array) -> Array:
        return np.asarray(np.linalg.solve(self._gram, moments[..., None])[..., 0])

    def _inertia(self, torque: Array, by_torque: Array) -> tuple[float, float]:
        """Return the inertia, and the product of the residual acceleration and residual torque.

        The residuals are what stiffness and viscosity leave of both.
        """
        common = np.sum(self._moment(self._motion[2], torque)) - np.sum(
            self._with_acceleration * by_torque
        )
        return float(common) / self._left if self._left > 0 else 0.0, float(common)

    def fit(self, torque: Array) -> SecondOrder:
        """Fit to a torque, shape (realization, time)."""
        by_torque = self._solve(self._with(torque))
        inertia, _ = self._inertia(torque, by_torque)
        stiffness, viscosity = (by_torque - inertia * self._by_motion).T
        return SecondOrder(
            self._motion, torque, self._rate, self._first, self._bins, stiffness, viscosity, inertia
        )

    def left(self, torque: Array) -> float:
        """Return the share of the torque's variance that a fit to it leaves.

        This takes a third of the time of :meth:`fit`.
        """
        total, moments = float(np.sum(torque**2)), self._with(torque)
        by_torque = self._solve(moments)
        inertia, common = self._inertia(torque, by_torque)
        return (
            1 - float(np.sum(moments * by_torque) + inertia * common) / total if total > 0 else 1.0
        )


def fit_motion(motion: Array, torque: Array, sampling_rate: float, first: int) -> SecondOrder:
    """Fit to angle, velocity and acceleration, shape (3, realization, time), and torque."""
    return Regressors(motion, sampling_rate, first).fit(torque)


def _constant_impedance(motion: Array, torque: Array) -> tuple[Array, Array]:
    """Stiffness, viscosity and inertia that are constant in time, and their standard errors."""
    count = len(torque)
    grams = np.einsum("art,brt->rab", motion, motion)
    with_torque = np.einsum("art,rt->ra", motion, torque)
    fit = second_order_fit(grams.sum(axis=0)[None], with_torque.sum(axis=0)[None])
    values = fit.impedance[0]
    influence = (with_torque - grams @ values) @ fit.inverse[0]
    return values, np.sqrt(np.sum(influence**2, axis=0) * count / max(count - 1, 1))


@attrs.frozen(eq=False)
class FittedEnsemble:
    """An ensemble as the checks see it: what the user gave, and the same at some 100 Hz."""

    given: Ensemble
    ensemble: Ensemble

    @classmethod
    def of(cls, ensemble: Ensemble) -> FittedEnsemble:
        """Take the ensemble down to some 100 Hz."""
        return cls(ensemble, lowered(ensemble))

    def __len__(self) -> int:
        return len(self.ensemble)

    def require(self, realizations: int = 0, *, answer: bool = True) -> None:
        """Raise NotJudged if there are too few realizations or no response to the angle.

        ``answer`` asks for a torque that responds to the angle.
        """
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
        """Return the deviation of the angle from its mean over realizations, in rad.

        The shape is (realization, context + time + context).
        """
        return self.signal("angle")

    @cached_property
    def torque(self) -> Array:
        """Deviation from the mean over realizations in N·m, likewise."""
        return self.signal("torque")

    def signal(self, which: str) -> Array:
        """Deviation of ``"angle"``, ``"torque"`` or a channel from its mean over realizations."""
        values = self.ensemble.signal(which)
        return np.asarray(values - values.mean(axis=0))

    def core(self, which: str) -> Array:
        """The same without context, shape (realization, time)."""
        return self.signal(which)[:, self.ensemble.core]

    @cached_property
    def fit(self) -> SecondOrder:
        """Second-order model with stiffness and viscosity free in each bin."""
        return fit_second_order(self.angle, self.torque, self.rate, self.ensemble.context)

    @cached_property
    def regressors(self) -> Regressors:
        """Those of the fit, for fits to other torques."""
        return Regressors(self.fit.motion, self.rate, self.fit.first)

    @property
    def explained(self) -> float:
        """Share of the torque's variance that the model explains."""
        return 1.0 - self.fit.left

    @property
    def whitening(self) -> int:
        """Samples of the past from which noise is predicted, w.

        Never so many that little is left.
        """
        return int(max(2, min(round(WHITENING * self.rate), self.fit.torque.shape[1] // 3)))

    @cached_property
    def _whitener(self) -> Array:
        return prediction_error(self.fit.residual, self.whitening)

    def whitened(self, signal: Array) -> Array:
        """Signal through the filter that makes the residual white, shape (..., time - w).

        Slow noise, such as that of voluntary torque, would otherwise hide what single
        realizations tell.
        """
        taps = self._whitener
        return np.asarray(
            convolve1d(signal, taps, axis=-1, origin=-(len(taps) // 2))[..., self.whitening :]
        )

    @cached_property
    def white_parts(self) -> Array:
        """Parts of the torque, whitened, shape (3, realization, time - w)."""
        return self.whitened(self.fit.parts)

    @cached_property
    def white_residual(self) -> Array:
        """Residual, whitened, shape (realization, time - w)."""
        return self.whitened(self.fit.residual)

    @cached_property
    def white_fit(self) -> SecondOrder:
        """Fit to what the fit left, whitened, which slow noise makes much less wrong.

        Shares of the first's values.
        """
        return fit_motion(self.white_parts, self.white_residual, self.rate, 0)

    @property
    def white_region(self) -> slice:
        """Samples of the ensemble, context counted, that the whitened ones are."""
        first = self.fit.first + self.whitening
        return slice(first, first + self.white_residual.shape[1])

    def seconds(self, white_sample: float) -> float:
        """Time of a whitened sample within its realization."""
        return float((white_sample + self.white_region.start - self.ensemble.context) / self.rate)

    def unpredicted(self, signal: Array) -> Array:
        """What its past does not predict of a signal, context and all, at the whitened samples."""
        region = self.white_region
        order = min(max(2, round(PAST * self.rate)), region.start)
        return innovations(signal, order)[:, region.start - order : region.stop - order]

    @cached_property
    def mean_impedance(self) -> tuple[Array, Array]:
        """Return stiffness, viscosity and inertia constant in time, and their standard errors.

        Both have shape (3,). The errors come from the scatter over realizations, so that the noise
        may have any colour. NaN where the data do not tell the three apart.
        """
        return _constant_impedance(self.fit.motion, self.fit.torque)

    @property
    def white_impedance(self) -> tuple[Array, Array]:
        """The same with the noise whitened."""
        return _constant_impedance(self.whitened(self.fit.motion), self.whitened(self.fit.torque))

    @cached_property
    def smooth_impedance(self) -> tuple[Array, Array]:
        """Return the mean impedance behind a low-pass filter.

        There, noise in the angle (steps, spikes) hardly lowers the inertia.
        """
        return _constant_impedance(
            *(
                gaussian_filter1d(each, SMOOTH, axis=-1)
                for each in (self.fit.motion, self.fit.torque)
            )
        )

    @cached_property
    def angle_step(self) -> float:
        """Return the step of the recorded angle in % of its standard deviation.

        It is the smallest step in the ensemble that was given.
        """
        angle = self.given.angle[:, self.given.core]
        values = np.sort(angle - angle.mean(axis=0), axis=0)
        size = float(np.std(values))
        apart = np.diff(values, axis=0)
        apart = apart[apart > NO_STEP * size]
        step = float(apart.min()) if apart.size else 0.0
        # A signal of two levels, such as a PRBS, is not coarse.
        return (
            100 * step / size
            if size > 0 and float(np.ptp(values, axis=0).max()) > 1.5 * step
            else 0.0
        )

    @cached_property
    def own_fits(self) -> tuple[Array, Array]:
        """Return second moments of each realization's torque parts: (r, 3, 3) and (r, 3).

        The first are those of the parts, the second those of the parts and the residual.
        """
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
        """Return the whitened residual's RMS in each realization over its median (realization,)."""
        size = np.sqrt(np.mean(self.white_residual**2, axis=1))
        usual = float(np.median(size))
        return np.asarray(size / usual) if usual > 0 else np.ones_like(size)

    @cached_property
    def reflex(self) -> ReflexTest:
        """Test for a reflex to the velocity, rectified at the rate at which the angle was recorded.

        Raises InputError where realizations are too short for it.
        """
        return reflex_test_of(self.ensemble)

    @property
    def order(self) -> NDArray[np.int64]:
        """Realizations in the order in which they were recorded."""
        return np.concatenate(self.ensemble.runs)

    @property
    def half_orders(self) -> list[NDArray[np.int64]]:
        """Realizations of the first and of the second half of the experiment."""
        return np.split(self.order, [len(self) // 2])

    @cached_property
    def halves(self) -> list[FittedEnsemble]:
        """First and second half of the experiment, each by itself."""
        return [FittedEnsemble(self.given, self.ensemble.select(half)) for half in self.half_orders]

    def levelled(self, angle: Array, torque: Array) -> FittedEnsemble:
        """Fit of the same ensemble less an offset of each realization, shape (realization,)."""
        if not angle.any() and not torque.any():
            return self
        given = self.ensemble
        level = attrs.evolve(
            given, angle=given.angle - angle[:, None], torque=given.torque - torque[:, None]
        )
        return FittedEnsemble(self.given, level)

    def synchronised(self, late: float) -> FittedEnsemble:
        """Fit of the same ensemble with the torque taken so many samples later."""
        given, width, whole = self.ensemble, self.ensemble.angle.shape[1], round(late)
        cut = abs(whole)
        if late == 0 or given.context < cut:
            return self
        timely = map_signals(given, lambda values: values[:, cut : width - cut])
        timely["torque"] = between(given.torque, late - whole)[:, cut + whole : width - cut + whole]
        return FittedEnsemble(
            self.given, attrs.evolve(given, **timely, context=given.context - cut)
        )
