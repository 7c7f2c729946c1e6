"""Test for a stretch reflex: fit joints with and without one, and compare how well they predict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from tvsysid.errors import InputError
from tvsysid.methods.cascade.pathways import rectified_velocities
from tvsysid.numerics.pseudoinverse import solve_regularized
from tvsysid.signals import Array, Ensemble

MIN_TESTED_REALIZATIONS = 8  # fewer do not show the scatter that a test needs
MAX_P_VALUE = 1e-4  # below which a reflex is not taken for chance
CONFIDENCE = 0.95  # of the lower limit of a share
BLOCKS = 5  # of neighbouring realizations, in which slow noise is alike; each is held out once
HARMONICS = 8  # of the realization's duration with which stiffness and viscosity vary
TESTED_HARMONICS = 2  # by which a change is found
RESPONSE_REACH_S = 0.04  # to either side that the intrinsic response lasts
MIN_REFLEX_LAG_S, MAX_REFLEX_LAG_S = 0.04, 0.33  # of the reflex's response
TRIANGLES = 8  # that make up the reflex's response
USUAL_MUSCLE = (16.0, 0.8)  # frequency in rad/s and damping of the muscle that is tested for
MIN_SAMPLES = 20  # of a realization at which all lags must be known
SLOW_TERMS = 4  # powers of time that are left out where they are most of the torque
POSITIVE, NEGATIVE, LINEAR = range(3)  # late regressors: a usual muscle's response to a velocity
ROUNDING = 1e-12  # share of the torque's power that rounding leaves


class ReflexTest(NamedTuple):
    """Evidence for a stretch reflex in held-out realizations.

    ``direction`` is 1 for a reflex to positive velocity and -1 for one to negative velocity,
    whichever predicts better. ``over_none`` and ``over_linear`` are the p-values of whether
    the reflex predicts better than no reflex, and than a late response that is the same in both
    directions. ``share`` is the smallest share of the squared error that the reflex explains
    (confidence 95 %); it is negative where none is certain. ``stiffness`` is the mean in N·m/rad
    without a reflex and with it. ``torque`` is that of the reflex in N·m, shape (realization,
    time), context included; 0 where the past is unknown.
    """

    direction: int
    over_none: float
    over_linear: float
    share: float
    stiffness: tuple[float, float]
    torque: Array

    @property
    def shown(self) -> bool:
        """Return whether the reflex predicts better than no reflex and than a linear response."""
        return max(self.over_none, self.over_linear) < MAX_P_VALUE


class _Regression(NamedTuple):
    """Regressors and torque, which is last: ``rows`` (realization, time, regressor).

    The first regressors are the joint's: lagged angles, then angle and velocity times harmonics of
    the realization, whose numbers are ``harmonics``. ``mean`` gives the mean stiffness of their
    weights. Then come the late responses of a usual muscle to positive, to negative and to any
    velocity, and responses to either velocity as triangles that make up any response.
    ``products`` (block, regressor, regressor) are those of neighbouring realizations. ``samples``
    are those of the ensemble at which all lags are known.
    """

    rows: Array
    products: Array
    harmonics: NDArray[np.int64]
    mean: Array
    samples: slice

    def weights(self, products: Array, late: Sequence[int], harmonics: int = HARMONICS) -> Array:
        """Return least-squares weights of a joint with so many harmonics and of late regressors.

        The numbers of the late ones begin with 0. The weights of other regressors are 0.
        """
        own = np.flatnonzero(self.harmonics <= harmonics)
        chosen = np.append(own, len(self.harmonics) + np.array(late, dtype=int))
        gram, cross = products[np.ix_(chosen, chosen)], products[chosen, -1]
        size = np.sqrt(np.where(gram.diagonal() > 0, gram.diagonal(), 1.0))
        weights = np.zeros(len(products) - 1)
        weights[chosen] = solve_regularized(gram / np.outer(size, size), cross / size) / size
        return weights

    def predicted(self, late: Sequence[int], harmonics: int = HARMONICS) -> Array:
        """Return the torque in each block that a model fitted to the others predicts."""
        others = self.products.sum(axis=0) - self.products
        fits = zip(_blocks(self.rows), others, strict=True)
        return np.concatenate(
            [block[..., :-1] @ self.weights(left, late, harmonics) for block, left in fits]
        )

    def errors(self, predicted: Array) -> Array:
        """Return the squared error of each realization, with that of rounding."""
        torque = self.rows[..., -1]
        return np.asarray(np.sum((torque - predicted) ** 2 + ROUNDING * torque**2, axis=1))

    def improvement(self, simple: Array, further: Array) -> tuple[float, float]:
        """Test whether a further prediction improves on a simple one. See ``_above_zero``."""
        torque = self.rows[..., -1]
        gain = np.sum((torque - simple) * (further - simple), axis=1)
        is_rounding = np.abs(gain) <= ROUNDING * np.sum(torque**2, axis=1)
        return _above_zero(np.where(is_rounding, 0.0, gain / self.errors(simple)))

    def fit(self, late: Sequence[int]) -> tuple[float, Array]:
        """Return the mean stiffness of a fit to all realizations, and the torque that is late."""
        weights, own = self.weights(self.products.sum(axis=0), late), len(self.mean)
        return float(self.mean @ weights[:own]), self.rows[..., own:-1] @ weights[own:]


def is_time_varying(ensemble: Ensemble) -> bool:
    """Return whether stiffness or viscosity change over a realization, beside any reflex.

    The first harmonics of the realization are tested as :func:`reflex_test_of` tests a reflex.
    False where realizations are too short to tell.
    """
    try:
        regression = _regression(ensemble)
    except InputError:
        return False
    either = (POSITIVE, NEGATIVE)
    constant, changing = (regression.predicted(either, most) for most in (0, TESTED_HARMONICS))
    return regression.improvement(constant, changing)[0] < MAX_P_VALUE


@lru_cache(maxsize=1)  # adaptive, cascade and checks ask for the same ensemble
def reflex_test_of(ensemble: Ensemble) -> ReflexTest:
    r"""Test for a stretch reflex by nested models, fitted to all but a block of realizations.

    The joint's response lasts 40 ms to either side, and its stiffness and viscosity vary over a
    realization. A reflex adds a response to the velocity where that is positive, or where it is
    negative, through a usual muscle (16 rad/s, a damping of 0.8). The muscle begins 40 ms later
    and is over after 330 ms. What the reflex adds to a simpler model, without a reflex or with
    one that is linear, is tested by

    .. math:: \sum_t (y - \hat y_0)(\hat y_1 - \hat y_0)

    of each realization over its :math:`\sum_t (y - \hat y_0)^2`. It is zero on average if the
    simpler model 0 is right. The difference of squared errors would be lower by what useless
    coefficients cost, and has half the power. Where a cubic polynomial of time is most of the
    torque, as of slow voluntary torque, it is left out of each realization.

    The velocity is rectified at the rate at which the angle was recorded.

    Raises
    ------
    InputError
        If all lags are known at fewer than 20 samples of a realization.

    References
    ----------
    Clark & West 2007, J. Econometrics 138, 291-311: nested models by what they predict.
    """
    regression = _regression(ensemble)
    models = (), (LINEAR,), (POSITIVE, NEGATIVE), (POSITIVE,), (NEGATIVE,)
    none, linear, both, *directed = (regression.predicted(late) for late in models)
    positive, negative = (np.log(regression.errors(each)) for each in directed)
    index = 0 if np.sum(negative - positive) >= 0 else 1
    over_none, share_over_none = regression.improvement(none, directed[index])
    over_linear, share_over_linear = regression.improvement(linear, both)
    triangles = range(LINEAR + 1 + index * TRIANGLES, LINEAR + 1 + (index + 1) * TRIANGLES)
    (one_path, _), (two_paths, late_torque) = map(regression.fit, ((), triangles))
    torque = np.zeros(ensemble.torque.shape)
    torque[np.concatenate(ensemble.runs), regression.samples] = late_torque
    return ReflexTest(
        direction=(1, -1)[index],
        over_none=min(1.0, 2 * over_none),  # each of two directions may add to none by chance
        over_linear=over_linear,
        share=min(share_over_none, share_over_linear),
        stiffness=(one_path, two_paths),
        torque=torque,
    )


def prediction_p_value(errors: Array, others: Array) -> float:
    """Return the p-value that errors are smaller than others.

    Squared errors of the same held-out realizations are compared by their logarithms, as some
    realizations are louder than others.
    """
    return _above_zero(np.log(others / errors))[0]


def _above_zero(scores: Array) -> tuple[float, float]:
    """Return the p-value that the scores' mean is above zero, and its lower 95 % limit.

    They are 1 and 0 if the scores are too few or do not differ.
    """
    count = len(scores)
    error = float(scores.std(ddof=1)) / math.sqrt(count) if count >= MIN_TESTED_REALIZATIONS else 0
    if error == 0:
        return 1.0, 0.0
    mean = float(scores.mean())
    least = mean - error * float(stdtrit(count - 1, CONFIDENCE))
    return float(stdtr(count - 1, -mean / error)), least


def _regression(ensemble: Ensemble) -> _Regression:
    """Return the regressors and the torque at all times whose lags are known."""
    rate, core, order = ensemble.sampling_rate, ensemble.core, np.concatenate(ensemble.runs)
    seconds = RESPONSE_REACH_S, MIN_REFLEX_LAG_S, MAX_REFLEX_LAG_S
    reach, soonest, latest = (round(each * rate) for each in seconds)
    start, stop = max(core.start, latest), min(core.stop, ensemble.angle.shape[1] - reach)
    if stop - start < MIN_SAMPLES:
        raise InputError(
            f"reflex_test: the {MAX_REFLEX_LAG_S:g} s before are known at {max(stop - start, 0)} "
            f"samples of a realization, it takes {MIN_SAMPLES}; give longer realizations, or "
            f"{MAX_REFLEX_LAG_S:g} s of context"
        )
    phase = (np.arange(start, stop) - core.start) / ensemble.samples
    waves = np.exp(2j * np.pi * phase[:, None] * np.arange(1, HARMONICS + 1))
    waves = np.concatenate([waves.real, waves.imag], axis=1)
    lags = np.arange(latest, soonest - 1, -1)  # the first sample of a window is the earliest
    apart = np.abs(lags[:, None] - np.linspace(soonest, latest, TRIANGLES))
    triangles = np.maximum(0.0, 1 - apart * (TRIANGLES - 1) / (latest - soonest))
    frequency, damping = USUAL_MUSCLE
    late = np.linspace(0, MAX_REFLEX_LAG_S - MIN_REFLEX_LAG_S, TRIANGLES)
    turn = frequency * math.sqrt(1 - damping**2)
    usual = np.exp(-damping * frequency * late) * np.sin(turn * late)

    signals = np.stack([ensemble.angle, ensemble.torque, *rectified_velocities(ensemble)])[:, order]
    angle, torque, *stretches = signals - signals.mean(axis=1, keepdims=True)
    near = sliding_window_view(angle, 2 * reach + 1, axis=1)[:, start - reach : stop - reach]
    motion = [each[:, start:stop, None] * waves for each in (angle, sum(stretches))]
    past = sliding_window_view(stretches, len(lags), axis=2)[:, :, start - latest : stop - latest]
    free = past @ triangles
    muscle = np.moveaxis(free @ usual, 0, -1)
    muscles = muscle, muscle.sum(axis=-1, keepdims=True)
    torque = torque[:, start:stop]
    rows = np.concatenate([near, *motion, *muscles, *free, torque[..., None]], axis=2)
    slow = np.linalg.qr(np.vander(phase, SLOW_TERMS))[0]
    if 2 * np.sum((torque @ slow) ** 2) >= np.sum(torque**2):
        rows -= slow @ (slow.T @ rows)
    flat = (block.reshape(-1, block.shape[2]) for block in _blocks(rows))
    width = near.shape[2]
    mean = np.concatenate([np.ones(width), waves.mean(axis=0), np.zeros(waves.shape[1])])
    harmonics = np.pad(np.tile(np.arange(1, HARMONICS + 1), 4), (width, 0))
    products = np.stack([each.T @ each for each in flat])
    return _Regression(rows, products, harmonics, mean, slice(start, stop))


def _blocks(rows: Array) -> list[Array]:
    """Split realizations into blocks of neighbours."""
    return np.split(rows, [len(rows) * block // BLOCKS for block in range(1, BLOCKS)])
