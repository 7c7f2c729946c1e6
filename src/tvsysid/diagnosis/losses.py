"""Sensors at their limits, signals that were lost, spikes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tvsysid.diagnosis.check import Check, judged, unjudged
from tvsysid.diagnosis.evidence import WHITENING, Evidence

Array = NDArray[np.float64]

ALIKE = 3
"""Realizations that must be at the limit at one time."""
SAME = 1e-3
"""Of a signal's standard deviation: values that are as near as that are the same."""
TWO_LEVELS = 0.2
"""Share of samples within half an RMS below which a signal switches between two levels: Gaussian ones have 0.38."""
WINDOW = 0.2
"""In s, for losses."""
STILL = 0.1
"""Share of what is expected below which a signal does not move."""
LOUD = 4.0
"""Times the usual power from which on a window's residual is out of the ordinary."""
HALF_SPIKE = 3
"""Samples to either side with which one is compared."""
USUAL = 0.99
"""Quantile of differences that is usual."""


def clipped(evidence: Evidence, which: str) -> Check:
    """Times at which several realizations have the very same highest, or lowest, value.

    The mean over realizations may be subtracted, and with it a different value at each time: only within a time are
    values at a sensor's limit still the same.
    """
    name = f"clipped-{which}"
    ensemble = evidence.given
    values = (ensemble.angle if which == "angle" else ensemble.torque)[:, ensemble.core]
    if len(values) < 2 * ALIKE:
        return unjudged(name, f"it takes {2 * ALIKE} realizations")
    deviations = values - values.mean(axis=0)
    size = float(np.std(deviations))
    ordered = np.sort(values, axis=0)
    top = ordered[-1] - ordered[-ALIKE] <= SAME * size
    bottom = ordered[ALIKE - 1] - ordered[0] <= SAME * size
    tied = top | bottom
    share = 100 * float(tied.mean())
    if float(np.mean(np.abs(deviations) < 0.5 * size)) < TWO_LEVELS:
        return judged(name, share, f"the {which} switches between two levels, as a PRBS does", certain=False)
    sides = "highest" if not bottom.any() else "lowest" if not top.any() else "highest and lowest"
    what = f"at {share:.1f} % of the times at least {ALIKE} realizations have the same {sides} {which}"
    return judged(name, share, what if tied.any() else f"no {which} stays at a limit")


def lost(evidence: Evidence, which: str) -> Check:
    """Time during which one signal stands still, or is but what the subtracted mean left, while the other moves."""
    name = f"lost-{which}"
    samples = max(4, round(WINDOW * evidence.rate))
    answer, measured = evidence.white_parts.sum(axis=0), evidence.whitened(evidence.fit.torque)
    if measured.shape[1] < samples:
        return unjudged(name, f"realizations are shorter than {WINDOW:g} s")
    expected, there, left = (
        _window_power(values, samples) for values in (answer, measured, evidence.white_residual)
    )
    together = _window_power(answer, samples, measured)
    typical = float(np.median(left))
    if which == "torque":
        moving = expected > max(float(np.median(expected)), LOUD * typical)
        gone = moving & (there < STILL * expected) & (np.abs(together) < 2 * STILL * expected)
    else:
        gone = (left > LOUD * typical) & (expected < STILL * there) & (np.abs(together) < STILL * there)
    for values in _held(evidence, which, samples):
        gone |= values
    seconds = float(gone.sum()) * samples / evidence.rate
    if not gone.any():
        return judged(name, 0.0, f"the {which} is there throughout")
    realization, window = np.argwhere(gone)[0]
    begin = (window * samples + WHITENING + evidence.fit.first - evidence.ensemble.context) / evidence.rate
    return judged(
        name,
        seconds,
        f"the {which} does not follow for {seconds:.2g} s in {int(gone.any(axis=1).sum())} realizations, first in "
        f"realization {realization} from about {begin:.2g} s on",
    )


def _window_power(values: Array, samples: int, others: Array | None = None) -> Array:
    """Sum of products in windows that follow each other, shape (realization, window)."""
    count = values.shape[1] // samples
    others = values if others is None else others
    blocks = [each[:, : count * samples].reshape(len(each), count, samples) for each in (values, others)]
    return np.asarray(np.einsum("rws,rws->rw", *blocks))


def _held(evidence: Evidence, which: str, samples: int) -> list[NDArray[np.bool_]]:
    """Windows in which every value is the same, where no mean was subtracted; a perturbation may be held, a torque not."""
    if which == "angle":
        return []
    first = evidence.fit.first + WHITENING
    count = (evidence.fit.torque.shape[1] - WHITENING) // samples
    values = evidence.ensemble.torque[:, first : first + count * samples].reshape(-1, count, samples)
    return [np.ptp(values, axis=2) <= 1e-9 * float(np.std(evidence.ensemble.torque))]


def spikes(evidence: Evidence, which: str) -> Check:
    """Single samples far from their neighbours, against what is usual in these signals, if the joint's model is off there."""
    name = f"{which}-spikes"
    signals = {"angle": evidence.fit.motion[0], "torque": evidence.fit.torque}
    sizes = {key: _against_neighbours(values) for key, values in signals.items()}
    off = _against_neighbours(evidence.residual)
    height = sizes[which]
    # What the model explains is no spike; and one in the other channel is the other's.
    other = sizes["torque" if which == "angle" else "angle"]
    mine = np.where((off > judged(name, 0.0, "").threshold / 2) & (height > other), height, 0.0)
    if not mine.any():
        return judged(name, 0.0, f"no spike in the {which}")
    realization, sample = np.unravel_index(int(np.argmax(mine)), mine.shape)
    value = float(mine.max())
    count = int(np.count_nonzero(mine > judged(name, 0.0, "").threshold))
    begin = (sample + HALF_SPIKE + evidence.fit.first - evidence.ensemble.context) / evidence.rate
    what = f"the highest is {value:.3g} times as high as is usual, in realization {realization} at {begin:.3g} s"
    return judged(name, value, what + (f"; {count} samples stand out" if count else ""))


def _against_neighbours(values: Array) -> Array:
    """Distance of each sample from the mean of two neighbours, over what is usual."""
    inner = values[:, HALF_SPIKE:-HALF_SPIKE]
    distance = np.abs(inner - 0.5 * (values[:, 2 * HALF_SPIKE :] + values[:, : -2 * HALF_SPIKE]))
    usual = float(np.quantile(distance, USUAL)) if distance.size else 0.0
    return distance / usual if usual > 0 and math.isfinite(usual) else np.zeros_like(distance)
