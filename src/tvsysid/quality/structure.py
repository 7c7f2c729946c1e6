"""Check for what a passive second-order joint does not do: feedback, reflexes, slow answers."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.errors import InputError
from tvsysid.methods.cascade.reflex_test import LATEST, MIN_TESTED_REALIZATIONS, SOONEST
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.instrument import HARDLY_MOVED, lag_samples, predicted, realization_groups
from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.fitted import FittedEnsemble, NotJudged, Seen
from tvsysid.quality.statistics import (
    SIGNIFICANT,
    gained,
    gains,
    p_value_of,
    without,
)
from tvsysid.signals import Array

# seconds ahead that the angle is predicted: within them derivatives' filters tell even of an
# imposed one
AHEAD = 0.03
PAST_ANGLE = 0.2  # seconds of the angle's past that predict it by themselves
PAST_CAUSE = 0.15  # seconds of a channel that may add to it
# Shares of the unpredicted movement: that what was applied predicts of the angle at least, and the
# angle of it at most.
LEADS, FOLLOWS = 0.04, 0.02
BESIDE = 6  # samples of the torque to either side from which it is explained
SLOWEST, STEP = 0.3, 0.03  # longest lag of a slow answer and step between lags, in s
LATEST_FUTURE = 0.27  # s: how much later the movement is of which the torque should not know
SHORT = "realizations and their context are too short"


def feedback(data: FittedEnsemble) -> Seen:
    """Return the share of the torque that later movement predicts (Sims, 1972).

    Earlier movement and the joint's response are taken into account first. An imposed angle's
    future tells nothing of the torque's noise, of which a joint that it moves tells; a reflex is
    late. All is whitened by the noise, and judged by realizations that were not fitted to.
    """
    data.require(MIN_TESTED_REALIZATIONS)
    if FAULTS["coarse-angle"].beyond(data.angle_step):
        raise NotJudged("the angle is recorded in steps so coarse that the torque tells it better")
    angle, residual, step = (
        data.whitened(data.angle),
        data.white_residual,
        max(1, round(STEP * data.rate)),
    )
    lags = 1 + step * np.arange(1, 1 + round(LATEST_FUTURE / STEP))
    start, stop = (
        max(data.fit.first, lags[-1]),
        min(data.fit.first + residual.shape[1], angle.shape[1] - lags[-1]),
    )
    if stop - start < lags[-1]:
        raise NotJudged(SHORT)
    inside = slice(start - data.fit.first, stop - data.fit.first)
    windows = sliding_window_view(angle, stop - start, axis=1).transpose(1, 0, 2)
    own, later = windows[start + np.r_[-lags, -1:2]], windows[start + lags]
    gain = gains(without(residual[:, inside], own), without(later, own))
    share = float(
        gain.sum() / np.sum((data.white_parts.sum(axis=0) + data.white_residual)[:, inside] ** 2)
    )
    first, last = (1000 * lags[[0, -1]] / data.rate).round().astype(int)
    what = f"movement {first} to {last} ms later predicts {_percent(share)} of the torque"
    return Seen(100 * max(0.0, share), what, share > 0 and p_value_of(gain) < SIGNIFICANT)


def loop_bias(data: FittedEnsemble, reference: str) -> Seen:
    """Test whether the stiffness changes if the angle is replaced by its prediction.

    The reference predicts the angle. By one step from the open-loop fit, whose residual is then no
    answer to what the reference moves.
    """
    data.require(MIN_TESTED_REALIZATIONS)
    ensemble, fit, (early, late) = data.ensemble, data.fit, lag_samples(data.rate)
    assert ensemble.trials is not None
    assert ensemble.onsets is not None
    groups = realization_groups(ensemble.trials, ensemble.onsets)
    moved = predicted(
        np.pad(data.signal(reference), ((0, 0), (late, early))),
        data.angle,
        ensemble.core,
        data.rate,
        groups,
    )
    core = data.core("angle")
    explained = 1 - float(np.sum((core - moved[:, ensemble.core]) ** 2) / np.sum(core**2))
    if not explained >= HARDLY_MOVED:
        raise NotJudged(
            f"the disturbance {reference!r} hardly moves the angle: it predicts "
            f"{_percent(explained)} of it"
        )
    first = fit.first - HALF_WIDTH
    z = differentiate(moved, data.rate)[:, :, first : first + fit.torque.shape[1]]
    # All times count alike: the angle moves farther where the joint gives way, and a sum of squares
    # dwells there.
    power = (
        np.bincount(fit.bins, np.mean(z[0] ** 2, axis=0))[fit.bins]
        / np.bincount(fit.bins)[fit.bins]
    )
    inverse = np.linalg.pinv(np.einsum("art,brt->ab", z / power, fit.motion))
    # Of the stiffness, in each realization. The residual has no part in the whole movement, which
    # is noise in each.
    missing = np.einsum("a,art,rt->r", inverse[0], (z - fit.motion) / power, fit.residual)
    biased = float(fit.stiffness[fit.bins].mean())
    closed = biased + float(missing.sum())
    what = (
        f"the mean stiffness is {biased:.3g} N·m/rad in open loop, {closed:.3g} with "
        f"{reference!r} as the reference, "
        f"which predicts {_percent(explained)} of the angle; identify by --method "
        f"kbr:reference={reference},weighting=residual"
    )
    return Seen(-100 * float(missing.sum()) / abs(closed), what, p_value_of(missing) < SIGNIFICANT)


def applied(data: FittedEnsemble, channel: str) -> Seen:
    """Test what ``channel`` changes as a reference, if it is what was applied.

    It was applied if it moves the angle and the angle does not move it. EMG and further sensors of
    the angle follow it, or hardly lead it; those of the torque are the torque and noise; and EMG
    that makes the torque's noise gives a stiffness that is lower still, which is the load's.
    """
    data.require(MIN_TESTED_REALIZATIONS)
    values = data.signal(channel)
    both = np.concatenate([data.torque, data.angle])
    torques, angles = np.split(
        sliding_window_view(both, values.shape[1] - 2 * BESIDE, axis=1).transpose(1, 0, 2), 2, 1
    )
    middle = values[:, BESIDE:-BESIDE]
    by_angle = gained(without(middle, torques), without(angles, torques))[0]
    if (
        not by_angle > gained(middle, torques)[0]
    ):  # a sensor is the torque and noise; a command, torque and load
        raise NotJudged(f"{channel!r} is the torque")
    leads, follows = (
        _predicted(data.angle, values, data.rate),
        _predicted(values, data.angle, data.rate),
    )
    if not leads > LEADS or follows > FOLLOWS:
        raise NotJudged(f"{channel!r} does not move before the angle")
    seen = loop_bias(data, channel)
    return seen if seen.value < 0 else seen._replace(significant=False)


def _predicted(signal: Array, cause: Array, rate: float) -> float:
    """Share of a signal's movement, unpredicted by its own past, that a cause's past predicts."""
    ahead = max(1, round(AHEAD * rate))
    own, lags = (
        ahead + np.arange(round(PAST_ANGLE * rate)),
        ahead + np.arange(0, round(PAST_CAUSE * rate), 2),
    )
    start, stop = own[-1], signal.shape[1]
    if stop - start < lags[-1]:
        raise NotJudged(SHORT)
    past, causes = (
        np.stack([values[:, start - lag : stop - lag] for lag in each])
        for values, each in ((signal, own), (cause, lags))
    )
    return gained(without(signal[:, start:], past), without(causes, past))[0]


def reflex(data: FittedEnsemble) -> Seen:
    """Test whether late velocity of one direction predicts torque as a stretch reflex does.

    This torque is predicted neither by the joint nor by the other direction.
    """
    data.require(MIN_TESTED_REALIZATIONS, answer=False)
    try:
        test = data.reflex
    except InputError:
        raise NotJudged(SHORT) from None
    data.require()
    one_path, two_paths = test.stiffness
    what = (
        f"{'positive' if test.direction > 0 else 'negative'} velocity predicts at least "
        f"{_percent(test.share)} of the "
        f"residual torque {1000 * SOONEST:.0f} to {1000 * LATEST:.0f} ms later, which neither no "
        "reflex does "
        f"(p = {test.over_none:.1g}) nor one that is linear (p = {test.over_linear:.1g}); the "
        "mean stiffness is "
        f"{one_path:.3g} N·m/rad with the reflex's torque in it, {two_paths:.3g} without"
    )
    if two_paths > 0:
        what += f": {100 * (one_path / two_paths - 1):+.0f} % in these data"
    return Seen(100 * max(0.0, test.share), what, test.shown)


def slow_answer(data: FittedEnsemble) -> Seen:
    """Share of the residual torque that late velocities predict, where no reflex does."""
    data.require(MIN_TESTED_REALIZATIONS)
    with suppress(InputError):
        if data.reflex.shown:
            raise NotJudged("a reflex is found, whose answer is late; longer lags do not mend that")
    lags = np.unique(np.round(np.arange(SOONEST, SLOWEST, STEP) * data.rate).astype(np.int64))
    first, count = data.fit.first, data.fit.torque.shape[1]
    # The samples of the fit before which all lags are known.
    start, stop = max(first, int(lags.max())), first + count
    if stop - start < 2 * HALF_WIDTH:
        raise NotJudged(SHORT)
    velocity = np.gradient(data.angle, 1 / data.rate, axis=1)
    windows = sliding_window_view(velocity, stop - start, axis=1)
    causes = np.stack([windows[:, start - lag] for lag in lags])
    share, probability = gained(data.fit.residual[:, start - first :], causes)
    when = f"{1000 * SOONEST:.0f} to {1000 * SLOWEST:.0f} ms before"
    what = f"the movement {when} predicts {_percent(share)} of the residual torque"
    return Seen(100 * max(0.0, share), what, probability < SIGNIFICANT)


def _percent(share: float) -> str:
    return f"{max(0.0, 100 * share):.2g} %"
