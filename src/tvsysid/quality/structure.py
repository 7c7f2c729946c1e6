"""What a joint of second order that is moved from outside does not do: give way, reflexes, slow answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tvsysid.quality.evidence import CHANCE, LEAST_REALIZATIONS, Evidence, chance, gained, gains, without
from tvsysid.quality.excitation import ANSWERED, NO_ANSWER
from tvsysid.quality.finding import Finding, judged, unjudged

Array = NDArray[np.float64]

AHEAD = 0.03
"""Seconds ahead that the angle is foretold: within them even an imposed one is told by the derivatives' filters."""
MIRRORED = 1.5
"""Times what is told of the angle before that must be told of the angle after for it to be a cause."""
PAST_ANGLE, PAST_NOISE = 0.2, 0.15
"""Seconds of the angle's past that foretell it by itself, and of the torque left over that may add to it."""
SOONEST, LATEST, STEP = 0.04, 0.3, 0.03
"""Lags of a reflex in s."""
COARSE, SAME = 0.1, 1e-6
"""Step of an angle over its standard deviation that is coarse, and what is no step."""
SHORT = "realizations and their context are too short"
TOO_FEW = f"it takes {LEAST_REALIZATIONS} realizations"


def feedback(evidence: Evidence) -> Finding:
    """Whether noise in the torque foretells the angle beyond what the angle's own past does (Granger's test).

    What a model leaves of the torque is not noise alone: a small delay or a filter that does not match leaves a
    function of the angle, which tells of the angle before as well as of the angle after. A cause does not: the same
    test with time reversed must tell clearly less.
    """
    name = "feedback"
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW)
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER)
    if _in_steps(evidence):
        return unjudged(name, "the angle is recorded in steps so coarse that the torque knows it better")
    first = evidence.fit.first
    after = evidence.angle.shape[1] - first - evidence.residual.shape[1]
    forward = _foretelling(evidence.angle, evidence.residual, first, evidence.rate)
    backward = _foretelling(evidence.angle[:, ::-1], evidence.residual[:, ::-1], after, evidence.rate)
    if forward is None or backward is None:
        return unjudged(name, SHORT)
    share, probability = forward.mean(), chance(forward)
    what = (
        f"noise in the torque foretells {_percent(share)} of the angle's unforeseen movement in {1000 * AHEAD:.0f} ms, "
        f"and {_percent(backward.mean())} of what was {1000 * AHEAD:.0f} ms before"
    )
    more = forward.mean() > MIRRORED * backward.mean() and chance(forward - backward) < CHANCE
    certain = bool(more and probability < CHANCE)
    return judged(name, 100 * max(0.0, share), what, significant=certain)


def _foretelling(angle: Array, residual: Array, first: int, rate: float) -> Array | None:
    """Share of the angle's unforeseen movement that the torque left over foretells, in each realization.

    Over the mean of all. The first sample left over belongs to that sample of the angle; None where they are too short.
    """
    ahead = max(1, round(AHEAD * rate))
    own_lags = np.arange(ahead, ahead + round(PAST_ANGLE * rate))
    noise_lags = np.arange(ahead, ahead + round(PAST_NOISE * rate), 2)
    start, stop = max(int(own_lags.max()), first + int(noise_lags.max())), first + residual.shape[1]
    if stop - start < int(noise_lags.max()):
        return None
    past = np.stack([angle[:, start - lag : stop - lag] for lag in own_lags])
    noise = np.stack([residual[:, start - first - lag : stop - first - lag] for lag in noise_lags])
    target = without(angle[:, start:stop], past)
    total = float(np.sum(target**2))
    return gains(target, without(noise, past)) * len(target) / total if total > 0 else np.zeros(len(target))


def _in_steps(evidence: Evidence) -> bool:
    """Whether the angle is recorded in steps that are large against its movement."""
    ensemble = evidence.given
    values = np.sort(ensemble.angle[:, ensemble.core] - ensemble.angle[:, ensemble.core].mean(axis=0), axis=0)
    size = float(np.std(values))
    apart = np.diff(values, axis=0)
    apart = apart[apart > SAME * size]
    return bool(apart.size and apart.min() > COARSE * size)


def _late(evidence: Evidence, signal: Array) -> tuple[Array, slice]:
    lags = np.unique(np.round(np.arange(SOONEST, LATEST, STEP) * evidence.rate).astype(np.int64))
    return evidence.lagged(signal, lags)


def _velocity(evidence: Evidence) -> Array:
    return np.gradient(evidence.angle, 1 / evidence.rate, axis=1)


def reflex(evidence: Evidence) -> Finding:
    """Whether the torque left over follows the size of a late velocity, which a linear joint cannot."""
    return _foretold(
        evidence,
        "reflex",
        np.abs(_velocity(evidence)),
        f"the speed of {1000 * SOONEST:.0f} to {1000 * LATEST:.0f} ms before, whichever its direction,",
    )


def slow_answer(evidence: Evidence) -> Finding:
    """Whether the torque left over follows late velocities."""
    return _foretold(
        evidence,
        "slow-answer",
        _velocity(evidence),
        f"the movement of {1000 * SOONEST:.0f} to {1000 * LATEST:.0f} ms before",
    )


def _foretold(evidence: Evidence, name: str, cause: Array, words: str) -> Finding:
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW)
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER)
    causes, region = _late(evidence, cause - cause.mean(axis=0))
    if not causes.shape[2]:
        return unjudged(name, SHORT)
    share, probability = gained(evidence.residual[:, region], causes)
    what = f"{words} foretells {_percent(share)} of the torque left over"
    return judged(name, 100 * max(0.0, share), what, significant=probability < CHANCE)


def _percent(share: float) -> str:
    return f"{max(0.0, 100 * share):.2g} %"
