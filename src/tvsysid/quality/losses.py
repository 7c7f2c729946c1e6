"""Sensors at their limits, signals that were lost, spikes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.evidence import Evidence, innovations
from tvsysid.quality.finding import Finding, judged, unjudged

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
QUIET = 0.25
"""Share of a realization's windows that are quieter than what counts as its noise."""
LEAST_SAMPLES = 10
"""Of a window."""
HALF_SPIKE = 3
"""Samples to either side from which a spike stands out."""
PAST = 0.12
"""Seconds of a signal's past that foretell it."""
USUAL_ANGLE, USUAL_TORQUE = 0.99, 0.9
"""Quantiles against which spikes are held: a PRBS surprises at every switch, noise never."""
OUT_OF_LINE = 1.2
"""Times the usual distance from the median about it that makes a sample stand out."""
FAR_OUT_OF_LINE = 2.0
"""The same, of a sample that is taken out before what is lost is looked for."""
DISTURBED = 4.5
"""Times the usual residual that a spike in the angle causes beside it."""
SCATTER = 2.0
"""Times the usual level that the level of one time has by chance."""
BESIDE = 6
"""Samples to either side over which the derivatives' filters spread a spike."""


def clipped(evidence: Evidence, which: str) -> Finding:
    """Times at which several realizations have the very same highest, or lowest, value.

    The mean over realizations may be subtracted, and with it a different value at each time: only within a time are
    values at a sensor's limit still the same.
    """
    name = f"clipped-{which}"
    ensemble = evidence.given
    values = (ensemble.angle if which == "angle" else ensemble.torque)[:, ensemble.core]
    if len(values) < 2 * ALIKE:
        return unjudged(name, f"it takes {2 * ALIKE} realizations")
    size = float(np.std(values - values.mean(axis=0)))
    ordered = np.sort(values, axis=0)
    top = ordered[-1] - ordered[-ALIKE] <= SAME * size
    bottom = ordered[ALIKE - 1] - ordered[0] <= SAME * size
    tied = top | bottom
    if not tied.any():
        return judged(name, 0.0, f"no {which} stays at a limit")
    share = 100 * float(tied.mean())
    middle = len(ordered) // 2
    inside = ordered[min(middle + ALIKE, len(ordered)) - 1] - ordered[middle] <= SAME * size
    if inside.mean() > max(0.5 * tied.mean(), 0.01 * FAULTS[name].limit):
        return unjudged(name, f"the same values of {which} come again and again, not only the extremes")
    if which == "angle" and float(np.mean(np.abs(values - values.mean(axis=0)) < 0.5 * size)) < TWO_LEVELS:
        return unjudged(name, "the angle switches between two levels, as a PRBS does")
    sides = "highest" if not bottom.any() else "lowest" if not top.any() else "highest and lowest"
    what = f"at {share:.1f} % of the times at least {ALIKE} realizations have the same {sides} {which}"
    return judged(name, share, what)


def lost(evidence: Evidence, which: str) -> Finding:
    """Time during which one signal stands still, or is but what the subtracted mean left, while the other moves."""
    name = f"lost-{which}"
    samples = max(LEAST_SAMPLES, round(WINDOW * evidence.rate))
    answer, measured = evidence.white_parts.sum(axis=0), evidence.whitened(evidence.fit.torque)
    if measured.shape[1] < samples:
        return unjudged(name, f"realizations are shorter than {WINDOW:g} s")
    expected, there, left = (_window_power(values, samples) for values in (answer, measured, evidence.white_residual))
    together = _window_power(answer, samples, measured)
    typical = float(np.median(left))
    # What is loud at this time in most realizations, or at most times in this one, is noise and no loss.
    noise = np.maximum(np.median(left, axis=0), np.maximum(typical, np.quantile(left, QUIET, axis=1))[:, None])
    if which == "torque":
        moving = expected > max(float(np.median(expected)), LOUD * typical)
        gone = moving & (there < STILL * expected) & (np.abs(together) < 2 * STILL * expected)
    else:
        gone = (left > LOUD * noise) & (expected < STILL * there) & (np.abs(together) < STILL * there)
    for values in _held(evidence, which, samples):
        gone |= values
    # A spike in the other signal moves much, and is answered by nothing.
    other = "angle" if which == "torque" else "torque"
    heights = _angle_heights(evidence) if other == "angle" else _torque_heights(evidence)
    first, length = evidence.fit.first + evidence.whitening, heights.shape[1]
    alone = _against_neighbours(getattr(evidence, other))[:, first : first + length] > FAR_OUT_OF_LINE
    spikes = maximum_filter1d(alone & (heights > FAULTS[f"{other}-spikes"].limit), 2 * BESIDE + 1, axis=1)
    count = gone.shape[1]
    gone &= ~spikes[:, : count * samples].reshape(len(spikes), count, samples).any(axis=2)
    seconds = float(gone.sum()) * samples / evidence.rate
    if not gone.any():
        return judged(name, 0.0, f"the {which} is there throughout")
    realization, window = np.argwhere(gone)[0]
    begin = (window * samples + evidence.whitening + evidence.fit.first - evidence.ensemble.context) / evidence.rate
    return judged(
        name,
        seconds,
        f"the {which} does not follow for {seconds:.2g} s in {int(gone.any(axis=1).sum())} realizations, first in "
        f"realization {realization} from about {begin:.2g} s on",
    )


def _window_power(values: Array, samples: int, others: Array | None = None) -> Array:
    """Products of deviations from the mean of each window, summed, shape (realization, window)."""
    count = values.shape[1] // samples
    others = values if others is None else others
    blocks = [each[:, : count * samples].reshape(len(each), count, samples) for each in (values, others)]
    return np.asarray(np.einsum("rws,rws->rw", *(block - block.mean(axis=2, keepdims=True) for block in blocks)))


def _held(evidence: Evidence, which: str, samples: int) -> list[NDArray[np.bool_]]:
    """Windows in which every value is the same, where no mean was subtracted; an angle may be held, a torque not."""
    if which == "angle":
        return []
    first = evidence.fit.first + evidence.whitening
    count = (evidence.fit.torque.shape[1] - evidence.whitening) // samples
    values = evidence.ensemble.torque[:, first : first + count * samples].reshape(-1, count, samples)
    return [np.ptp(values, axis=2) <= 1e-9 * float(np.std(evidence.ensemble.torque))]


def angle_spikes(evidence: Evidence) -> Finding:
    """Samples that neither past nor neighbours foretell, and that the torque does not answer."""
    return _highest(evidence, "angle-spikes", _angle_heights(evidence))


def _angle_heights(evidence: Evidence) -> Array:
    """How high the samples that stand out are over what is usual, shape (realization, time - w); others are zero."""
    surprise, _, place = _surprises(evidence)
    standing_out = surprise > 0
    standing_out &= _against_neighbours(evidence.angle)[:, place] > OUT_OF_LINE
    residual = _over_usual(np.abs(evidence.white_residual), USUAL_TORQUE)
    standing_out &= maximum_filter1d(residual, 2 * BESIDE + 1, axis=1) > DISTURBED
    return np.where(standing_out, surprise, 0.0)


def torque_spikes(evidence: Evidence) -> Finding:
    """Samples that neither the model nor the past of what it leaves foretell, and that are not the angle's."""
    return _highest(evidence, "torque-spikes", _torque_heights(evidence))


def _torque_heights(evidence: Evidence) -> Array:
    """The same of the torque."""
    surprise, torque_surprise, _ = _surprises(evidence)
    residual = _over_usual(np.abs(evidence.white_residual), USUAL_TORQUE)
    # What is high at this time in most realizations is not a spike: a change of stiffness that the bins do not follow.
    # Spikes at one time leave their mean in all the others.
    together = np.median(np.abs(evidence.white_residual - np.median(evidence.white_residual, axis=0)), axis=0)
    residual /= np.maximum(1.0, together / max(SCATTER * float(np.median(together)), np.finfo(float).tiny))
    of_angle = maximum_filter1d(surprise, 4 * BESIDE + 1, axis=1) > FAULTS["angle-spikes"].limit
    return np.where((torque_surprise > surprise) & ~of_angle, residual, 0.0)


def _surprises(evidence: Evidence) -> tuple[Array, Array, slice]:
    """What the angle's past does not foretell, the torque's alike, over what is usual; and which samples."""
    order = min(max(2, round(PAST * evidence.rate)), evidence.fit.first + evidence.whitening)
    first, samples = evidence.fit.first + evidence.whitening, evidence.white_residual.shape[1]
    inner = slice(first - order, first - order + samples)
    angle, torque = (
        _over_usual(np.abs(innovations(values, order)[:, inner]), USUAL_ANGLE)
        for values in (evidence.angle, evidence.torque)
    )
    return angle, torque, slice(first, first + samples)


def _highest(evidence: Evidence, name: str, heights: Array) -> Finding:
    value = float(heights.max())
    if value == 0:
        return judged(name, 0.0, "none")
    realization, sample = np.unravel_index(int(np.argmax(heights)), heights.shape)
    begin = (sample + evidence.whitening + evidence.fit.first - evidence.ensemble.context) / evidence.rate
    count = int(np.count_nonzero(heights > FAULTS[name].limit))
    more = f"; {count} samples stand out" if count > 1 else ""
    return judged(
        name,
        value,
        f"the highest is {value:.3g} times as high as is usual, in realization {realization} at {begin:.3g} s{more}",
    )


def _over_usual(values: Array, quantile: float) -> Array:
    usual = float(np.quantile(values, quantile))
    return values / usual if usual > 0 else np.zeros_like(values)


def _against_neighbours(values: Array) -> Array:
    """Distance of each sample from the median about it over what is usual; a step has none, a spike has all of it."""
    distance = np.abs(values - median_filter(values, (1, 2 * HALF_SPIKE + 1)))
    return _over_usual(distance, USUAL_ANGLE)
