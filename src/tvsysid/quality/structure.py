"""Check for what a passive second-order joint does not do: feedback, reflexes, slow responses."""

from __future__ import annotations

import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.cascade.reflex_test import HARMONICS, reflex_test_of
from tvsysid.methods.cascade.search import one_path_stiffness
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.instrument import MIN_PREDICTED, lag_samples, predicted, realization_groups
from tvsysid.quality.checks import Measured, NotApplicable, check
from tvsysid.quality.fit import FittedEnsemble
from tvsysid.quality.statistics import (
    gained_share,
    gains,
    is_mean_significant,
    lagged,
    without,
)
from tvsysid.signals import Array

# Samples at some 100 Hz by which movement is later or earlier.
FEEDBACK_LAGS, LATE_LAGS = 1 + np.arange(3, 28, 3), np.arange(4, 29, 3)
# Samples by which a channel that was applied must predict the angle (filters of derivatives know
# nearer samples of an imposed one), and numbers of past samples of angle and channel.
AHEAD, ANGLE_PAST, CAUSE_PAST = 3, 20, 15
# Least share of the angle that the channel's past predicts, and largest share of the reverse.
MIN_LEAD, MAX_FOLLOW = 0.04, 0.02
TORQUE_LAGS = 6  # samples of the torque to either side that may explain a channel
TOO_SHORT = "realizations and their context are too short"


@check(
    "loop-bias",
    "Closed loop: the reference changes the stiffness",
    "mean stiffness without the reference over that with it as the instrument, minus 1",
    5,
    "%",
    "closed loop",
    effect="methods that take the angle as imposed are biased by as much; no band shows it, and a "
    "longer record does not help",
    remedy="identify with the reference, as the finding says "
    "(kbr:reference=NAME,weighting=residual)",
)
def loop_bias(data: FittedEnsemble, reference: str, declared: bool = True) -> Measured:
    """Return by how much stiffness changes with the angle that the reference predicts.

    It is one step from the open-loop fit to one whose residual is not correlated with the predicted
    angle. A channel that was not declared must move the angle, and give a higher stiffness than the
    open loop: EMG that makes the torque's noise gives the stiffness of the load, which is lower.
    """
    data.require()
    if not declared:
        _require_leading(data, reference)
    moved, explained = _moved_angle(data, reference)
    share = f"{max(0.0, 100 * explained):.2g} %"
    if not explained >= MIN_PREDICTED:
        raise NotApplicable(
            f"the disturbance {reference!r} hardly moves the angle: it predicts {share} of it"
        )
    fit, first = data.fit, data.region.start - HALF_WIDTH
    instrument = differentiate(moved, data.rate)[:, :, first : first + fit.torque.shape[1]]
    # All times have the same weight. In a sum of squares, those at which the joint is soft would
    # dominate, because the angle moves farther.
    power = np.mean(instrument[0] ** 2, axis=0)
    power = (np.bincount(fit.bins, power) / np.bincount(fit.bins))[fit.bins]
    inverse = np.linalg.pinv(np.einsum("art,brt->ab", instrument / power, fit.motion))
    # Change of stiffness by each realization. The residual is not correlated with the measured
    # movement: their products are noise, and are left out.
    change = (instrument - fit.motion) / power
    missing = np.einsum("a,art,rt->r", inverse[0], change, fit.residual)
    open_loop = fit.impedance[0].mean()
    closed = open_loop + missing.sum()
    what = (
        f"the mean stiffness is {open_loop:.3g} N·m/rad in open loop, {closed:.3g} with "
        f"{reference!r} as the reference, which predicts {share} of the angle; "
        f"identify by --method kbr:reference={reference},weighting=residual"
    )
    value = -100 * missing.sum() / abs(closed)
    return Measured(value, what, is_mean_significant(missing) and (declared or value < 0))


def _moved_angle(data: FittedEnsemble, reference: str) -> tuple[Array, float]:
    """Return the angle that a reference predicts, (realization, time), and its share of the angle.

    Realizations are predicted by what the others show.
    """
    ensemble = data.ensemble
    core = data.ensemble.core
    (after, before) = lag_samples(data.rate)
    groups = realization_groups(ensemble.trials, ensemble.onsets)
    command = np.pad(data.signal(reference), ((0, 0), (before, after)))
    moved = predicted(command, data.angle, core, data.rate, groups)
    left = np.sum((data.angle - moved)[:, core] ** 2)
    return moved, 1 - left / np.sum(data.angle[:, core] ** 2)


def _require_leading(data: FittedEnsemble, channel: str) -> None:
    """Raise NotApplicable for a channel that does not move the angle.

    EMG and further sensors of the angle follow it or hardly lead it. A sensor of the torque gives
    the torque and noise. A command gives the torque of joint and load.
    """
    values, reach = data.signal(channel), TORQUE_LAGS
    ends = reach, values.shape[1] - reach
    torques, angles = (
        lagged(each, range(-reach, reach + 1), *ends) for each in (data.torque, data.angle)
    )
    middle = values[:, slice(*ends)]
    if not gained_share(middle, angles, torques) > gained_share(middle, torques):
        raise NotApplicable(f"{channel!r} is the torque")
    leads = _predicted(data.angle, values)
    follows = _predicted(values, data.angle)
    if leads < MIN_LEAD or follows > MAX_FOLLOW:
        raise NotApplicable(f"{channel!r} does not move before the angle")


def _predicted(signal: Array, cause: Array) -> float:
    """Return the share of a signal, unpredicted by its own past, that a cause's past predicts."""
    own = AHEAD + np.arange(ANGLE_PAST)
    lags = AHEAD + np.arange(0, CAUSE_PAST, 2)
    start, stop = own[-1], signal.shape[1]
    causes = lagged(cause, lags, start, stop)
    past = lagged(signal, own, start, stop)
    return gained_share(signal[:, start:], causes, past)


@check(
    "feedback",
    "Closed loop: torque noise moves the angle",
    "share of the torque that later movement predicts, beyond earlier movement",
    3,
    "%",
    "closed loop",
    effect="most methods take the angle as imposed; if noise in the torque moves it, stiffness, "
    "viscosity and inertia come out too low",
    remedy="check that both channels pass the same filters; use a stiffer actuator, or identify "
    "with the actuator's command as the reference (tvsysid identify … --channel command=… --method "
    "kbr:reference=command,weighting=residual)",
)
def feedback(data: FittedEnsemble) -> Measured:
    """Return the share of the torque that later movement predicts (Sims, 1972).

    Earlier movement and the joint's response are taken into account first. Later movement predicts
    the torque's noise only if noise moves the angle. A reflex comes after the movement, and is no
    feedback. All signals are whitened, and the test is by held-out realizations.
    """
    data.require()
    fit = data.fit
    origin = data.region.start
    last = FEEDBACK_LAGS[-1]
    angle = fit.whitened(data.angle)
    torque = fit.whitened(np.stack([fit.residual, fit.torque]))
    start = max(origin, last)
    stop = min(origin + torque.shape[2], angle.shape[1] - last)
    if stop - start < last:
        raise NotApplicable(TOO_SHORT)
    earlier = lagged(angle, [*FEEDBACK_LAGS, 1, 0, -1], start, stop)
    residual, whole = torque[..., start - origin : stop - origin]
    later = lagged(angle, -FEEDBACK_LAGS, start, stop)
    gain = gains(without(residual, earlier), without(later, earlier))
    return _gained(gain, whole, "movement 40 to 280 ms later predicts {} of the torque")


@check(
    "reflex",
    "A stretch reflex",
    "share of the residual torque, at least (95 % confidence), that velocity in one direction "
    "predicts 40 to 330 ms later, and an equal response to both directions does not",
    0.1,
    "%",
    "one pathway",
    effect="methods with one pathway include the torque of the stretch reflex in the stiffness: "
    "stiffness and inertia come out too high, viscosity too low; no band shows it",
    remedy="use a method that separates the pathways, as adaptive does: tv.AdaptiveRegression() "
    "(tvsysid identify … --method adaptive)",
)
def reflex(data: FittedEnsemble) -> Measured:
    """Test whether late velocity of one direction predicts torque as a stretch reflex does.

    Neither the joint nor the other direction predicts this torque.
    """
    data.require()
    try:
        test = reflex_test_of(data.ensemble)
    except InputError as error:
        raise NotApplicable(TOO_SHORT) from error
    share = 100 * max(0.0, test.share)
    chance = f"p = {test.over_none:.1g} against no reflex"
    if test.over_linear < 1:
        chance += f", {test.over_linear:.1g} against an equal response to both directions"
    if not test.shown:
        return Measured(share, f"no stretch reflex is detected ({chance})", significant=False)
    fit = JointCascade(HARMONICS).select(data.ensemble).reflex
    what = (
        f"{'positive' if test.direction > 0 else 'negative'} velocity predicts at least "
        f"{share:.2g} % of the residual torque 40 to 330 ms later ({chance}); the mean stiffness "
        f"is {one_path_stiffness(data.ensemble):.3g} N·m/rad with the reflex's torque in it, "
        f"{fit.posterior.mean[0]:.3g} without"
    )
    return Measured(share, what)


@check(
    "slow-answer",
    "More than stiffness, viscosity and inertia",
    "share of the residual torque that movement 40 to 300 ms earlier predicts, without a reflex",
    10,
    "%",
    "serious",
    effect="a model of second order (birf, kbr) misses this part; impulse responses include it as "
    "far as their lags reach",
    remedy="use lags as long as the response (eirf:max_lag=0.4; sds:max_lag=0.4,window=0.4), also "
    "with --tune; look for a wrong sampling rate, a soft coupling, or a filter in one channel",
)
def slow_answer(data: FittedEnsemble) -> Measured:
    """Return the share of the residual torque that late velocities predict without a reflex."""
    data.require()
    if data.finding("reflex").found:
        raise NotApplicable("a reflex is found, which is late, too: see its remedy")
    region = data.region
    start = max(data.region.start, LATE_LAGS[-1])
    causes = lagged(np.gradient(data.angle, axis=1), LATE_LAGS, start, region.stop)
    residual = data.fit.residual[:, start - region.start :]
    what = "the movement 40 to 300 ms before predicts {} of the residual torque"
    return _gained(gains(residual, causes), residual, what)


def _gained(gain: Array, target: Array, what: str) -> Measured:
    """Return the share of a signal that is predicted, from the gain in each realization."""
    share = 100 * max(0.0, gain.sum() / np.sum(target**2))
    is_sure = share > 0 and is_mean_significant(gain)
    return Measured(share, what.format(f"{share:.2g} %"), is_sure)
