"""Choose the pathways, and whether they change over time, by how they predict held-out data."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.methods.cascade.columns import DELAY, MEAN, THRESHOLD, Data
from tvsysid.methods.cascade.fit import USUAL_PARAMETERS, Fit
from tvsysid.methods.cascade.reflex_test import (
    HARMONICS,
    MIN_TESTED_REALIZATIONS,
    prediction_p_value,
    reflex_test_of,
)
from tvsysid.methods.pathways import Stretch
from tvsysid.numerics import Array
from tvsysid.numerics.noise import autocorrelation
from tvsysid.signals import Ensemble

NO_REFLEX = Stretch(direction=0)
EMG_DELAY_S = 0.01
INITIAL_THRESHOLD = 0.15  # rad/s
MAX_MISFIT = 0.02  # share by which whitening may raise the held-out squares
WHITE_FLOOR = 30.0  # power of added white noise, relative to the noise, where whitening is wrong
MAX_CHANGE_P_VALUE = 0.05  # p-value below which a change or a threshold is accepted
MIN_CHANGE_EVIDENCE = 1.0  # log evidence of a change or a threshold in few realizations


class Hyperparameters(NamedTuple):
    """Settings that determine a fit with a reflex, except its coefficients."""

    harmonics: int
    noise: Array
    drive: Stretch
    shape: Array
    parameters: Array


class Selection(NamedTuple):
    """Fits that a search selects.

    ``reflex`` is that with the most likely reflex, and gives the gain. ``used`` gives the
    impedance: the same fit if the reflex is shown, else one without a reflex.
    """

    reflex: Fit
    used: Fit

    @property
    def shown(self) -> bool:
        """Return whether the reflex is shown."""
        return self.used is self.reflex


@lru_cache(maxsize=1)  # adaptive, cascade and checks ask for the same ensemble
def select(ensemble: Ensemble, harmonics: int, delay: float | None, emg: str | None) -> Selection:
    """Return the fit with a reflex, and the same or one without, as held-out realizations show.

    EMG always drives a reflex. The settings are those of ``JointCascade``.
    """
    data = Data.of(ensemble, harmonics)
    # ``free`` numbers of the shape, the first ones, are estimated.
    if emg is None:
        test = reflex_test_of(ensemble)
        drive, shown = Stretch(direction=test.direction), test.shown
        threshold, usual_delay, free = INITIAL_THRESHOLD * shown, MEAN[DELAY], DELAY
    else:
        drive, shown = Stretch(emg=emg), True
        threshold, usual_delay, free = 0.0, EMG_DELAY_S, THRESHOLD
    shape = np.array([*MEAN[:THRESHOLD], threshold, delay or usual_delay])
    if shown:
        fit = _refined(_fitted(data, drive, shape, free)).limited()
        return Selection(fit, fit)
    none = _fitted(data, NO_REFLEX, shape, 0)
    return Selection(Fit(none.data, drive, shape, 0).limited(), none.limited())


def fit_again(ensemble: Ensemble, known: Hyperparameters) -> Selection:
    """Return the fit with known hyperparameters, of a reflex that is detected."""
    data = attrs.evolve(Data.of(ensemble, known.harmonics), noise=known.noise)
    fit = Fit(data, known.drive, known.shape, 0, known.parameters).limited()
    return Selection(fit, fit)


def one_path_stiffness(ensemble: Ensemble) -> float:
    """Return the mean stiffness of a fit without a reflex, whose torque it then includes."""
    none = Fit(Data.of(ensemble, HARMONICS), NO_REFLEX, MEAN, 0)
    return float(none.posterior.mean[0])


def _fitted(data: Data, drive: Stretch, shape: Array, free: int) -> Fit:
    """Return the fit of a drive. The data choose whether coefficients change over time."""
    start = Fit(data.constant, drive, shape, free, USUAL_PARAMETERS).improved()

    def fitted_to(weighted: Data) -> Fit:  # with the shape found for constant coefficients
        return Fit(weighted, drive, start.shape, free)

    residual = fitted_to(data).residual
    whitened = attrs.evolve(data, noise=autocorrelation(residual))
    fit, constant = fitted_to(whitened), fitted_to(whitened.constant)
    if not _is_better(fit, constant):
        fit, data = constant, data.constant
    plain = attrs.evolve(fit, data=data)  # without whitening
    # NaN if there is a single fold
    if fit.left_share() > (1 + MAX_MISFIT) * plain.left_share():
        fit = fitted_to(attrs.evolve(data, noise=autocorrelation(residual, WHITE_FLOOR)))
    return fit


def _refined(fit: Fit) -> Fit:
    """Return the best fit with a reflex, with a threshold if it predicts better so.

    The threshold stays among the free numbers: bands count that it is not known.
    """
    best = fit.refined()
    if best.shape[THRESHOLD] == 0:
        return best
    shape = best.shape * (np.arange(len(best.shape)) != THRESHOLD)
    simple = Fit(best.data, best.drive, shape, THRESHOLD).refined()
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
