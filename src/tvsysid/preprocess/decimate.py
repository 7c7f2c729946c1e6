"""Lower sampling rate without aliasing and without delay."""

from __future__ import annotations

import numpy as np
from scipy.signal import firwin, upfirdn

from tvsysid.errors import InputError
from tvsysid.preprocess.steps import every_signal
from tvsysid.signals import Array, Recording, checked_rate

TAPS = 31


def decimate(recording: Recording, rate: float) -> Recording:
    r"""Low-pass and keep every r-th sample, r being the ratio of the rates.

    The filter is a 31-tap Hamming-window FIR with -6 dB at the new Nyquist frequency; its delay is removed, so that the
    first sample stays the first. Ends (of each trial) are continued by odd reflection. Angle, torque and channels
    (EMG as well: take its envelope before, if that is what counts) all pass the same filter, which therefore cancels in
    the identification of what does not vary; a sudden change is smeared over :math:`\pm 15` samples of the old rate.

    Parameters
    ----------
    recording
        What to decimate.
    rate
        New sampling rate in Hz; must divide the old one.

    Returns
    -------
    Recording
        At the new rate.

    Raises
    ------
    InputError
        If the rate does not divide the recording's, or a trial is shorter than the filter.

    References
    ----------
    van de Ruit et al. 2021, sections 3.1.3 and 4.1.4 (50-Hz, respectively 64-Hz, 30th-order low-pass).
    """
    rate = checked_rate(rate)
    ratio = recording.sampling_rate / rate
    factor = round(ratio)
    if factor < 1 or abs(ratio - factor) > 1e-9 * ratio:
        every = [recording.sampling_rate / r for r in range(1, max(2, int(recording.sampling_rate)))]
        whole = [fit for fit in every if fit == round(fit)] or every
        fits = sorted(sorted(whole, key=lambda fit: abs(fit - rate))[:4])
        raise InputError(
            f"decimate: {recording.sampling_rate:g} Hz is not a whole multiple of {rate:g} Hz; "
            f"rates that fit nearby: {', '.join(f'{fit:g}' for fit in fits)} Hz"
        )
    if factor == 1:
        return recording
    shortest = min(trial.stop - trial.start for trial in recording.trials)
    if shortest < TAPS:
        raise InputError(f"decimate: a trial of {shortest} samples is shorter than the filter's {TAPS} samples")
    taps = firwin(TAPS, 1 / factor)

    def lower(x: Array) -> Array:
        return np.concatenate([_filter_and_keep(x[trial], taps, factor) for trial in recording.trials])

    lengths = [-(-(trial.stop - trial.start) // factor) for trial in recording.trials]
    starts = tuple(int(first) for first in np.cumsum([0, *lengths[:-1]]))
    return Recording(**every_signal(recording, lower), sampling_rate=rate, start=recording.start, trial_starts=starts)


def _filter_and_keep(x: Array, taps: Array, factor: int) -> Array:
    """Every factor-th sample of the zero-delay convolution of x with symmetric taps."""
    half = len(taps) // 2
    skip = -(-2 * half // factor)  # outputs that lie before the first sample
    before = skip * factor - half  # so that the outputs fall on the samples 0, factor, 2 factor, ...
    head = 2 * x[0] - x[half:0:-1]
    tail = 2 * x[-1] - x[-2 : -2 - half : -1]
    extended = np.concatenate([np.zeros(before - half), head, x, tail])
    kept = -(-len(x) // factor)
    return np.asarray(upfirdn(taps, extended, down=factor)[skip : skip + kept])
