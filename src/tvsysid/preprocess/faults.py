"""Find gaps of a recording, and find and remove mains hum.

In a gap nothing was recorded: the signals are held, zero or interpolated. Mains hum is a line at 50
or 60 Hz that amplifiers and cables pick up.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.errors import InputError
from tvsysid.numerics.spectra import hann, power_spectrum
from tvsysid.preprocess.trials import Gap, map_trials
from tvsysid.signals import Array, Recording

MIN_GAP_S, MIN_GAP_SAMPLES = 0.03, 10
# A signal is straight where it bends by less than these shares of its median bend and its maximum.
STRAIGHT, ROUNDING = 1e-2, 1e-12

MAINS_HZ = (50.0, 60.0)
MAX_DEVIATION_HZ = 0.3  # of a line from the mains
NEIGHBOURHOOD_HZ = 10.0  # to either side, in which nothing else may be as strong
WINDOW_S, MIN_WINDOW_S = 5.0, 2.0  # of the spectrum
MIN_CONTRAST = 4.0  # of a line, to the highest power in its neighbourhood
AVERAGING_S = 2.0  # over which the line's amplitude and phase are taken as constant


def find_gaps(recording: Recording) -> tuple[Gap, ...]:
    """Find where both angle and torque are constant or straight for 30 ms and 10 samples or more.

    Give the gaps to :func:`tvsysid.preprocess.segment`. Look for them before decimation, which
    hides them. A signal recorded in coarse steps rests at times, which is no gap. Such rests last
    10 ms more often than 30 ms.

    Examples
    --------
    >>> import numpy as np
    >>> angle, torque = np.random.default_rng(0).normal(size=(2, 2000))
    >>> angle[500:550], torque[500:550] = angle[500], 0.0
    >>> find_gaps(Recording(angle, torque, sampling_rate=1000))
    (Gap(trial=0, start=0.5, stop=0.55),)
    """
    rate = recording.sampling_rate
    starts = np.array(recording.trial_starts)
    signals = np.stack([recording.angle, recording.torque])
    bends = np.abs(np.diff(signals, 2))
    if not bends.size:
        return ()
    tolerance = STRAIGHT * np.median(bends, axis=1) + ROUNDING * np.abs(signals).max(axis=1)
    straight = (bends <= tolerance[:, None]).all(axis=0)
    for begin in starts[1:]:
        straight[begin - 2 : begin] = False
    first, last = np.flatnonzero(np.diff(np.pad(straight, 1))).reshape(-1, 2).T
    length = last - first + 2
    shortest = max(MIN_GAP_S * rate, MIN_GAP_SAMPLES)
    is_gap = length >= shortest
    if np.sum(~is_gap & (length >= shortest / 3)) > is_gap.sum():
        return ()
    trials = np.searchsorted(starts, first[is_gap], "right") - 1
    within = np.stack([first[is_gap], last[is_gap] + 2]) - starts[trials]
    times = recording.origin + recording.start + within / rate
    return tuple(map(Gap, trials.tolist(), *times.tolist()))


def find_mains(recording: Recording) -> tuple[float, float]:
    """Find mains hum in the angle.

    Returns
    -------
    50 or 60 Hz, and the RMS of the line in % of that of the angle about its mean; zero if no line
    stands out of the spectrum.
    """
    rate = recording.sampling_rate
    window = min(round(WINDOW_S * rate), recording.trial_lengths.min())
    if window < MIN_WINDOW_S * rate:
        return MAINS_HZ[0], 0.0
    spectra = []  # by Welch's method; importing scipy.signal takes longer
    for trial in recording.trials:
        segments = sliding_window_view(recording.angle[trial], window)[:: window // 2]
        spectra.append(power_spectrum(segments) / len(segments))
    step, power = rate / window, np.mean(spectra, axis=0)
    power *= 2 / rate / np.sum(hann(window) ** 2)  # density

    def share(mains: float) -> float:
        distance = np.abs(step * np.arange(len(power)) - mains)
        beside = power[(distance >= 4 * step) & (distance < NEIGHBOURHOOD_HZ)]
        if mains + NEIGHBOURHOOD_HZ >= rate / 2 or (
            power[distance < MAX_DEVIATION_HZ].max() <= MIN_CONTRAST * beside.max()
        ):
            return 0.0
        line = np.sum(power[distance < 4 * step] - np.median(beside)) * step
        return 100 * float(np.sqrt(line / recording.angle.var()))

    mains = max(MAINS_HZ, key=share)
    return mains, share(mains)


def remove_mains(recording: Recording, frequency: float) -> Recording:
    """Subtract mains hum from angle, torque and channels, before decimation.

    Its amplitude and phase are averaged by a Hann window of 2 s about each sample, so that mains
    may drift by 0.2 Hz. Signals more than 1 Hz away stay. In the first and last half second of a
    trial some 10 % of the line is left.

    Parameters
    ----------
    frequency
        Frequency of the mains in Hz, 50 or 60.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(20_000) / 1000
    >>> hum, angle = 0.1 * np.sin(2 * np.pi * 50.03 * time), 5 + np.sin(2 * np.pi * time)
    >>> left = remove_mains(Recording(angle + hum, 80 * angle, 1000), 50).angle - angle
    >>> bool(np.abs(left[1000:-1000]).max() < 0.01 * hum.max())
    True
    """
    rate = recording.sampling_rate
    if recording.recorded_angle is not None or not 0 < frequency < rate / 2:
        raise InputError(
            f"remove_mains: expected a recording at more than {2 * frequency:g} Hz, before "
            "decimation"
        )
    weights = scipy.signal.windows.hann(2 * round(AVERAGING_S * rate / 2) + 1)

    def average(values: Array) -> Array:
        return scipy.signal.oaconvolve(values, weights, "same")

    def subtract_line(values: Array) -> Array:
        carrier = np.exp(2j * np.pi * frequency / rate * np.arange(len(values)))
        demodulated = (values - values.mean()) / carrier
        line = average(demodulated) / average(np.ones(len(values))) * carrier
        return values - 2 * line.real

    return map_trials(recording, subtract_line)
