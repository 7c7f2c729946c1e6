"""Mains hum: a line at 50 or 60 Hz that amplifiers and cables pick up."""

from __future__ import annotations

import attrs
import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.errors import InputError
from tvsysid.preprocess.segment import every_signal
from tvsysid.signals import Array, Recording

FREQUENCIES = (50.0, 60.0)  # Hz
NEAR = 0.3  # Hz to either side within which a line is mains
BESIDE = 10.0  # Hz to either side within which nothing else may be as strong
WINDOW_S, SHORTEST_S = 5.0, 2.0  # of the spectrum
STANDS_OUT = 4.0  # times the highest power beside it that makes a line
FOLLOWED_S = 2.0  # within which the line's amplitude and phase are taken as constant


def find_mains(recording: Recording) -> tuple[float, float]:
    """Find mains hum in the angle: 50 or 60 Hz, and the RMS of the line over that of the angle about its mean in %.

    The share is zero where no line stands out of the spectrum beside it.
    """
    rate, found = recording.sampling_rate, (0.0, FREQUENCIES[0])
    trials = [recording.angle[trial] for trial in recording.trials]
    window = min(round(WINDOW_S * rate), *map(len, trials))
    if window < SHORTEST_S * rate:
        return found[::-1]
    step = rate / window
    pieces = np.concatenate(
        [sliding_window_view(trial, window)[:: window // 2] for trial in trials]
    )
    taper = np.hanning(window)
    spectra = np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * taper)
    power = 2 * np.mean(np.abs(spectra) ** 2, axis=0) / (rate * np.sum(taper**2))
    for mains in FREQUENCIES:
        distance = np.abs(step * np.arange(len(power)) - mains)
        beside = power[(distance >= 4 * step) & (distance < BESIDE)]
        if mains + BESIDE < rate / 2 and power[distance < NEAR].max() > STANDS_OUT * beside.max():
            line = np.sum(power[distance < 4 * step] - np.median(beside)) * step
            found = max(found, (100 * float(np.sqrt(line / recording.angle.var())), mains))
    return found[::-1]


def remove_mains(recording: Recording, frequency: float) -> Recording:
    """Subtract a line from angle, torque and channels alike, before decimation.

    Its amplitude and phase are those under a Hann window of 2 s about each sample, so that mains
    may drift by 0.2 Hz. What is more than 1 Hz away stays. In the first and last half second of a
    trial some 10 % of the line is left.

    Parameters
    ----------
    frequency
        Of the mains in Hz, 50 or 60.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(20_000) / 1000
    >>> hum, angle = 0.1 * np.sin(2 * np.pi * 50.03 * time), 5 + np.sin(2 * np.pi * time)
    >>> left = remove_mains(Recording(angle + hum, 80 * angle, 1000), 50).angle - angle
    >>> bool(np.abs(left[1000:-1000]).max() < 0.01 * hum.max())
    True
    """
    if recording.recorded_angle is not None or not 0 < frequency < recording.sampling_rate / 2:
        raise InputError(
            f"remove_mains: expected a recording at more than {2 * frequency:g} Hz, before "
            "decimation"
        )
    weights = scipy.signal.windows.hann(2 * round(FOLLOWED_S * recording.sampling_rate / 2) + 1)

    def less_line(values: Array) -> Array:
        turn = np.exp(2j * np.pi * frequency / recording.sampling_rate * np.arange(len(values)))
        changing = (values - values.mean()) / turn
        count, sums = (
            scipy.signal.oaconvolve(each, weights, "same")
            for each in (np.ones(len(values)), changing)
        )
        return np.asarray(values - 2 * (sums / count * turn).real)

    def without(values: Array) -> Array:
        return np.concatenate([less_line(values[trial]) for trial in recording.trials])

    return attrs.evolve(recording, **every_signal(recording, without))
