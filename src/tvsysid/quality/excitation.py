"""Whether the perturbation and the amount of data determine the impedance at all."""

from __future__ import annotations

import numpy as np

from tvsysid.numerics.moments import mean_subtracted
from tvsysid.numerics.spectra import power_share
from tvsysid.quality.evidence import Evidence
from tvsysid.quality.finding import Finding, judged, unjudged

ANSWERED = 0.1
"""Share of the torque that must be explained for the impedance to be spoken of."""
NO_ANSWER = "the torque does not answer the angle"
QUARTER = 0.25
"""Of the sampling rate: above it a joint hardly moves, but a sensor's noise goes on."""
UNKNOWN = 9.99
"""Relative error from which on more digits tell nothing."""


def few_realizations(evidence: Evidence) -> Finding:
    """Count them."""
    count = len(evidence.ensemble)
    return judged("few-realizations", count, f"there are {count} realizations")


def weak_answer(evidence: Evidence) -> Finding:
    """Share of the torque that a joint of second order explains."""
    share = 100 * evidence.explained
    return judged(
        "weak-answer", share, f"stiffness, viscosity and inertia explain {share:.1f} % of the torque's variance"
    )


def narrow_excitation(evidence: Evidence) -> Finding:
    """How well a mean stiffness and inertia are determined, by the scatter over realizations."""
    if evidence.explained < ANSWERED:
        return unjudged("narrow-excitation", NO_ANSWER)
    values, errors = evidence.mean_impedance
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(np.abs(errors / values), nan=np.inf)[[0, 2]]
    worst = int(np.argmax(relative))
    value = 100 * min(float(relative[worst]), UNKNOWN)
    name, unit = (("stiffness", "N·m/rad"), ("inertia", "kg·m²"))[worst]
    number, error = values[[0, 2]][worst], errors[[0, 2]][worst]
    return judged(
        "narrow-excitation", value, f"the data give a mean {name} of {number:.3g} ± {error:.2g} {unit}, ± {value:.2g} %"
    )


def same_perturbation(evidence: Evidence) -> Finding:
    """Whether all realizations were moved alike; only sensor noise differs then, and no torque answers it."""
    angle = evidence.ensemble.angle[:, evidence.ensemble.core]
    varying = angle - angle.mean()
    common = float(np.mean(varying.mean(axis=0) ** 2) / np.mean(varying**2))
    common = max(0.0, common - 1 / len(angle))
    white = power_share(evidence.angle[:, evidence.ensemble.core], evidence.rate, QUARTER * evidence.rate, np.inf)
    told = [
        (
            100 * white,
            f"{100 * white:.0f} % of the variance by which the angle differs between realizations lies above "
            f"{QUARTER * evidence.rate:g} Hz",
        )
    ]
    if not mean_subtracted(angle):
        told.append((100 * common, f"{100 * common:.0f} % of the angle's variance is common to all realizations"))
    value, what = max(told)
    if evidence.explained >= ANSWERED:
        return judged("same-perturbation", 0.0, f"{what}, but the torque answers what differs")
    return judged("same-perturbation", value, f"{what}, and {NO_ANSWER} where realizations differ")
