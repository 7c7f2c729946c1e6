"""Whether amount of data, perturbation, channels, units, sign and rate can be right."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tvsysid.numerics.spectra import PowerSpectrum
from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.fitted import (
    ANSWERED,
    NO_ANSWER,
    NOT_SEPARATE,
    FittedEnsemble,
    NotJudged,
    Seen,
)
from tvsysid.quality.statistics import angle_inflation, still_samples
from tvsysid.signals import Array

QUARTER = 0.25  # of the sampling rate: above it a joint hardly moves, but a sensor's noise goes on
# Variance inflation of stiffness by velocity and acceleration: above it, stiffness is unknown.
MAX_INFLATION = 15.0
MAX_RINGING = 0.01  # share of the samples above that inflation
UNKNOWN = 9.99  # relative error from which on more digits tell nothing
SURE = 5.0  # standard errors from which on a value's sign is sure
LOWEST, HIGHEST = 1.0, 40.0  # natural frequencies of joints in Hz
LARGEST_INERTIA = 1.0  # in kg·m²: more than an arm or a lower leg has


def few_realizations(data: FittedEnsemble) -> Seen:
    """Count them."""
    return Seen(len(data), f"there are {len(data)} realizations")


def weak_answer(data: FittedEnsemble) -> Seen:
    """Share of the torque that a joint of second order explains."""
    share = 100 * data.explained
    return Seen(
        share, f"stiffness, viscosity and inertia explain {share:.1f} % of the torque's variance"
    )


def narrow_excitation(data: FittedEnsemble) -> Seen:
    """Measure how well the data determine a mean stiffness and inertia at best.

    The measure is the scatter over realizations.
    """
    data.require()
    if not np.isfinite(data.mean_impedance[0]).all():
        return Seen(100 * UNKNOWN, NOT_SEPARATE)
    with np.errstate(divide="ignore", invalid="ignore"):
        fits = [
            (
                np.nan_to_num(np.abs(errors / values), nan=np.inf)[[0, 2]],
                values[[0, 2]],
                errors[[0, 2]],
            )
            for values, errors in (data.mean_impedance, data.white_impedance)
        ]
    relative, values, errors = min(fits, key=lambda fit: float(fit[0].max()))
    worst = int(np.argmax(relative))
    value = 100 * min(float(relative[worst]), UNKNOWN)
    name, unit = (("stiffness", "N·m/rad"), ("inertia", "kg·m²"))[worst]
    what = (
        f"the data give a mean {name} of {values[worst]:.3g} ± {errors[worst]:.2g} {unit}, ± "
        f"{value:.2g} %"
    )
    return Seen(value, what)


def unmoved_times(data: FittedEnsemble) -> Iterator[str]:
    """Yield when the movement does not determine the stiffness: the angle is still, or it rings."""
    still = still_samples(data.core("angle"))
    if len(still):
        yield (
            f"the angle is still in all realizations at {len(still)} of {data.ensemble.samples} "
            f"samples, the first at {still[0] / data.rate:.3g} s: no stiffness is identifiable "
            "there"
        )
    ringing = float(np.mean(angle_inflation(data.angle, data.rate) > MAX_INFLATION))
    if ringing > MAX_RINGING:
        yield (
            f"at {100 * ringing:.0f} % of the samples the angle moves like a free oscillation: "
            "stiffness there comes from other times or from noise, and no band counts that; "
            "perturb without rests and at more frequencies, or take the joint as constant (pc)"
        )


def same_perturbation(data: FittedEnsemble) -> Seen:
    """Whether all realizations were moved alike.

    Only sensor noise differs then, and no torque answers it.
    """
    white = (
        100
        * PowerSpectrum.of(data.core("angle"), data.rate).shares((QUARTER * data.rate, np.inf))[0]
    )
    above = f"above {QUARTER * data.rate:g} Hz"
    told = [
        (
            white,
            f"{white:.0f} % of the variance by which the angle differs between realizations lies "
            f"{above}",
        )
    ]
    if not data.ensemble.mean_subtracted:
        angle = data.ensemble.angle[:, data.ensemble.core]
        varying = angle - angle.mean()
        common = float(np.mean(varying.mean(axis=0) ** 2) / np.mean(varying**2))
        common = 100 * max(0.0, common - 1 / len(angle))
        told.append(
            (common, f"{common:.0f} % of the angle's variance is common to all realizations")
        )
    value, what = max(told)
    if data.explained >= ANSWERED:
        return Seen(0.0, f"{what}, but the torque answers what differs")
    return Seen(value, f"{what}, and {NO_ANSWER} where realizations differ")


def same_channel(data: FittedEnsemble) -> Seen:
    """Correlation of angle and torque.

    Noise, viscosity and inertia keep that of a joint from being all of it.
    """
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
        raise NotJudged(NOT_SEPARATE)
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
    return Seen(
        stiffness, f"the mean stiffness is {values[0]:.4g} N·m/rad", stiffness > SURE * errors[0]
    )


def sampling_rate(data: FittedEnsemble) -> Seen:
    """Natural frequency and inertia.

    A wrong rate leaves the damping ratio and the stiffness as they are.
    """
    _impedance(data)
    # Noise in the angle, as coarse steps leave it, would hide the inertia; a wrong rate is the same
    # behind a low-pass.
    values, errors = data.smooth_impedance
    stiffness, _, inertia = map(float, values)
    if (
        abs(stiffness) < SURE * errors[0]
        or abs(inertia) < SURE * errors[2]
        or stiffness * inertia < 0
    ):
        raise NotJudged("stiffness and inertia are not determined well enough")
    frequency = math.sqrt(stiffness / inertia) / (2 * math.pi)
    octaves = math.log2(frequency / math.sqrt(LOWEST * HIGHEST))
    if abs(inertia) > LARGEST_INERTIA and not FAULTS["torque-unit"].beyond(stiffness):
        # No frequency is too low for a heavy limb, but none at a joint is so heavy.
        octaves = min(
            octaves,
            math.log2(LOWEST / math.sqrt(LOWEST * HIGHEST) * LARGEST_INERTIA / abs(inertia)),
        )
    what = (
        f"the natural frequency comes out at {frequency:.3g} Hz, with an inertia of "
        f"{abs(inertia):.2g} kg·m²"
    )
    return Seen(abs(octaves), what)
