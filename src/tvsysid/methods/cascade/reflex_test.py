"""Test for a stretch reflex: fit joints with and without one, and compare how well they predict."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import attrs
import numpy as np
from scipy.linalg import block_diag
from scipy.special import stdtr, stdtrit

from tvsysid.errors import InputError
from tvsysid.methods.cascade.columns import MEAN, Data
from tvsysid.methods.pathways import DIRECTIONS, Stretch
from tvsysid.numerics.gaussian import Moments, least_squares
from tvsysid.numerics.noise import autocorrelation
from tvsysid.signals import Array, Ensemble

MIN_TESTED_REALIZATIONS = 8  # fewer do not show the scatter that a test needs
MAX_P_VALUE = 1e-4  # below which a reflex is not taken for chance
CONFIDENCE = 0.95  # of the lower limit of a share
HARMONICS = 8  # of the realization's duration with which stiffness and viscosity vary
TESTED_HARMONICS = 2  # by which a change is found
ROUNDING = 1e-12  # share of the torque's power that rounding leaves


class ReflexTest(NamedTuple):
    """Evidence for a stretch reflex in held-out realizations.

    ``direction`` is 1 for a reflex to positive velocity and -1 for one to negative velocity,
    whichever has the larger absolute gain. ``over_none`` and ``over_linear`` are the p-values of
    whether the reflex predicts better than no reflex, and than a late response that is the same in
    both directions. ``share`` is the smallest share of the squared error that the reflex explains
    (confidence 95 %); it is not above 0 where none is certain. If the reflex is not better than
    none, ``over_linear`` is 1 and ``share`` is 0.
    """

    direction: int
    over_none: float
    over_linear: float
    share: float

    @property
    def shown(self) -> bool:
        """Return whether the reflex predicts better than no reflex and than a linear response."""
        return max(self.over_none, self.over_linear) < MAX_P_VALUE


def is_time_varying(ensemble: Ensemble) -> bool:
    """Return whether stiffness or viscosity change over a realization, beside any reflex.

    The first harmonics of the realization are tested as :func:`reflex_test_of` tests a reflex.
    False where realizations are too few or too short to tell.
    """
    try:
        data, late = _columns(ensemble, TESTED_HARMONICS)
    except InputError:
        return False
    constant, changing = (
        each.held_out(each.products(late), late) for each in (data.constant, data)
    )
    return _improvement(data, constant, changing)[0] < MAX_P_VALUE


@lru_cache(maxsize=1)  # adaptive, cascade and checks ask for the same ensemble
def reflex_test_of(ensemble: Ensemble) -> ReflexTest:
    r"""Test for a stretch reflex by nested models, each fitted to two thirds of the realizations.

    The joint's response lasts 40 ms to either side, and its stiffness and viscosity vary over a
    realization. A reflex adds the response of a usual muscle (16 rad/s, a damping of 0.8), 40 ms
    later, to the velocity where that is positive, or where it is negative. What the reflex adds to
    a simpler model, without a reflex or with one that is linear, is tested by

    .. math:: (y - \hat y_0)^T W (\hat y_1 - \hat y_0)

    of each realization over its :math:`(y - \hat y_0)^T W (y - \hat y_0)`. W is the inverse
    covariance of the residual of the largest model, so that slow voluntary torque counts little.
    The number is zero on average if the simpler model 0 is right. A test of the difference of
    squared errors would be half as powerful, since useless coefficients cost squared error.

    The velocity is rectified at the rate at which the angle was recorded.

    Raises
    ------
    InputError
        If no realization has 0.45 s of record before its last sample.

    References
    ----------
    Clark & West 2007, J. Econometrics 138, 291-311: nested models by what they predict.
    """
    data, both = _columns(ensemble, HARMONICS)
    products = data.products(both)
    gains = least_squares(Moments.of(products.sum(axis=0), data.number)).mean[-2:]
    index = int(np.argmax(np.abs(gains)))

    def held_out(directions: Array) -> Array:
        """Return the residual torque beside sums of both directions, (sum, direction)."""
        columns = block_diag(np.eye(data.intrinsic_count), directions, 1)
        return data.held_out(columns @ products @ columns.T, np.tensordot(directions, both, 1))

    def improvement(simple: Array, further: Array) -> tuple[float, float]:
        return _improvement(data, held_out(simple), held_out(further))

    each = np.eye(2)
    over_none, share = improvement(each[:0], each[index : index + 1])
    over_none = min(1.0, 2 * over_none)  # each of two directions may add to none by chance
    if over_none >= MAX_P_VALUE:
        return ReflexTest(DIRECTIONS[index], over_none, over_linear=1.0, share=0.0)
    over_linear, share_over_linear = improvement(np.ones((1, 2)), each)
    return ReflexTest(DIRECTIONS[index], over_none, over_linear, min(share, share_over_linear))


def prediction_p_value(errors: Array, others: Array) -> float:
    """Return the p-value that errors are smaller than others.

    Squared errors of the same held-out realizations are compared by their logarithms, as some
    realizations are louder than others.
    """
    return _above_zero(np.log(others / errors))[0]


def _columns(ensemble: Ensemble, harmonics: int) -> tuple[Data, Array]:
    """Return the joint's data, and a usual muscle's responses to velocity in either direction.

    The samples are weighted by the residual of a fit to both.
    """
    data = Data.of(ensemble, harmonics)
    constant, weight = data.constant, np.ones((1, 1))
    drives = (Stretch(direction=each) for each in DIRECTIONS)
    late = np.concatenate([constant.reflex(each, MEAN, weight) for each in drives])
    left = data.residual(least_squares(data.moments(late)).mean, late)
    return attrs.evolve(data, noise=autocorrelation(left)), late


def _improvement(data: Data, simple: Array, further: Array) -> tuple[float, float]:
    """Test whether a further model leaves less torque than a simple one. See ``_above_zero``."""
    weighted = data.weighted(simple)
    gain, square = (np.sum(weighted * each, axis=1) for each in (simple - further, simple))
    is_rounding = np.abs(gain) <= ROUNDING * data.squares(data.torque)
    return _above_zero(np.where(is_rounding, 0.0, gain / square))


def _above_zero(scores: Array) -> tuple[float, float]:
    """Return the p-value that the scores' mean is above zero, and its lower 95 % limit.

    They are 1 and 0 if the scores are too few or do not differ.
    """
    count, mean = len(scores), float(scores.mean())
    if count < MIN_TESTED_REALIZATIONS or np.ptp(scores) == 0:
        return 1.0, 0.0
    error = float(scores.std(ddof=1)) / math.sqrt(count)
    least = mean - error * float(stdtrit(count - 1, CONFIDENCE))
    return float(stdtr(count - 1, -mean / error)), least
