"""Check whether the behaviour repeats with the period that was given."""

from __future__ import annotations

import math

import numpy as np
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from tvsysid.quality.checks import Measured, check
from tvsysid.quality.fit import FittedEnsemble
from tvsysid.quality.statistics import SIGNIFICANT
from tvsysid.signals import Array, Ensemble

# Cycles per realization that may be another period; the clock of a PRBS is faster.
MIN_CYCLES, MAX_CYCLES = 0.3, 3.3
RESOLUTION = 0.25  # step in frequency, in one over the record's length
# Distance from a harmonic, likewise, within which a line is no other period; the second of a
# behaviour that drifts.
NEAR, NEAR_DRIFTING = 0.2, 4.0
NEAR_HARMONIC = 0.1  # the same as a share of the harmonic's number, for the name of the period
BEAT_RATIO = 1.25  # of a line in the inertia to the same in the stiffness: a beat, no behaviour


@check(
    "wrong-period",
    "The movement does not repeat with this period, or the sampling rate is wrong",
    "variation of the stiffness with another period, as a share of the mean",
    10,
    "%",
    effect="each realization holds another part of the movement, so the time variation averages "
    "out",
    remedy="cut with the period that is named here, if there is one, or sort realizations by what "
    "the stiffness depends on; check the sampling rate: if half of the true one is stated, the "
    "period doubles",
)
def wrong_period(data: FittedEnsemble) -> Measured:
    """Find stiffness that varies with a period of which no whole number fits a realization.

    The residual is projected on the torque of stiffness at each sample. A line in that series
    between harmonics of the period is a behaviour of another period. The series has no part at
    the harmonics only if it is that of the fitted signals. So stiffness and viscosity are fitted
    again to the whitened signals. The test compares the power of a line with that of realizations
    of random phase. Near the harmonics of a behaviour that drifts, no line is looked for.
    """
    ensemble, fit, count = data.ensemble, data.fit, len(data)
    data.require()
    frequencies, coherent, power = lines(fit.correction.residual * fit.white_parts[0], ensemble)
    # Inertia is constant. A line that is even stronger in it is a PRBS' clock beating with the
    # sampling.
    beating = lines(fit.correction.residual * fit.white_parts[2], ensemble)[1]
    width = 2 * round(1 / RESOLUTION) + 1
    is_beat = uniform_filter1d(beating, width) > BEAT_RATIO * uniform_filter1d(coherent, width)
    given, longest = ensemble.duration, _longest(ensemble)
    beside = np.abs(frequencies - np.round(frequencies * given) / given) * longest
    is_harmonic = beside < (NEAR_DRIFTING if data.finding("drift").found else NEAR)
    coherent[is_beat | is_harmonic] = 0
    amplitude = 200 * np.sqrt(power) / np.sum(fit.white_parts[0] ** 2)
    best = int(np.argmax(np.where(coherent > 1, amplitude, 0.0)))
    chance = max(0.0, 1 - coherent[best] / count) ** (count - 1)
    chance *= max(1.0, len(frequencies) * RESOLUTION)  # of independent frequencies
    what = (
        f"stiffness varies by {amplitude[best]:.2g} % of its mean with "
        f"{_period(frequencies[best], given):.3g} s, beside what repeats every {given:g} s"
    )
    return Measured(amplitude[best], what, chance < SIGNIFICANT)


def _period(frequency: float, given: float) -> float:
    """Return the period of a line in s; near a harmonic it is one near the given period."""
    number = max(1, round(frequency * given))
    is_near = abs(frequency * given - number) < NEAR_HARMONIC * number
    return (number if is_near else 1) / frequency


def _longest(ensemble: Ensemble) -> float:
    """Return the duration in s of the longest trial, as far as it was cut."""
    onsets, trials = ensemble.onsets, ensemble.trials
    spans = (np.ptp(onsets[trials == trial]) for trial in np.unique(trials))
    return float(max(spans) + ensemble.duration)


def lines(scores: Array, ensemble: Ensemble) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz, power over that of realizations of random phase, and power.

    The scores have shape (realization, time). The realizations of a trial are transformed together,
    each turned by its onset. The frequencies are few: some cycles per realization.
    """
    duration, rate, samples = ensemble.duration, ensemble.sampling_rate, scores.shape[1]
    needed = math.ceil(_longest(ensemble) * rate / RESOLUTION) + 2 * samples
    frequencies = np.arange(needed) * rate / next_fast_len(needed, real=True)
    top = min(MAX_CYCLES / duration, 0.25 * rate)
    frequencies = frequencies[(frequencies >= MIN_CYCLES / duration) & (frequencies < top)]
    turns = -2j * np.pi * frequencies
    spectra = scores @ np.exp(np.outer(np.arange(samples) / rate, turns))
    alone = np.sum(np.abs(spectra) ** 2, axis=0)
    spectra *= np.exp(np.outer(np.round(ensemble.onsets * rate) / rate, turns))
    of_trials = [
        spectra[ensemble.trials == each].sum(axis=0) for each in np.unique(ensemble.trials)
    ]
    power = np.sum(np.abs(of_trials) ** 2, axis=0)
    return frequencies, power / np.maximum(alone, np.finfo(float).tiny), power
