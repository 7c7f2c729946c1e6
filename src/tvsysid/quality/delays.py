"""Check whether angle and torque are recorded at the same time."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.interpolation import SINC, between
from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check
from tvsysid.quality.fit import Regressors, SecondOrderFit
from tvsysid.quality.fitted import LOW_PASS_SAMPLES, MIN_EXPLAINED, NO_RESPONSE, FittedEnsemble
from tvsysid.quality.statistics import SIGNIFICANT, p_value, p_value_of
from tvsysid.signals import Array

MAX_DELAY_S = 0.1
FINE_SHIFTS = np.linspace(-1, 1, 9)  # samples beside the best whole one
STEPS, MAX_STEP_SAMPLES = 3, 1.5  # of Gauss-Newton
PARTS = 10  # of a realization, over which a delay must not scatter more than over realizations
# Ratio of what fits leave without and with the best shift: above the first, the steps start at that
# shift, which is too far away for them; above the second, the delay is clear.
FAR, CLEAR = 1.05, 1.3
MAX_LAST_STEP = 0.015  # share of a delay; what noise or a misfit looks like does not settle
MAX_INERTIA_RATIO = 1.25  # of fits with and without low-pass: noise in the angle hides inertia
LARGE_DELAY_MS = 15.0  # no noise in the angle looks like one
MIN_LOOP_SHARE = 0.3  # % of the torque that later movement predicts in a loop, after a shift


@check(
    "delay",
    "Angle and torque are not recorded at the same time",
    "delay of the torque",
    0.75,
    "ms",
    effect="a torque that is late by d lowers the inertia by viscosity times d (a tenth of it for "
    "1 ms at the ankle) and the viscosity by stiffness times d, and distorts the rest; an early "
    "one raises both",
    remedy="find what delays a channel (a filter, a clock, a closed loop); correct it with "
    "tv.preprocess.align_channels(recording, delay), as tvsysid identify does unless it predicts "
    "worse",
)
def delay(data: FittedEnsemble) -> Measured:
    r"""Return the delay of the torque with which a second-order joint leaves least of it.

    A delay by d adds the jerk to the regressors: :math:`y(t - d) \approx k\theta + (b - k
    d)\dot\theta + (I - b d + k d^2/2)\ddot\theta - I d\,\dddot\theta`. No stiffness, viscosity or
    inertia explains that, so the delay is known to some tenths of a millisecond even at 100 Hz.
    A joint that is not of second order, or a torque that moves the angle, has such a part too. So
    the delay must also show where other frequencies count more, without whitening. An early torque
    in a closed loop is not judged.
    """
    shift, best = _best_shift(data)
    gain = data.fit.unexplained / best.unexplained if best.unexplained > 0 else math.inf
    samples = shift if gain > FAR else 0.0
    for _ in range(STEPS):
        step = _remaining_delay(data.advance(samples))[0]
        samples += np.clip(step, -MAX_STEP_SAMPLES, MAX_STEP_SAMPLES)
    aligned = data.advance(samples)
    value = 1000 * samples / data.rate
    step, error, change = (1000 * each / data.rate for each in _remaining_delay(aligned))
    significant = p_value(value, error, len(data)) < SIGNIFICANT
    significant &= abs(value) > max(abs(change), abs(step) / MAX_LAST_STEP)
    if significant and (reason := _other_cause(data, aligned, value, gain >= CLEAR)):
        raise NotApplicable(reason)
    edge = "at least " if abs(round(samples)) >= _reach(data) else ""
    side = "late" if value > 0 else "early"
    what = f"the torque is {edge}{abs(value):.3g} ± {error:.1g} ms {side}"
    if abs(change) > max(error, FAULTS["delay"].limit):
        what += f" ({value + change:+.2g} ms where lower frequencies count more)"
    changes = []
    for name, unit, place in (("inertia", "kg·m²", 2), ("viscosity", "N·m·s/rad", 1)):
        old, new = (each.mean_impedance[0][place] for each in (data, aligned))
        changes.append(f"{name} {old:.3g} instead of {new:.3g} {unit}")
    return Measured(value, f"{what}; that makes {' and '.join(changes)}", significant)


def _remaining_delay(data: FittedEnsemble) -> tuple[float, float, float]:
    """Return the remaining delay in samples, its standard error, and its change without whitening.

    The misfit of a model is alike in all realizations and differs from time to time. So the error
    is that over realizations or that over parts of the realization, whichever is larger.
    """
    fit = data.fit
    torque = fit.parts.sum(axis=0)
    jerk = between(torque, -0.5) - between(torque, 0.5)
    products = []
    for through in (data.whitened, np.asarray):
        parts, *targets = (
            gaussian_filter1d(through(each), LOW_PASS_SAMPLES, axis=-1)
            for each in (fit.parts, jerk, fit.residual)
        )
        regressors = Regressors(parts, data.rate)
        alone, left = (regressors.fit(each).residual[:, SINC:-SINC] for each in targets)
        if np.sum(alone**2) <= 0:
            raise NotApplicable(NO_RESPONSE)
        products.append((left * alone, alone**2))
    (whitened, weights), (plain, plain_weights) = products
    step = float(whitened.sum() / weights.sum())
    scores = whitened - step * weights
    by_part = np.array([each.sum() for each in np.array_split(scores, PARTS, axis=1)])
    variances = [
        np.sum(each**2) * len(each) / (len(each) - 1) for each in (scores.sum(axis=1), by_part)
    ]
    error = math.sqrt(max(variances)) / weights.sum()
    return step, error, float(plain.sum() / plain_weights.sum()) - step


def _other_cause(
    data: FittedEnsemble, aligned: FittedEnsemble, value: float, is_clear: bool
) -> str:
    """Describe what else in these data looks like a delay in ms, or return an empty text."""
    inertia, smooth = (
        values[2] for values, _ in (aligned.mean_impedance, aligned.smooth_impedance)
    )
    is_noise = not inertia / MAX_INERTIA_RATIO < smooth < MAX_INERTIA_RATIO * inertia
    if is_noise and (abs(value) < LARGE_DELAY_MS or not is_clear):
        return (
            "noise in the angle (coarse steps, spikes), or a torque smoothed alone, looks like a "
            "delay"
        )
    # A loop shows in what is shifted, too; or as it is, where a shift hardly helps.
    is_loop = value < -FAULTS["delay"].limit and (
        aligned.finding("feedback").value > MIN_LOOP_SHARE
        or (not is_clear and data.finding("feedback").beyond)
    )
    return "torque noise moves the angle, which looks like an early torque" if is_loop else ""


@check(
    "clock-skew",
    "The channels' clocks run apart",
    "delay of the torque in the second half of the experiment, minus that in the first",
    8,
    "ms",
    effect="the delay grows, so the viscosity is wrong by another amount at each time of the "
    "experiment, and the rest is distorted",
    remedy="record both channels by one clock, or stretch one of them before cutting",
)
def clock_skew(data: FittedEnsemble) -> Measured:
    """Compare the best shift of the second half of the experiment with that of the first.

    The test is by what each half leaves with the other's shift.
    """
    data.require(2 * MIN_TESTED_REALIZATIONS, response=False)
    shifts, fits = zip(*map(_best_shift, data.halves), strict=True)
    worse = []
    for half, other, own in zip(data.halves, reversed(shifts), fits, strict=True):
        swapped = half.regressors.fit(_later(half, other))
        worse.append(np.sum(swapped.residual**2, axis=1) - np.sum(own.residual**2, axis=1))
    skew = 1000 * shifts[1] / data.rate - 1000 * shifts[0] / data.rate
    what = (
        f"the torque is {skew:.3g} ms late in the second half of the experiment against the first"
    )
    return Measured(skew, what, p_value_of(np.concatenate(worse)) < SIGNIFICANT)


def _reach(data: FittedEnsemble) -> int:
    """Return the longest delay in samples that the context allows."""
    reach = min(round(MAX_DELAY_S * data.rate), data.ensemble.context)
    if reach < 2:
        raise NotApplicable("the realizations have no context to shift them by")
    return reach


def _later(data: FittedEnsemble, samples: float) -> Array:
    """Return the torque so many samples later, where it is fitted."""
    whole, last = round(samples), data.torque.shape[1] - 1
    fitted = np.arange(data.region.start, data.region.stop)
    return between(data.torque, samples - whole)[:, np.clip(fitted + whole, 0, last)]


def _best_shift(data: FittedEnsemble) -> tuple[float, SecondOrderFit]:
    """Return the shift of the torque in samples that leaves least of it, and its fit."""
    reach = _reach(data)

    def best(shifts: Array) -> tuple[float, SecondOrderFit]:
        fits = ((shift, data.regressors.fit(_later(data, shift))) for shift in shifts)
        return min(fits, key=lambda pair: pair[1].unexplained)

    whole, _ = best(np.arange(-reach, reach + 1.0))
    shift, fit = best(np.clip(whole + FINE_SHIFTS, -reach, reach))
    if 1 - fit.unexplained < MIN_EXPLAINED:
        raise NotApplicable(NO_RESPONSE)
    return shift, fit
