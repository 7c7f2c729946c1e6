"""Check for what a passive second-order joint does not do: feedback, reflexes, slow responses."""

from __future__ import annotations

import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.cascade.reflex_test import MAX_REFLEX_LAG_S, MIN_REFLEX_LAG_S, reflex_test_of
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.instrument import HARDLY_MOVED, lag_samples, predicted, realization_groups
from tvsysid.quality.checks import Measured, NotApplicable, check
from tvsysid.quality.fitted import FittedEnsemble
from tvsysid.quality.statistics import gained_share, gains, is_mean_significant, lagged, without
from tvsysid.signals import Array

STEP_S, MAX_LEAD_S, MAX_LAG_S = 0.03, 0.27, 0.3  # lags of later and of earlier movement
# Of a channel that may have been applied: how far ahead it predicts the angle, as derivatives'
# filters know nearer samples of an imposed one, and how much of the past of both counts.
AHEAD_S, ANGLE_PAST_S, CAUSE_PAST_S = 0.03, 0.2, 0.15
# Shares of unpredicted movement: of the angle by the channel at least, and the reverse at most.
MIN_LEAD, MAX_FOLLOW = 0.04, 0.02
TORQUE_LAGS = 6  # samples of the torque to either side that may explain a channel
TOO_SHORT = "realizations and their context are too short"


@check(
    "feedback",
    "Closed loop: torque noise moves the angle",
    "share of the torque that later movement predicts, beyond earlier movement",
    3,
    "%",
    effect="most methods take the angle as imposed; if noise in the torque moves it, stiffness, "
    "viscosity and inertia come out too low",
    remedy="check that both channels pass the same filters; use a stiffer actuator, or identify "
    "with the actuator's command as the reference (tvsysid identify … --channel command=… --method "
    "kbr:reference=command,weighting=residual)",
)
def feedback(data: FittedEnsemble) -> Measured:
    """Return the share of the torque that later movement predicts (Sims, 1972).

    Earlier movement and the joint's response are taken into account first. The future of an
    imposed angle says nothing about the torque's noise, that of an angle which it moves does. A
    reflex is late. All signals are whitened, and the test is by held-out realizations.
    """
    data.require()
    if data.finding("coarse-angle").beyond:
        raise NotApplicable(
            "the angle is recorded in such coarse steps that the torque shows it better"
        )
    fit, origin = data.fit, data.region.start
    angle, torque = fit.whitened(data.angle), fit.whitened(np.stack([fit.residual, fit.torque]))
    lags = 1 + max(1, round(STEP_S * data.rate)) * np.arange(1, 1 + round(MAX_LEAD_S / STEP_S))
    start = max(origin, lags[-1])
    stop = min(origin + torque.shape[2], angle.shape[1] - lags[-1])
    if stop - start < lags[-1]:
        raise NotApplicable(TOO_SHORT)
    earlier = lagged(angle, [*lags, 1, 0, -1], start, stop)
    residual, whole = torque[..., start - origin : stop - origin]
    gain = gains(without(residual, earlier), without(lagged(angle, -lags, start, stop), earlier))
    share = gain.sum() / np.sum(whole**2)
    first, last = (1000 * lags[[0, -1]] / data.rate).round().astype(int)
    what = f"movement {first} to {last} ms later predicts {_percent(share)} of the torque"
    return Measured(100 * max(0.0, share), what, share > 0 and is_mean_significant(gain))


@check(
    "loop-bias",
    "Closed loop: the reference changes the stiffness",
    "mean stiffness of a fit in open loop over that with the reference as the instrument, minus 1",
    5,
    "%",
    effect="methods that take the angle as imposed are biased by as much; no band shows it, and a "
    "longer record does not help",
    remedy="identify with the reference, as the finding says "
    "(kbr:reference=NAME,weighting=residual)",
)
def loop_bias(data: FittedEnsemble, reference: str, declared: bool = True) -> Measured:
    """Return by how much stiffness changes with the angle that the reference predicts.

    It is one step from the open-loop fit to one whose residual has no part in what the reference
    moves. A channel that was not declared must move the angle, and lower the stiffness: EMG that
    makes the torque's noise gives a stiffness that is lower still, which is the load's.
    """
    data.require()
    if not declared:
        _require_leading(data, reference)
    moved, explained = _moved_angle(data, reference)
    if not explained >= HARDLY_MOVED:
        raise NotApplicable(
            f"the disturbance {reference!r} hardly moves the angle: it predicts "
            f"{_percent(explained)} of it"
        )
    fit, first = data.fit, data.region.start - HALF_WIDTH
    instrument = differentiate(moved, data.rate)[:, :, first : first + fit.torque.shape[1]]
    # All times count alike. The angle moves farther where the joint is soft, and a sum of squares
    # dwells there.
    power = np.mean(instrument[0] ** 2, axis=0)
    power = (np.bincount(fit.bins, power) / np.bincount(fit.bins))[fit.bins]
    inverse = np.linalg.pinv(np.einsum("art,brt->ab", instrument / power, fit.motion))
    # Change of stiffness by each realization. The residual has no part in the whole movement, so
    # its products with that, which are noise, are left out.
    change = (instrument - fit.motion) / power
    missing = np.einsum("a,art,rt->r", inverse[0], change, fit.residual)
    open_loop = fit.impedance[0].mean()
    closed = open_loop + missing.sum()
    what = (
        f"the mean stiffness is {open_loop:.3g} N·m/rad in open loop, {closed:.3g} with "
        f"{reference!r} as the reference, which predicts {_percent(explained)} of the angle; "
        f"identify by --method kbr:reference={reference},weighting=residual"
    )
    value = -100 * missing.sum() / abs(closed)
    return Measured(value, what, is_mean_significant(missing) and (declared or value < 0))


def _moved_angle(data: FittedEnsemble, reference: str) -> tuple[Array, float]:
    """Return the angle that a reference predicts, (realization, time), and its share of the angle.

    Realizations are predicted by what the others show.
    """
    ensemble, core, (early, late) = data.ensemble, data.ensemble.core, lag_samples(data.rate)
    groups = realization_groups(ensemble.trials, ensemble.onsets)
    command = np.pad(data.signal(reference), ((0, 0), (late, early)))
    moved = predicted(command, data.angle, core, data.rate, groups)
    left = np.sum((data.angle - moved)[:, core] ** 2)
    return moved, 1 - float(left / np.sum(data.angle[:, core] ** 2))


def _require_leading(data: FittedEnsemble, channel: str) -> None:
    """Raise NotApplicable for a channel that does not move the angle.

    EMG and further sensors of the angle follow it or hardly lead it. A sensor of the torque is the
    torque and noise, a command is the torque and a load.
    """
    values, reach = data.signal(channel), TORQUE_LAGS
    ends = reach, values.shape[1] - reach
    torques, angles = (
        lagged(each, range(-reach, reach + 1), *ends) for each in (data.torque, data.angle)
    )
    middle = values[:, slice(*ends)]
    if not gained_share(middle, angles, torques) > gained_share(middle, torques):
        raise NotApplicable(f"{channel!r} is the torque")
    leads = _predicted(data.angle, values, data.rate)
    if not leads > MIN_LEAD or _predicted(values, data.angle, data.rate) > MAX_FOLLOW:
        raise NotApplicable(f"{channel!r} does not move before the angle")


def _predicted(signal: Array, cause: Array, rate: float) -> float:
    """Return the share of a signal, unpredicted by its own past, that a cause's past predicts."""
    ahead = max(1, round(AHEAD_S * rate))
    own = ahead + np.arange(round(ANGLE_PAST_S * rate))
    lags = ahead + np.arange(0, round(CAUSE_PAST_S * rate), 2)
    start, stop = own[-1], signal.shape[1]
    if stop - start < lags[-1]:
        raise NotApplicable(TOO_SHORT)
    causes, past = lagged(cause, lags, start, stop), lagged(signal, own, start, stop)
    return gained_share(signal[:, start:], causes, past)


@check(
    "reflex",
    "A stretch reflex",
    "least share (95 % confidence) of the residual torque that velocity of one direction predicts "
    "40 to 330 ms later, beyond what both directions do alike",
    0.1,
    "%",
    effect="methods with one pathway include the torque of the stretch reflex in the stiffness: "
    "stiffness and inertia come out too high, viscosity too low, whatever the lags; no band shows "
    "it",
    remedy="separate the pathways: tv.JointCascade() (tvsysid identify … --method cascade)",
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
    one_path, two_paths = test.stiffness
    what = (
        f"{'positive' if test.direction > 0 else 'negative'} velocity predicts at least "
        f"{_percent(test.share)} of the residual torque {1000 * MIN_REFLEX_LAG_S:.0f} to "
        f"{1000 * MAX_REFLEX_LAG_S:.0f} ms later, better than no reflex (p = {test.over_none:.1g}) "
        f"and than a linear one (p = {test.over_linear:.1g}); the mean stiffness is {one_path:.3g} "
        f"N·m/rad with the reflex's torque in it, {two_paths:.3g} without"
    )
    if two_paths > 0:
        what += f": {100 * (one_path / two_paths - 1):+.0f} % in these data"
    return Measured(100 * max(0.0, test.share), what, test.shown)


@check(
    "slow-answer",
    "More than stiffness, viscosity and inertia",
    "share of the residual torque that movement 40 to 300 ms earlier predicts, where no reflex is "
    "found",
    10,
    "%",
    effect="a model of second order (birf, kbr) misses this part; impulse responses include it as "
    "far as their lags reach",
    remedy="use lags as long as the response (eirf:max_lag=0.4; sds:max_lag=0.4,window=0.4), also "
    "with --tune; look for a wrong sampling rate, a soft coupling, or a filter in one channel",
)
def slow_answer(data: FittedEnsemble) -> Measured:
    """Return the share of the residual torque that late velocities predict without a reflex."""
    data.require()
    if data.finding("reflex").found:
        raise NotApplicable("a reflex is found, whose answer is late; longer lags do not mend that")
    lags = np.round(np.arange(MIN_REFLEX_LAG_S, MAX_LAG_S, STEP_S) * data.rate).astype(np.int64)
    region = data.region
    start = max(region.start, lags[-1])
    if region.stop - start < 2 * HALF_WIDTH:
        raise NotApplicable(TOO_SHORT)
    causes = lagged(np.gradient(data.angle, axis=1), np.unique(lags), start, region.stop)
    residual = data.fit.residual[:, start - region.start :]
    gain = gains(residual, causes)
    share = gain.sum() / np.sum(residual**2)
    what = (
        f"the movement {1000 * MIN_REFLEX_LAG_S:.0f} to {1000 * MAX_LAG_S:.0f} ms before predicts "
        f"{_percent(share)} of the residual torque"
    )
    return Measured(100 * max(0.0, share), what, is_mean_significant(gain))


def _percent(share: float) -> str:
    return f"{max(0.0, 100 * share):.2g} %"
