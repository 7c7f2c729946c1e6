"""Signs, units and rates that give an impedance no joint has, and channels that are not of one time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tvsysid.quality.amount import narrow_excitation
from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.finding import NotJudged, Seen
from tvsysid.quality.fit import fit_motion
from tvsysid.quality.fitted import ANSWERED, NO_ANSWER, FittedEnsemble, left_by
from tvsysid.quality.resampling import between
from tvsysid.quality.statistics import LEAST_REALIZATIONS, SIGNIFICANT, p_value_of
from tvsysid.signals import Array

SURE = 5.0
"""Standard errors from which on a value's sign is sure."""
LOWEST, HIGHEST = 1.0, 40.0
"""Natural frequencies of joints in Hz."""
LARGEST_INERTIA = 1.0
"""In kg·m²: more than an arm or a lower leg has."""
LONGEST_DELAY = 0.1
"""In s, to either side."""
CLEARER, CLEARER_LATE = 1.3, 1.05
"""Times as much as with the best shift that a joint must leave unexplained without it; so if only a delay does that."""
FINER = np.linspace(-1, 1, 9)
"""Samples beside the best shift that are tried."""


def same_channel(data: FittedEnsemble) -> Seen:
    """Correlation of angle and torque; noise, viscosity and inertia keep that of a joint from being all of it."""
    angle, torque = data.angle, data.torque
    size = math.sqrt(float(np.sum(angle**2)) * float(np.sum(torque**2)))
    if size == 0:
        raise NotJudged("a channel does not move")
    value = 100 * abs(float(np.sum(angle * torque))) / size
    return Seen(value, f"the correlation of angle and torque is {value:.4g} %")


def _impedance(data: FittedEnsemble) -> tuple[Array, Array]:
    """Mean impedance and its standard errors, where they can be told."""
    data.require()
    values, errors = data.mean_impedance
    if not np.isfinite(values).all():
        raise NotJudged("stiffness, viscosity and inertia are not separately identifiable")
    return values, errors


def reversed_torque(data: FittedEnsemble) -> Seen:
    """Sign of the mean stiffness."""
    values, errors = _impedance(data)
    what = f"the mean stiffness is {values[0]:.3g} ± {errors[0]:.2g} N·m/rad"
    return Seen(values[0], what, values[0] < -SURE * errors[0])


def angle_unit(data: FittedEnsemble) -> Seen:
    """Size of the movement."""
    size = float(np.sqrt(np.mean(data.core("angle") ** 2)))
    return Seen(size, f"the angle has an RMS of {size:.3g} rad about its mean over realizations")


def torque_unit(data: FittedEnsemble) -> Seen:
    """Size of the stiffness."""
    values, errors = _impedance(data)
    stiffness = abs(float(values[0]))
    return Seen(stiffness, f"the mean stiffness is {values[0]:.4g} N·m/rad", stiffness > SURE * errors[0])


def sampling_rate(data: FittedEnsemble) -> Seen:
    """Natural frequency and inertia; a wrong rate leaves the damping ratio and the stiffness as they are."""
    values, errors = _impedance(data)
    stiffness, _, inertia = map(float, values)
    if abs(stiffness) < SURE * errors[0] or abs(inertia) < SURE * errors[2] or stiffness * inertia < 0:
        raise NotJudged("stiffness and inertia are not determined well enough")
    frequency = math.sqrt(stiffness / inertia) / (2 * math.pi)
    octaves = math.log2(frequency / math.sqrt(LOWEST * HIGHEST))
    if abs(inertia) > LARGEST_INERTIA and not FAULTS["torque-unit"].beyond(stiffness):
        # No frequency is too low for a heavy limb, but none at a joint is so heavy.
        octaves = min(octaves, math.log2(LOWEST / math.sqrt(LOWEST * HIGHEST) * LARGEST_INERTIA / abs(inertia)))
    what = f"the natural frequency comes out at {frequency:.3g} Hz, with an inertia of {abs(inertia):.2g} kg·m²"
    return Seen(abs(octaves), what)


def delay(data: FittedEnsemble) -> Seen:
    """Shift of the torque with which a joint of second order explains most of it.

    It is significant whenever it is sure, even if it does no harm: what it leaves would be taken for something else.
    """
    reach = _reach(data)
    best = _best_shift(data, reach)
    if 1 - best.left < ANSWERED:
        raise NotJudged(NO_ANSWER)
    given = _shifted(data, 0.0)
    # An angle that torque noise moves is the later of the two, but hardly fits better then than with no shift; and a
    # perturbation of few frequencies hardly tells a delay from a viscosity.
    sure = best.samples > 0 and not FAULTS["narrow-excitation"].beyond(_narrowness(data.synchronised(best.samples)))
    clearer = given.left > (CLEARER_LATE if sure else CLEARER) * best.left
    significant = clearer and p_value_of(given.squares - best.squares) < SIGNIFICANT
    late = 1000 * best.samples / data.rate
    edge = "at least " if abs(round(best.samples)) == reach else ""
    what = f"the torque fits best if it is {edge}{abs(late):.3g} ms {'late' if late > 0 else 'early'}"
    what += f": {100 * (1 - best.left):.1f} % of it explained rather than {100 * (1 - given.left):.1f} %"
    return Seen(late, what, significant)


def _narrowness(data: FittedEnsemble) -> float:
    try:
        return narrow_excitation(data).value
    except NotJudged:
        return math.nan


def clock_skew(data: FittedEnsemble) -> Seen:
    """Best shift of the second half of the experiment against that of the first."""
    data.require(2 * LEAST_REALIZATIONS, answer=False)
    reach = _reach(data)
    first, second = data.halves
    early, late = _best_shift(first, reach), _best_shift(second, reach)
    if 1 - max(early.left, late.left) < ANSWERED:
        raise NotJudged(NO_ANSWER)
    # What each half leaves with the other's shift, against what it leaves with its own.
    pairs = ((first, late.samples, early), (second, early.samples, late))
    worse = [_shifted(half, others).squares - own.squares for half, others, own in pairs]
    skew = 1000 * late.samples / data.rate - 1000 * early.samples / data.rate
    what = f"the torque is {skew:+.3g} ms late in the second half of the experiment against the first"
    return Seen(skew, what, p_value_of(np.concatenate(worse)) < SIGNIFICANT)


def _reach(data: FittedEnsemble) -> int:
    """Samples that are tried as a delay, to either side."""
    reach = min(round(LONGEST_DELAY * data.rate), data.ensemble.context)
    if reach < 2:
        raise NotJudged("the realizations have no context to shift them by")
    return reach


class _Shift(NamedTuple):
    """Shift of the torque in samples, what a fit leaves of each realization with it, and of the torque's variance."""

    samples: float
    squares: Array
    left: float


def _shifted(data: FittedEnsemble, samples: float) -> _Shift:
    """Fit again with the torque taken so many samples later."""
    first, whole = data.fit.first, round(samples)
    torque = between(data.torque, samples - whole)
    late = np.clip(np.arange(first, first + data.fit.torque.shape[1]) + whole, 0, torque.shape[1] - 1)
    fit = fit_motion(data.fit.motion, torque[:, late], data.rate, first)
    residual = fit.torque - fit.parts.sum(axis=0)
    return _Shift(samples, np.sum(residual**2, axis=1), left_by(fit, residual))


def _best_shift(data: FittedEnsemble, reach: int) -> _Shift:
    def best_of(shifts: Array) -> _Shift:
        return min((_shifted(data, float(shift)) for shift in shifts), key=lambda shift: shift.left)

    best = best_of(np.arange(-reach, reach + 1).astype(np.float64))
    return best_of(np.clip(best.samples + FINER, -reach, reach))
