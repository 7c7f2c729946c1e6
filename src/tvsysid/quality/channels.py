"""Check whether channels, signs, units and sampling rate can be right."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check
from tvsysid.quality.fit import FittedEnsemble
from tvsysid.quality.statistics import TINY
from tvsysid.recordings.read import MAX_ANGLE_RMS_RAD
from tvsysid.signals import Array

SIGNIFICANT_ERRORS = 5.0  # standard errors from which on a value's sign is sure
MIDDLE_FREQUENCY_HZ, MIN_FREQUENCY_HZ = math.sqrt(40), 1.0  # natural frequencies of joints
MAX_INERTIA = 1.0  # kg·m², more than that of an arm or a lower leg


@check(
    "same-channel",
    "Angle and torque are one signal",
    "correlation of angle and torque, without its sign",
    99.99,
    "%",
    "invalid",
    effect="the result is the ratio of two copies of one signal, not an impedance",
    remedy="check which channels --angle and --torque name",
)
def same_channel(data: FittedEnsemble) -> Measured:
    """Return the correlation of angle and torque.

    Noise, viscosity and inertia keep that of a joint below 100 %.
    """
    size = np.linalg.norm(data.angle) * np.linalg.norm(data.torque)
    value = 100 * abs(np.sum(data.angle * data.torque)) / max(size, TINY)
    return Measured(value, f"the correlation of angle and torque is {value:.4g} %")


def _impedance(data: FittedEnsemble) -> tuple[Array, Array]:
    """Return mean impedance and its standard errors, where they are identifiable."""
    data.require(0)
    values, errors = data.fit.mean_impedance
    if not np.isfinite(values).all():
        raise NotApplicable("stiffness, viscosity and inertia are not separately identifiable")
    return values, errors


@check(
    "torque-unit",
    "Stiffer or softer than any joint",
    "mean stiffness, without its sign",
    1500,
    "N·m/rad",
    "invalid",
    effect="stiffness, viscosity and inertia are wrong by the same factor",
    remedy="exchange the channels if they are swapped (--angle, --torque); add --torque-unit Nmm "
    "or --angle-unit deg if the file has this unit, and remove the option if not",
    lowest=0.2,
)
def torque_unit(data: FittedEnsemble) -> Measured:
    """Return the size of the mean stiffness."""
    (value, *_), (error, *_) = _impedance(data)
    size = abs(value)
    return Measured(
        size, f"the mean stiffness is {value:.4g} N·m/rad", size > SIGNIFICANT_ERRORS * error
    )


@check(
    "angle-unit",
    "The angle is too large for radians",
    "RMS of the angle about its mean over realizations",
    MAX_ANGLE_RMS_RAD,
    "rad",
    "invalid",
    effect="degrees read as radians make stiffness, viscosity and inertia 57 times too small; if "
    "they are radians, no joint is linear over such a wide movement",
    remedy="if the file is in degrees, read it with angle_unit='deg' (--angle-unit deg); if this "
    "is the torque, name the channels the other way round",
)
def angle_unit(data: FittedEnsemble) -> Measured:
    """Return the size of the movement."""
    size = data.core("angle").std()
    return Measured(
        size, f"the angle has an RMS of {size:.3g} rad about its mean over realizations"
    )


@check(
    "reversed-torque",
    "The torque has the opposite sign",
    "mean stiffness",
    0,
    "N·m/rad",
    "invalid",
    effect="stiffness, viscosity and inertia all come out negative",
    remedy="reverse the torque: add --torque-sign -1 (torque_sign=-1), or remove this "
    "option if you gave it; if the sign was right, the actuator is compliant: record its command",
    wrong="below",
)
def reversed_torque(data: FittedEnsemble) -> Measured:
    """Return the mean stiffness."""
    (value, *_), (error, *_) = _impedance(data)
    return Measured(
        value,
        f"the mean stiffness is {value:.3g} ± {error:.2g} N·m/rad",
        value < -SIGNIFICANT_ERRORS * error,
    )


@check(
    "sampling-rate",
    "Too slow or too fast for a joint",
    "distance of the natural frequency from 6.3 Hz, the middle of the range of joints (1 to 40 Hz, "
    "with an inertia up to 1 kg·m²)",
    2.66,
    "octaves",
    "serious",
    effect="a stated rate n times too high makes viscosity n times too small, and inertia n² times",
    remedy="check the file's sampling rate; foot and footplate have 0.01 to 0.04 kg·m²",
)
def sampling_rate(data: FittedEnsemble) -> Measured:
    """Compare natural frequency and inertia with those of joints.

    A wrong rate changes neither the damping ratio nor the stiffness. The fit is low-passed,
    because noise in the angle hides the inertia.
    """
    _impedance(data)
    values, errors = data.fit.smooth_impedance
    stiffness, _, inertia = values
    if (np.abs(values) < SIGNIFICANT_ERRORS * errors)[[0, 2]].any() or stiffness * inertia < 0:
        raise NotApplicable("stiffness and inertia are not determined well enough")
    frequency = math.sqrt(stiffness / inertia) / (2 * math.pi)
    inertia = abs(inertia)
    octaves = math.log2(frequency / MIDDLE_FREQUENCY_HZ)
    if inertia > MAX_INERTIA and not FAULTS["torque-unit"].beyond(stiffness):
        # The frequency of a heavy limb may be low, but no limb is as heavy as this one.
        slow = math.log2(MIN_FREQUENCY_HZ / MIDDLE_FREQUENCY_HZ * MAX_INERTIA / inertia)
        octaves = min(octaves, slow)
    what = (
        f"the natural frequency comes out at {frequency:.3g} Hz, with an inertia of {inertia:.2g} "
        "kg·m²"
    )
    return Measured(abs(octaves), what)
