"""What a joint of second order that is moved from outside does not do: give way, reflexes, slow answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tvsysid.diagnosis.check import Check, judged, unjudged
from tvsysid.diagnosis.evidence import CHANCE, LEAST_REALIZATIONS, Evidence, gained, without
from tvsysid.diagnosis.excitation import ANSWERED, NO_ANSWER

Array = NDArray[np.float64]

AHEAD = 0.03
"""Seconds ahead that the angle is foretold: within them even an imposed one is told by the derivatives' filters."""
PAST_ANGLE, PAST_NOISE = 0.2, 0.15
"""Seconds of the angle's past that foretell it by itself, and of the torque left over that may add to it."""
SOONEST, LATEST, STEP = 0.04, 0.3, 0.03
"""Lags of a reflex in s."""
SHORT = "realizations and their context are too short"
TOO_FEW = f"it takes {LEAST_REALIZATIONS} realizations"


def feedback(evidence: Evidence) -> Check:
    """Whether noise in the torque foretells the angle beyond what the angle's own past does (Granger's test)."""
    name = "feedback"
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW)
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER)
    ahead = max(1, round(AHEAD * evidence.rate))
    noise_lags = np.arange(ahead, ahead + round(PAST_NOISE * evidence.rate), 2)
    past, region = evidence.lagged(evidence.angle, np.arange(ahead, ahead + round(PAST_ANGLE * evidence.rate)))
    samples = evidence.residual.shape[1]
    start = max(region.start, int(noise_lags.max()))
    if samples - start < int(noise_lags.max()) or not past.shape[2]:
        return unjudged(name, SHORT)
    past = past[:, :, start - region.start :]
    noise = np.stack([evidence.residual[:, start - lag : samples - lag] for lag in noise_lags])
    angle = evidence.fit.motion[0][:, start:]
    share, probability = gained(without(angle, past), without(noise, past))
    what = (
        f"noise in the torque foretells {_percent(share)} of the angle's unforeseen movement in {1000 * AHEAD:.0f} ms"
    )
    return judged(name, 100 * share, what, certain=share > 0 and probability < CHANCE)


def _late(evidence: Evidence, signal: Array) -> tuple[Array, slice]:
    lags = np.unique(np.round(np.arange(SOONEST, LATEST, STEP) * evidence.rate).astype(np.int64))
    return evidence.lagged(signal, lags)


def _velocity(evidence: Evidence) -> Array:
    return np.gradient(evidence.angle, 1 / evidence.rate, axis=1)


def reflex(evidence: Evidence) -> Check:
    """Whether the torque left over follows the size of a late velocity, which a linear joint cannot."""
    return _foretold(
        evidence,
        "reflex",
        np.abs(_velocity(evidence)),
        f"the speed of {1000 * SOONEST:.0f} to {1000 * LATEST:.0f} ms before, whichever its direction,",
    )


def slow_answer(evidence: Evidence) -> Check:
    """Whether the torque left over follows late velocities."""
    return _foretold(
        evidence,
        "slow-answer",
        _velocity(evidence),
        f"the movement of {1000 * SOONEST:.0f} to {1000 * LATEST:.0f} ms before",
    )


def _foretold(evidence: Evidence, name: str, cause: Array, words: str) -> Check:
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW)
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER)
    causes, region = _late(evidence, cause - cause.mean(axis=0))
    if not causes.shape[2]:
        return unjudged(name, SHORT)
    share, probability = gained(evidence.residual[:, region], causes)
    what = f"{words} foretells {_percent(share)} of the torque left over"
    return judged(name, 100 * share, what, certain=share > 0 and probability < CHANCE)


def _percent(share: float) -> str:
    return f"{max(0.0, 100 * share):.2g} %"
