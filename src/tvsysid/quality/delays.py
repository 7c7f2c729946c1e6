"""Check whether angle and torque are recorded at the same time."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.methods.cascade.cascade import reflex_torque
from tvsysid.numerics.interpolation import SINC, advanced, between
from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check
from tvsysid.quality.fit import (
    MIN_EXPLAINED,
    NO_RESPONSE,
    FittedEnsemble,
    SecondOrderFit,
    low_passed,
)
from tvsysid.quality.statistics import is_significant
from tvsysid.signals import Array

MAX_DELAY_S = 0.1
FINE_SHIFTS = np.linspace(-1, 1, 9)  # samples beside the best whole one
STEPS = 3  # of Gauss-Newton
PARTS = 10  # of a realization, from whose scatter the error of a delay is estimated, too
MAX_LAST_STEP = 0.015  # share of a delay; a misfit that looks like a delay leaves more
MIN_LOOP_SHARE = 0.3  # % of the shifted torque that later movement predicts in a closed loop
MAX_INERTIA_RATIO = 1.25  # of fits with and without low-pass: noise in the angle hides inertia


@check(
    "delay",
    "Angle and torque are not recorded at the same time",
    "delay of the torque",
    0.75,
    "ms",
    "doubtful",
    effect="a torque that is late by d lowers the inertia by viscosity times d (at the ankle a "
    "tenth of the inertia for 1 ms) and the viscosity by stiffness times d, and distorts the rest; "
    "an early one raises both",
    remedy="find what delays a channel (a filter, a clock, a closed loop); correct it with "
    "tv.preprocess.align_channels(recording, delay); tvsysid identify corrects all of it, or half "
    "or none of it if that predicts better",
)
def delay(data: FittedEnsemble) -> Measured:
    r"""Return the delay of the torque at which a second-order joint explains most of it.

    A delay by d adds the jerk to the regressors: :math:`y(t - d) \approx k\theta + (b - k
    d)\dot\theta + (I - b d + k d^2/2)\ddot\theta - I d\,\dddot\theta`. No stiffness, viscosity or
    inertia explains that, so the delay is known to some tenths of a millisecond even at 100 Hz.
    A joint that is not of second order, or a torque that moves the angle, has such a part too. So
    the delay must also show where other frequencies count more, without whitening. An early torque
    in a closed loop is not judged. Where there is a reflex, whose torque is late, a delay must show
    without it.
    """
    samples = _delay_in_samples(data)
    aligned = _shifted(data, samples)
    value = 1000 * samples / data.rate
    step, error, change = 1000 / data.rate * _remaining_delay(aligned)
    significant = is_significant(value, error, len(data))
    significant &= abs(value) > max(abs(change), abs(step) / MAX_LAST_STEP)
    old, new = (each.mean_impedance[0] for each in (data.fit, aligned))
    if significant:
        if data.finding("reflex").found:
            torque = data.ensemble.torque - reflex_torque(data.ensemble)
            others = _delay_in_samples(data.changed(torque=torque))
            if not FAULTS["delay"].beyond(1000 * others / data.rate):
                raise NotApplicable("the torque of the reflex is late; without it, no delay shows")
        ratio = aligned.smooth_impedance[0][2] / new[2]
        if not 1 / MAX_INERTIA_RATIO < ratio < MAX_INERTIA_RATIO:
            raise NotApplicable(
                "noise in the angle (coarse steps, spikes), or a torque smoothed alone, looks like "
                "a delay"
            )
        is_early = value < -FAULTS["delay"].limit
        if is_early and data.advance(samples).finding("feedback").value > MIN_LOOP_SHARE:
            raise NotApplicable("torque noise moves the angle, which looks like an early torque")
    what = (
        f"the torque is {abs(value):.3g} ± {error:.1g} ms {'late' if value > 0 else 'early'}; "
        f"without this delay, inertia is {new[2]:.3g} kg·m² and not {old[2]:.3g}, and viscosity "
        f"{new[1]:.3g} N·m·s/rad and not {old[1]:.3g}"
    )
    return Measured(value, what, significant)


def _remaining_delay(fit: SecondOrderFit) -> Array:
    """Return the remaining delay in samples, its standard error, and its change without whitening.

    The misfit of a model is alike in all realizations and differs from time to time. So the error
    is that over realizations or that over parts of the realization, whichever is larger.
    """
    torque = fit.parts.sum(axis=0)
    signals = (fit.parts, between(torque, -0.5) - between(torque, 0.5), fit.residual)
    delays = []
    for through in (np.asarray, fit.whitened):
        parts, *targets = (low_passed(through(each)) for each in signals)
        alone, left = (SecondOrderFit(parts, each).residual[:, SINC:-SINC] for each in targets)
        power = np.sum(alone**2)
        delays.append(float(np.sum(left * alone) / power))
    scores = (left - delays[1] * alone) * alone / power
    by_part = np.array([each.sum() for each in np.array_split(scores, PARTS, axis=1)])
    error = max(math.sqrt(len(each)) * each.std(ddof=1) for each in (scores.sum(axis=1), by_part))
    return np.array([delays[1], error, delays[0] - delays[1]])


def _shifted(data: FittedEnsemble, samples: float) -> SecondOrderFit:
    """Return the fit to the torque so many samples later."""
    torque = advanced(data.torque, samples)[:, data.region]
    return SecondOrderFit(data.fit.motion, torque)


def _delay_in_samples(data: FittedEnsemble) -> float:
    """Return the delay at which the fit explains most of the torque, at most the context."""
    reach = min(round(MAX_DELAY_S * data.rate), data.ensemble.context)
    if reach < 2:
        raise NotApplicable("the realizations have no context to shift them by")

    def explained(shift: float) -> float:
        return _shifted(data, shift).explained

    whole = max(np.arange(-reach, reach + 1.0), key=explained)
    shift = max(np.clip(whole + FINE_SHIFTS, -reach, reach), key=explained)
    if explained(shift) < MIN_EXPLAINED:
        raise NotApplicable(NO_RESPONSE)
    for _ in range(STEPS):
        shift += _remaining_delay(_shifted(data, shift))[0]
    return float(shift)
