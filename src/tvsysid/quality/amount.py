"""Whether the perturbation and the amount of data determine the impedance at all."""

from __future__ import annotations

import numpy as np

from tvsysid.numerics.spectra import power_share
from tvsysid.quality.finding import Seen
from tvsysid.quality.fitted import ANSWERED, NO_ANSWER, FittedEnsemble

QUARTER = 0.25
"""Of the sampling rate: above it a joint hardly moves, but a sensor's noise goes on."""
UNKNOWN = 9.99
"""Relative error from which on more digits tell nothing."""


def few_realizations(data: FittedEnsemble) -> Seen:
    """Count them."""
    return Seen(len(data), f"there are {len(data)} realizations")


def weak_answer(data: FittedEnsemble) -> Seen:
    """Share of the torque that a joint of second order explains."""
    share = 100 * data.explained
    return Seen(share, f"stiffness, viscosity and inertia explain {share:.1f} % of the torque's variance")


def narrow_excitation(data: FittedEnsemble) -> Seen:
    """How well a mean stiffness and inertia are determined, by the scatter over realizations."""
    data.require()
    values, errors = data.mean_impedance
    if not np.isfinite(values).all():
        return Seen(100 * UNKNOWN, "stiffness, viscosity and inertia are not separately identifiable")
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(np.abs(errors / values), nan=np.inf)[[0, 2]]
    worst = int(np.argmax(relative))
    value = 100 * min(float(relative[worst]), UNKNOWN)
    name, unit = (("stiffness", "N·m/rad"), ("inertia", "kg·m²"))[worst]
    number, error = values[[0, 2]][worst], errors[[0, 2]][worst]
    return Seen(value, f"the data give a mean {name} of {number:.3g} ± {error:.2g} {unit}, ± {value:.2g} %")


def same_perturbation(data: FittedEnsemble) -> Seen:
    """Whether all realizations were moved alike; only sensor noise differs then, and no torque answers it."""
    angle = data.ensemble.angle[:, data.ensemble.core]
    white = 100 * power_share(data.core("angle"), data.rate, QUARTER * data.rate, np.inf)
    above = f"above {QUARTER * data.rate:g} Hz"
    told = [(white, f"{white:.0f} % of the variance by which the angle differs between realizations lies {above}")]
    if not data.ensemble.mean_subtracted:
        varying = angle - angle.mean()
        common = float(np.mean(varying.mean(axis=0) ** 2) / np.mean(varying**2))
        common = 100 * max(0.0, common - 1 / len(angle))
        told.append((common, f"{common:.0f} % of the angle's variance is common to all realizations"))
    value, what = max(told)
    if data.explained >= ANSWERED:
        return Seen(0.0, f"{what}, but the torque answers what differs")
    return Seen(value, f"{what}, and {NO_ANSWER} where realizations differ")
