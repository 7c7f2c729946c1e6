"""Choose the pathways, and whether they change over time, by how they predict held-out data."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import NamedTuple

import attrs
import numpy as np
from scipy.linalg import block_diag

from tvsysid.methods.cascade.columns import Data
from tvsysid.methods.cascade.fit import (
    DAMPING,
    FREQUENCY,
    THRESHOLD,
    USUAL_DELAY_S,
    USUAL_PARAMETERS,
    Fit,
    usual_shape,
)
from tvsysid.methods.cascade.pathways import MeasuredChannel, Stretch
from tvsysid.methods.cascade.reflex_test import (
    HARMONICS,
    MIN_TESTED_REALIZATIONS,
    prediction_p_value,
    reflex_test_of,
)
from tvsysid.numerics import Array
from tvsysid.numerics.noise import autocorrelation
from tvsysid.signals import Ensemble

EMG_DELAY_S = 0.01
INITIAL_THRESHOLD = 0.15  # rad/s
MAX_LIMITED_TIMES = 500  # in a period at which signs are limited, or somewhat more
MAX_MISFIT = 0.02  # share by which whitening may raise the held-out squares
WHITE_FLOOR = 30.0  # power of added white noise, relative to the noise, where whitening is wrong
MAX_CHANGE_P_VALUE = 0.05  # p-value below which a change or a threshold is accepted
# Log evidence of a change, of few realizations. Without a change it is 0, but for rounding.
MIN_CHANGE_EVIDENCE = 1.0
CACHED_DRIVES = 16  # thresholds that are tried

# Drive of a reflex for a threshold; None without a reflex
DriveByThreshold = Callable[[float], Array] | None


class Hyperparameters(NamedTuple):
    """Settings that determine a fit with a reflex, except its coefficients."""

    direction: int
    varies: bool
    noise: Array
    shape: Array
    parameters: Array


class Selection(NamedTuple):
    """Fits that a search selects.

    ``fit`` has the most likely reflex. ``used`` gives the estimates: the same fit if the reflex is
    ``shown``, else one without a reflex. ``direction`` is that of stretch, 1 or -1.
    """

    search: Search
    direction: int
    shown: bool
    fit: Fit
    used: Fit


@attrs.frozen(eq=False)
class Search:
    """Ensemble, and the reflexes that may explain its torque.

    A reflex has a direction of stretch, 1 or -1. The direction has no meaning with EMG.
    The settings are those of ``JointCascade``.
    """

    ensemble: Ensemble
    harmonics: tuple[int, int, int]
    delay: float | None
    emg: str | None

    @cached_property
    def data(self) -> Data:
        """Return torque and intrinsic signals."""
        return Data.of(self.ensemble, self.harmonics)

    def drive(self, direction: int, threshold: float) -> Stretch | MeasuredChannel:
        """Return the drive of a reflex."""
        return MeasuredChannel(self.emg) if self.emg else Stretch(threshold, direction)

    def drive_by_threshold(self, direction: int) -> Callable[[float], Array]:
        """Return the function that gives a drive for a threshold, with its history, less its mean.

        The drive has shape (realization, history + time). It is 0 where nothing was recorded.
        """

        @lru_cache(CACHED_DRIVES)
        def drive(threshold: float) -> Array:
            values = self.drive(direction, threshold)(self.ensemble)
            return self.data.history(self.ensemble, values)

        return drive

    def _shape(self, threshold: float) -> Array:
        """Return the shape of a reflex with a usual muscle."""
        usual = USUAL_DELAY_S if self.emg is None else EMG_DELAY_S
        return usual_shape(threshold, self.delay or usual)

    def fit(self, drive: DriveByThreshold) -> Fit:
        """Return the fit with a reflex. The data choose whether coefficients change over time."""
        threshold, free = INITIAL_THRESHOLD, [FREQUENCY, DAMPING, THRESHOLD]
        if self.emg:
            threshold, free = 0.0, [FREQUENCY, DAMPING]
        shape, free = self._shape(threshold), free if drive else []
        start = Fit(self.data.constant, drive, shape, free, USUAL_PARAMETERS).improved()

        def solved(data: Data) -> Fit:  # with the shape found for constant coefficients
            return Fit(data, drive, start.shape, start.free)

        residual = solved(self.data).residual
        data = attrs.evolve(self.data, noise=autocorrelation(residual))
        fit, constant, white = solved(data), solved(data.constant), self.data
        if not _is_better(fit, constant):
            fit, white = constant, white.constant
        share = attrs.evolve(fit, data=white).share()  # unknown if there is a single fold
        if share - fit.share() > MAX_MISFIT * (1 - share):
            fit = solved(attrs.evolve(fit.data, noise=autocorrelation(residual, WHITE_FLOOR)))
        return fit

    def select(self) -> Selection:
        """Return the fit with a reflex if held-out realizations show one, or if EMG drives it."""
        direction, shown = 1, self.emg is not None
        if not shown and len(self.ensemble) >= MIN_TESTED_REALIZATIONS:
            test = reflex_test_of(self.ensemble)
            direction, shown = test.direction, test.shown
        drive = self.drive_by_threshold(direction)
        if shown:
            fit = self._limited(_refined(self.fit(drive)))
            return Selection(self, direction, True, fit, fit)
        none = self.fit(None)
        usual = Fit(none.data, drive, self._shape(0.0), [])
        return Selection(self, direction, False, self._limited(usual), self._limited(none))

    def refit(self, known: Hyperparameters) -> Selection:
        """Return the fit with known hyperparameters, of a reflex that is detected."""
        data = attrs.evolve(self.data if known.varies else self.data.constant, noise=known.noise)
        drive = self.drive_by_threshold(known.direction)
        fit = self._limited(Fit(data, drive, known.shape, [], known.parameters))
        return Selection(self, known.direction, True, fit, fit)

    def _limited(self, fit: Fit) -> Fit:
        """Return the fit with the same hyperparameters, without negative viscosity and gain.

        Stiffness keeps one sign. The gain of EMG is of either sign.
        """
        data, some = fit.data, slice(None, None, max(1, self.ensemble.samples // MAX_LIMITED_TIMES))
        stiffness = np.sign(fit.posterior.mean[0]) * np.eye(1, len(data.starts))[0]
        rows = np.concatenate([data.features(each)[some] for each in (stiffness, data.readout[1])])
        if fit.drive is not None:
            gain = data.gain(self.ensemble.time[some] / data.period)
            rows = block_diag(rows, gain if self.emg is None else gain[:0])
        return attrs.evolve(fit, positive=rows)


class Separation(NamedTuple):
    """Pathways of an ensemble with a reflex.

    ``stiffness`` is the mean of least squares without a reflex, and that of the fit with one. The
    ``torque`` (realization, context + time + context) is that of the reflex; 0 where none is
    fitted.
    """

    stiffness: tuple[float, float]
    torque: Array


@lru_cache(maxsize=1)  # checks ask for the same ensemble
def separated(ensemble: Ensemble) -> Separation:
    """Separate the pathways with the likeliest reflex, whether it is shown or not."""
    search = Search(ensemble, (HARMONICS, HARMONICS, 0), None, None)
    fit = search.fit(search.drive_by_threshold(reflex_test_of(ensemble).direction))
    means = (each.posterior.mean for each in (Fit(search.data, None, fit.shape, []), fit))
    without, beside = (float(each[0]) for each in means)
    torque = np.zeros(ensemble.torque.shape)
    fitted = fit.data.torques(fit.posterior.mean, fit.reflex_columns)[1]
    torque[:, ensemble.core][fit.data.rows, fit.data.times] = fitted
    return Separation((without, beside), torque)


def _refined(fit: Fit) -> Fit:
    """Return the best fit with a reflex, with a threshold if it predicts better so.

    The threshold stays among the free numbers: bands count that it is not known.
    """
    best = fit.refined()
    if best.shape[THRESHOLD] == 0:
        return best
    shape = best.shape * (np.arange(4) != THRESHOLD)
    simple = Fit(best.data, best.drive, shape, [FREQUENCY, DAMPING]).refined()
    simple = attrs.evolve(simple, free=best.free)
    return best if _is_better(best, simple) else simple


def _is_better(best: Fit, rest: Fit) -> bool:
    """Return whether ``best`` predicts held-out data better than ``rest``.

    With few realizations: whether its log evidence is clearly greater.
    """
    if len(best.data.torque) < MIN_TESTED_REALIZATIONS:
        return best.objective > rest.objective + MIN_CHANGE_EVIDENCE
    squares = best.data.squares
    return prediction_p_value(squares(best.held_out), squares(rest.held_out)) < MAX_CHANGE_P_VALUE
