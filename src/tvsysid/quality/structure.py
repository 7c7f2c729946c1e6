"""What a joint of second order that is moved from outside does not do: closed loop, reflexes, slow answers."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.fitted import FittedEnsemble, NotJudged, Seen
from tvsysid.quality.statistics import LEAST_REALIZATIONS, SIGNIFICANT, gained, gains, p_value_of, without
from tvsysid.signals import Array

AHEAD = 0.03  # seconds ahead that the angle is predicted: within them derivatives' filters tell even of an imposed one
MIRRORED = 1.5  # times what is predicted of the angle before that must be predicted of the angle after to be a cause
PAST_ANGLE = 0.2  # seconds of the angle's past that predict it by themselves
PAST_NOISE = 0.15  # seconds of the residual torque that may add to it
SOONEST, LATEST, STEP = 0.04, 0.3, 0.03  # lags of a reflex in s
SHORT = "realizations and their context are too short"


def feedback(data: FittedEnsemble) -> Seen:
    """Whether noise in the torque predicts the angle beyond what the angle's own past does (Granger's test).

    What a model leaves of the torque is not noise alone: a small delay or a filter that does not match leaves a
    function of the angle, which tells of the angle before as well as of the angle after. A cause does not: the same
    test with time reversed must tell clearly less.
    """
    data.require(LEAST_REALIZATIONS)
    if FAULTS["coarse-angle"].beyond(data.angle_step):
        raise NotJudged("the angle is recorded in steps so coarse that the torque tells it better")
    angle, residual, first = data.angle, data.fit.residual, data.fit.first
    after = angle.shape[1] - first - residual.shape[1]
    forward = _predicted(angle, residual, first, data.rate)
    backward = _predicted(angle[:, ::-1], residual[:, ::-1], after, data.rate)
    share, before = forward.mean(), backward.mean()
    what = (
        f"noise in the torque predicts {_percent(share)} of the angle's unpredicted movement {1000 * AHEAD:.0f} ms "
        f"later, and {_percent(before)} of that {1000 * AHEAD:.0f} ms before"
    )
    more = share > MIRRORED * before and p_value_of(forward - backward) < SIGNIFICANT
    return Seen(100 * max(0.0, share), what, bool(more and p_value_of(forward) < SIGNIFICANT))


def _predicted(angle: Array, residual: Array, first: int, rate: float) -> Array:
    """Share of the angle's unpredicted movement that the residual torque predicts, in each realization over all's mean.

    The first sample of the residual belongs to sample ``first`` of the angle.
    """
    ahead = max(1, round(AHEAD * rate))
    own_lags = np.arange(ahead, ahead + round(PAST_ANGLE * rate))
    noise_lags = np.arange(ahead, ahead + round(PAST_NOISE * rate), 2)
    start, stop = max(int(own_lags.max()), first + int(noise_lags.max())), first + residual.shape[1]
    if stop - start < int(noise_lags.max()):
        raise NotJudged(SHORT)
    past = np.stack([angle[:, start - lag : stop - lag] for lag in own_lags])
    noise = np.stack([residual[:, start - first - lag : stop - first - lag] for lag in noise_lags])
    target = without(angle[:, start:stop], past)
    total = float(np.sum(target**2))
    return gains(target, without(noise, past)) * len(target) / total if total > 0 else np.zeros(len(target))


def reflex(data: FittedEnsemble) -> Seen:
    """Whether the residual torque follows the size of a late velocity, which a linear joint cannot."""
    return _late(data, np.abs(_velocity(data)), "the speed", ", regardless of its direction,")


def slow_answer(data: FittedEnsemble) -> Seen:
    """Whether the residual torque follows late velocities."""
    return _late(data, _velocity(data), "the movement")


def _velocity(data: FittedEnsemble) -> Array:
    return np.asarray(np.gradient(data.angle, 1 / data.rate, axis=1))


def _late(data: FittedEnsemble, cause: Array, name: str, direction: str = "") -> Seen:
    """Share of the residual torque that a cause, of the angle's shape, predicts with the lags of a reflex."""
    data.require(LEAST_REALIZATIONS)
    lags = np.unique(np.round(np.arange(SOONEST, LATEST, STEP) * data.rate).astype(np.int64))
    first, count = data.fit.first, data.fit.torque.shape[1]
    # The samples of the fit before which all lags are known.
    start, stop = max(first, int(lags.max())), first + count
    if stop - start < 2 * HALF_WIDTH:
        raise NotJudged(SHORT)
    windows = sliding_window_view(cause - cause.mean(axis=0), stop - start, axis=1)
    causes = np.stack([windows[:, start - lag] for lag in lags])
    share, probability = gained(data.fit.residual[:, start - first :], causes)
    when = f"{1000 * SOONEST:.0f} to {1000 * LATEST:.0f} ms before"
    what = f"{name} {when}{direction} predicts {_percent(share)} of the residual torque"
    return Seen(100 * max(0.0, share), what, probability < SIGNIFICANT)


def _percent(share: float) -> str:
    return f"{max(0.0, 100 * share):.2g} %"
