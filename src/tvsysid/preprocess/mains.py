"""Find and remove mains hum: a line at 50 or 60 Hz that amplifiers and cables pick up."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.errors import InputError
from tvsysid.preprocess.trials import map_trials, shortest_trial
from tvsysid.signals import Array, Recording

MAINS_HZ = (50.0, 60.0)
MAX_DEVIATION_HZ = 0.3  # of a line from the mains
NEIGHBOURHOOD_HZ = 10.0  # to either side, in which nothing else may be as strong
WINDOW_S, MIN_WINDOW_S = 5.0, 2.0  # of the spectrum
MIN_CONTRAST = 4.0  # of a line, to the highest power in its neighbourhood
AVERAGING_S = 2.0  # over which the line's amplitude and phase are taken as constant


def find_mains(recording: Recording) -> tuple[float, float]:
    """Find mains hum in the angle.

    Returns
    -------
    50 or 60 Hz, and the RMS of the line in % of that of the angle about its mean; zero if no line
    stands out of the spectrum.
    """
    rate = recording.sampling_rate
    window = min(round(WINDOW_S * rate), shortest_trial(recording))
    if window < MIN_WINDOW_S * rate:
        return MAINS_HZ[0], 0.0
    # scipy.signal.spectrogram gives the same, but its import takes 0.3 s.
    pieces = np.concatenate(
        [
            sliding_window_view(recording.angle[trial], window)[:: window // 2]
            for trial in recording.trials
        ]
    )
    taper, step = np.hanning(window), rate / window
    spectra = np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * taper)
    power = 2 * np.mean(np.abs(spectra) ** 2, axis=0) / (rate * np.sum(taper**2))

    def share(mains: float) -> float:
        distance = np.abs(step * np.arange(len(power)) - mains)
        beside = power[(distance >= 4 * step) & (distance < NEIGHBOURHOOD_HZ)]
        if mains + NEIGHBOURHOOD_HZ >= rate / 2:
            return 0.0
        if power[distance < MAX_DEVIATION_HZ].max() <= MIN_CONTRAST * beside.max():
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

    def subtract_line(values: Array) -> Array:
        carrier = np.exp(2j * np.pi * frequency / rate * np.arange(len(values)))
        demodulated = (values - values.mean()) / carrier
        count, sums = (
            scipy.signal.oaconvolve(each, weights, "same")
            for each in (np.ones(len(values)), demodulated)
        )
        return np.asarray(values - 2 * (sums / count * carrier).real)

    return map_trials(recording, subtract_line)
