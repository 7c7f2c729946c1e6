"""Choose the pathways, and whether they change over time, by how they predict held-out data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Literal, NamedTuple

import attrs
import numpy as np
from scipy.linalg import block_diag

from tvsysid.errors import InputError
from tvsysid.methods.base import fitting_lags
from tvsysid.methods.cascade.columns import Data, deviations, readout
from tvsysid.methods.cascade.fit import (
    DAMPING,
    DELAY,
    FREQUENCY,
    THRESHOLD,
    USUAL_PARAMETERS,
    Fit,
)
from tvsysid.methods.cascade.pathways import Drive, Measured, Stretch, history, velocity_of
from tvsysid.methods.cascade.reflex_test import (
    MIN_TESTED_REALIZATIONS,
    predicts_better,
    reflex_test_of,
)
from tvsysid.numerics import Array
from tvsysid.numerics.noise import autocorrelation
from tvsysid.numerics.stretch import stretch
from tvsysid.signals import Ensemble

MAX_LAG_S = 0.04  # of the intrinsic response, to either side
VELOCITY_DELAY_S, EMG_DELAY_S = 0.04, 0.01
HISTORY_S = 0.75  # of the reflex's drive that is used where it was recorded
# Initial shapes of a reflex, in rad/s and s
FREQUENCIES, THRESHOLDS, DELAYS_S = (9.0, 16.0, 26.0), (0.0, 0.15, 0.5), (0.04, 0.05, 0.06)
MAX_LIMITED_TIMES = 500  # in a period at which signs are limited, or somewhat more
MIN_EVIDENCE_GAIN = 10.0  # log evidence by which a reflex must be better than all else to be shown
MAX_MISFIT = 0.02  # share by which whitening may raise the held-out squares
WHITE_FLOOR = 30.0  # power of added white noise, relative to the noise, where whitening is wrong
MAX_CHANGE_P_VALUE = 0.05  # p-value below which a change or a threshold is accepted
# Log evidence of a change, of few realizations. Without a change it is 0, but for rounding.
MIN_CHANGE_EVIDENCE = 1.0
CACHED_DRIVES = 16  # of the initial thresholds in each direction, and of those that are tried

DIRECTIONS = {"positive": 1, "negative": -1}


class Hyperparameters(NamedTuple):
    """Settings that determine a fit, except its coefficients."""

    reflex: str
    varies: bool
    noise: Array
    shape: Array
    parameters: Array


class Selection(NamedTuple):
    """Fit with the most likely reflex, and ``used`` fit, which has none if none is shown."""

    search: Search
    name: str
    shown: bool
    fit: Fit
    used: Fit


@attrs.frozen(eq=False)
class Search:
    """Ensemble, and the reflexes that may explain its torque.

    A reflex is named ``"none"``, ``"linear"``, ``"positive"`` or ``"negative"`` by its direction,
    or ``"emg"`` if the channel of this name is given. The settings are those of ``JointCascade``.
    """

    ensemble: Ensemble
    harmonics: tuple[int, int, int]
    delay: float | Literal["fit"] | None
    emg: str | None

    @cached_property
    def lags(self) -> int:
        """Return the number of lags of the intrinsic response to either side, in samples."""
        return fitting_lags("JointCascade", MAX_LAG_S, self.ensemble)

    @cached_property
    def data(self) -> Data:
        """Return torque and intrinsic signals."""
        return Data.of(self.ensemble, self.harmonics, self.lags)

    def drive(self, name: str, threshold: float) -> Drive:
        """Return the drive of the named reflex."""
        return Measured(self.emg) if self.emg else Stretch(threshold, DIRECTIONS[name])

    @cached_property
    def _past(self) -> Callable[[str, float], Array]:
        """Return the function that gives a drive with its history, less its mean.

        The drive has shape (realization, history + time). It is 0 where nothing was recorded.
        """
        ensemble, (velocity, ratio) = self.ensemble, velocity_of(self.ensemble)
        samples, times = round(HISTORY_S * ensemble.sampling_rate), self.data.times

        @lru_cache(CACHED_DRIVES)
        def past(name: str, threshold: float) -> Array:
            if name == "linear":  # both directions together are not rectified
                return past("positive", 0.0) + past("negative", 0.0)
            values = (
                stretch(velocity, ratio, threshold, DIRECTIONS[name])
                if self.emg is None
                else ensemble.signal(self.emg)
            )
            known = history(ensemble, values, samples)[self.data.rows]
            return deviations(known[:, times.start : samples + times.stop])

        return past

    def _fit(self, name: str, data: Data, shape: Array, free: list[int], **settings: Array) -> Fit:
        """Return the fit with the named reflex."""
        drive = None if name == "none" else partial(self._past, name)
        return Fit(data, drive, shape, free, **settings)

    @property
    def _delays(self) -> tuple[float, ...]:
        usual = VELOCITY_DELAY_S if self.emg is None else EMG_DELAY_S
        return DELAYS_S if self.delay == "fit" else (float(self.delay or usual),)

    def _started(self, name: str) -> Fit:
        """Return the best constant fit for some initial shapes, improved."""
        thresholds = THRESHOLDS if name in DIRECTIONS else (0.0,)
        free = [FREQUENCY, DAMPING, *[THRESHOLD] * (name in DIRECTIONS)]
        free += [DELAY] * (self.delay == "fit")
        free = [] if name == "none" else free
        fits = [
            self._fit(name, self.data.constant, _shape(*each), free, parameters=USUAL_PARAMETERS)
            for each in product(self._delays, FREQUENCIES, thresholds)
        ]
        return _best(fits).improved()

    def fits(self, names: Iterable[str]) -> dict[str, Fit]:
        """Return the fit with each named reflex.

        The data choose whether the coefficients change over time.
        """
        begun = {name: self._started(name) for name in names}
        likely = max(
            begun, key=lambda name: begun[name].objective + MIN_EVIDENCE_GAIN * (name == "none")
        )

        def solved(data: Data) -> dict[str, Fit]:
            return {
                name: self._fit(name, data, each.shape, each.free) for name, each in begun.items()
            }

        left = self._fit(likely, self.data, begun[likely].shape, []).residual
        data = attrs.evolve(self.data, noise=autocorrelation(left))
        fits = solved(data)
        if data.varies:
            unchanging = solved(data.constant)
            if not _is_better(
                _best(fits.values()), _best(unchanging.values()), MIN_CHANGE_EVIDENCE
            ):
                fits, data = unchanging, data.constant
        best = _best(fits.values())
        if len(data.torque) < MIN_TESTED_REALIZATIONS:
            return fits
        data = attrs.evolve(data, noise=autocorrelation(left, WHITE_FLOOR))
        white = attrs.evolve(best, data=data).share()
        is_misfit = white - best.share() > MAX_MISFIT * (1 - white)
        return solved(data) if is_misfit else fits

    def select(self) -> Selection:
        """Return the fit with a reflex if the data show one.

        Held-out realizations decide. Of few or short ones, and with EMG, the evidence decides: the
        reflex is compared with no reflex, a linear late response and the other direction.
        """
        names = ("linear", *DIRECTIONS) if self.emg is None else ("emg",)
        if self.emg is None and len(self.ensemble) >= MIN_TESTED_REALIZATIONS:
            with suppress(InputError):  # realizations are too short for it
                test = reflex_test_of(self.ensemble)
                name = "positive" if test.direction > 0 else "negative"
                if test.shown:
                    return self.shown(name, self.fits([name])[name])
                return self.unshown(name, self.fits(["none"])["none"])
        fits = self.fits(("none", *names))
        name = max(names[-2:], key=lambda name: fits[name].objective)
        others = [each.objective for other, each in fits.items() if other != name]
        if fits[name].objective - max(others) > MIN_EVIDENCE_GAIN:
            return self.shown(name, fits[name])
        return self.unshown(name, fits["none"])

    def shown(self, name: str, fit: Fit) -> Selection:
        """Return the fit with a reflex that is shown."""
        fit = self.limited(_refined(fit))
        return Selection(self, name, True, fit, fit)

    def refit(self, known: Hyperparameters) -> Selection:
        """Return the fit with known hyperparameters, of a reflex that is shown."""
        data = attrs.evolve(self.data if known.varies else self.data.constant, noise=known.noise)
        fit = self._fit(known.reflex, data, known.shape, [], parameters=known.parameters)
        return Selection(self, known.reflex, True, *[self.limited(fit)] * 2)

    def unshown(self, name: str, none: Fit) -> Selection:
        """Return the fit without a reflex, and one with a usual reflex, whose gain it bounds."""
        fit = self._fit(name, none.data, _shape(self._delays[0]), [])
        return Selection(self, name, False, self.limited(fit), self.limited(none))

    def limited(self, fit: Fit) -> Fit:
        """Return the fit with the same hyperparameters, without negative viscosity and gain.

        Stiffness, and the gain of EMG, are of either sign, but the same at all times.
        """
        data, mean = fit.data, fit.posterior.mean
        some = slice(0, None, max(1, self.ensemble.samples // MAX_LIMITED_TIMES))
        stiffness = np.sign(mean[0]) * np.eye(1, len(data.starts))[0]
        weights = stiffness, readout(self.lags, data.rate)[1]
        rows = np.concatenate([data.features(each)[some] for each in weights])
        if len(mean) > data.own:
            sign = np.sign(mean[data.own]) if self.emg else 1.0
            rows = block_diag(rows, sign * data.gain(self.ensemble.time[some] / data.period))
        return attrs.evolve(fit, positive=rows)


def _refined(fit: Fit) -> Fit:
    """Return the best fit with a reflex, with a threshold if it predicts better so.

    The threshold stays among the free numbers: bands count that it is not known.
    """
    best = fit.refined()
    if best.shape[THRESHOLD] == 0:
        return best
    others = [number for number in best.free if number != THRESHOLD]
    shape = np.where(np.arange(4) == THRESHOLD, 0.0, best.shape)
    simple = Fit(best.data, best.drive, shape, others).refined()
    simple = attrs.evolve(simple, free=best.free)
    return best if _is_better(best, simple) else simple


def _shape(delay: float, frequency: float = 16.0, threshold: float = 0.0) -> Array:
    """Return the shape of a reflex with a muscle of usual damping."""
    return np.array([math.log(frequency), math.log(0.8), threshold, delay])


def _best(fits: Iterable[Fit]) -> Fit:
    return max(fits, key=lambda fit: fit.objective)


def _is_better(best: Fit, rest: Fit, least: float = 0.0) -> bool:
    """Return whether a fit predicts better; of few realizations, has so much more evidence."""
    if len(best.data.torque) < MIN_TESTED_REALIZATIONS:
        return best.objective > rest.objective + least
    squares = best.data.squares
    return predicts_better(squares(best.held_out), squares(rest.held_out)) < MAX_CHANGE_P_VALUE
