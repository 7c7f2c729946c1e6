"""Signs, units and rates that give an impedance no joint has, and channels that are not of one time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.quality.evidence import CHANCE, LEAST_REALIZATIONS, Evidence, chance, left_by, refitted
from tvsysid.quality.excitation import ANSWERED, NO_ANSWER, narrow_excitation
from tvsysid.quality.finding import Finding, judged, unjudged

Array = NDArray[np.float64]

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


def same_channel(evidence: Evidence) -> Finding:
    """Correlation of angle and torque; noise, viscosity and inertia keep that of a joint from being all of it."""
    angle, torque = evidence.angle, evidence.torque
    size = math.sqrt(float(np.sum(angle**2)) * float(np.sum(torque**2)))
    if size == 0:
        return unjudged("same-channel", "a channel does not move")
    value = 100 * abs(float(np.sum(angle * torque))) / size
    return judged("same-channel", value, f"the correlation of angle and torque is {value:.4g} %")


def reversed_torque(evidence: Evidence) -> Finding:
    """Sign of the mean stiffness."""
    if evidence.explained < ANSWERED:
        return unjudged("reversed-torque", NO_ANSWER)
    values, errors = evidence.mean_impedance
    return judged(
        "reversed-torque",
        float(values[0]),
        f"the mean stiffness is {values[0]:.3g} ± {errors[0]:.2g} N·m/rad",
        significant=bool(values[0] < -SURE * errors[0]),
    )


def angle_unit(evidence: Evidence) -> Finding:
    """Size of the movement."""
    size = float(np.sqrt(np.mean(evidence.angle[:, evidence.ensemble.core] ** 2)))
    return judged("angle-unit", size, f"the angle has an RMS of {size:.3g} rad about its mean over realizations")


def torque_unit(evidence: Evidence) -> Finding:
    """Size of the stiffness."""
    if evidence.explained < ANSWERED:
        return unjudged("torque-unit", NO_ANSWER)
    values, errors = evidence.mean_impedance
    stiffness = abs(float(values[0]))
    return judged(
        "torque-unit",
        stiffness,
        f"the mean stiffness is {values[0]:.4g} N·m/rad",
        significant=bool(stiffness > SURE * errors[0]),
    )


def sampling_rate(evidence: Evidence) -> Finding:
    """Natural frequency and inertia; a wrong rate leaves the damping ratio and the stiffness as they are."""
    name = "sampling-rate"
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER)
    values, errors = evidence.mean_impedance
    stiffness, _, inertia = map(float, values)
    if abs(stiffness) < SURE * errors[0] or abs(inertia) < SURE * errors[2] or stiffness * inertia < 0:
        return unjudged(name, "stiffness and inertia are not determined well enough")
    frequency = math.sqrt(stiffness / inertia) / (2 * math.pi)
    octaves = math.log2(frequency / math.sqrt(LOWEST * HIGHEST))
    if abs(inertia) > LARGEST_INERTIA and abs(stiffness) < torque_unit(evidence).fault.limit:
        # No frequency is too low for a heavy limb, but none at a joint is so heavy.
        octaves = min(octaves, math.log2(LOWEST / math.sqrt(LOWEST * HIGHEST) * LARGEST_INERTIA / abs(inertia)))
    return judged(
        name,
        abs(octaves),
        f"the natural frequency comes out at {frequency:.3g} Hz, with an inertia of {abs(inertia):.2g} kg·m²",
    )


def delay(evidence: Evidence) -> tuple[Finding, float]:
    """Shift of the torque with which a joint of second order explains most of it, and that in samples.

    The shift is told whenever it is sure, even if it does no harm: what it leaves would be taken for something else.
    """
    name = "delay"
    reach = min(round(LONGEST_DELAY * evidence.rate), evidence.ensemble.context)
    if reach < 2:
        return unjudged(name, "the realizations have no context to shift them by"), 0.0
    best = _best_shift(evidence, reach)
    if 1 - best.left < ANSWERED:
        return unjudged(name, NO_ANSWER), 0.0
    squares, left = (each[0] for each in _left(evidence, np.zeros(1)))
    # An angle that gives way to the torque is the later of the two, but hardly fits better then than with no shift; and
    # a perturbation of few frequencies hardly tells a delay from a viscosity.
    sure = best.samples > 0 and not narrow_excitation(evidence.synchronised(best.samples)).beyond
    clearer = left > (CLEARER_LATE if sure else CLEARER) * best.left
    certain = bool(clearer) and chance(squares - best.squares) < CHANCE
    late = 1000 * best.samples / evidence.rate
    edge = "at least " if abs(round(best.samples)) == reach else ""
    what = f"the torque fits best if it is {edge}{abs(late):.3g} ms {'late' if late > 0 else 'early'}"
    what += f": {100 * (1 - best.left):.1f} % of it explained rather than {100 * (1 - left):.1f} %"
    return judged(name, late, what, significant=certain), best.samples if certain else 0.0


def clock_skew(evidence: Evidence) -> Finding:
    """Best shift of the second half of the experiment against that of the first."""
    name = "clock-skew"
    if len(evidence.ensemble) < 2 * LEAST_REALIZATIONS:
        return unjudged(name, f"it takes {2 * LEAST_REALIZATIONS} realizations")
    reach = min(round(LONGEST_DELAY * evidence.rate), evidence.ensemble.context)
    if reach < 2:
        return unjudged(name, "the realizations have no context to shift them by")
    halves = evidence.halves
    found = [_best_shift(half, reach) for half in halves]
    if 1 - max(shift.left for shift in found) < ANSWERED:
        return unjudged(name, NO_ANSWER)
    # What each half leaves with the other's shift, against what it leaves with its own.
    worse = [_left(half, np.array([other.samples]))[0][0] for half, other in zip(halves, found[::-1], strict=True)]
    gains = np.concatenate([squares - own.squares for squares, own in zip(worse, found, strict=True)])
    first, second = (1000 * shift.samples / evidence.rate for shift in found)
    what = f"the torque is {second - first:+.3g} ms late in the second half of the experiment against the first"
    return judged(name, second - first, what, significant=chance(gains) < CHANCE)


class _Shift(NamedTuple):
    """Best shift of the torque in samples, what it leaves of each realization, and of the torque's variance."""

    samples: float
    squares: Array
    left: float


def _best_shift(evidence: Evidence, reach: int) -> _Shift:
    shifts = np.arange(-reach, reach + 1).astype(np.float64)
    best = shifts[int(np.argmin(_left(evidence, shifts)[1]))]
    finer = np.clip(best + FINER, -reach, reach)
    squares, left = _left(evidence, finer)
    least = int(np.argmin(left))
    return _Shift(float(finer[least]), squares[least], float(left[least]))


def _left(evidence: Evidence, shifts: Array) -> tuple[list[Array], Array]:
    """Sum of squares that a fit leaves of each realization, and its share of the torque's variance, for each shift."""
    squares, shares = [], []
    for shift in shifts:
        fit = refitted(evidence, float(shift))
        residual = fit.torque - fit.parts.sum(axis=0)
        squares.append(np.sum(residual**2, axis=1))
        shares.append(left_by(fit, residual))
    return squares, np.array(shares)
