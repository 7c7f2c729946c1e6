"""Lower the sampling rate of a recording."""

from __future__ import annotations

import warnings

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.numerics.decimation import SHARP, TAPS, keep_every
from tvsysid.preprocess.trials import map_trials, shortest_trial
from tvsysid.signals import Array, Recording
from tvsysid.validators import positive

MIN_RATE_HZ = 40.0  # below, stiffness and inertia can hardly be separated


def nearest_rate(recorded: float, rate: float) -> float:
    """Return the rate in Hz nearest to ``rate`` to which one can decimate.

    A whole number of Hz, if there is any.
    """
    rates = (recorded / factor for factor in range(1, int(recorded) + 2))
    return min(rates, key=lambda fit: (fit % 1 > 0, abs(fit - rate)))


def decimate(recording: Recording, rate: float, *, sharp: bool = False) -> Recording:
    r"""Low-pass filter all signals and keep every r-th sample, r being the ratio of the rates.

    The filter is a 31-tap Hamming-window FIR with -6 dB at the new Nyquist frequency. Its delay is
    removed, so that the first sample stays the first. The ends of each trial are continued by odd
    reflection. A sudden change is smeared over :math:`\pm 15` samples of the old rate.

    All signals pass the same filter, which therefore cancels in the identification of a joint that
    does not vary. Take the envelope of an EMG before, if you need it. The original angle is kept as
    ``recorded_angle``, for methods that rectify its velocity.

    Parameters
    ----------
    recording
        Trials that are no shorter than the filter.
    rate
        New sampling rate in Hz. It must divide the old one.
    sharp
        Use a filter of 20 r + 1 taps, for angle and torque that reach beyond the new Nyquist
        frequency. The short filter lets these pass as slower movements (aliases), which no method
        can explain. The sharp one smears a sudden change over :math:`\pm 10` samples of the new
        rate.

    Warns
    -----
    DataQualityWarning
        If the new rate is below 40 Hz, which leaves too little of a joint's response.

    References
    ----------
    van de Ruit et al. 2021, sections 3.1.3 and 4.1.4 (50-Hz, respectively 64-Hz, 30th-order
    low-pass).
    """
    positive.check("decimate", "rate", rate)
    ratio = recording.sampling_rate / rate
    factor = round(ratio)
    if factor < 1 or abs(ratio - factor) > 1e-9 * ratio:
        nearest = nearest_rate(recording.sampling_rate, rate)
        raise InputError(
            f"decimate: {recording.sampling_rate:g} Hz is not a whole multiple of {rate:g} Hz; the "
            f"nearest rate that fits is {nearest:g} Hz"
        )
    if factor == 1:
        return recording
    taps, shortest = SHARP * factor + 1 if sharp else TAPS, shortest_trial(recording)
    if shortest < taps:
        raise InputError(
            f"decimate: a trial of {shortest} samples is shorter than the filter's {taps} samples"
        )
    if rate < MIN_RATE_HZ:
        warnings.warn(
            f"decimated to {rate:g} Hz, the record holds nothing above {rate / 2:g} Hz. Stiffness, "
            "viscosity and inertia can hardly be separated. Give the new rate in Hz (100 is "
            "usual), not a factor.",
            DataQualityWarning,
            stacklevel=2,
        )

    def group(angle: Array) -> Array:
        """Return the samples recorded for each one kept. The last sample fills the last group."""
        size = factor * angle.shape[1]
        return np.pad(angle.ravel(), (0, -angle.size % size), "edge").reshape(-1, size)

    recorded = [group(recording.angle_as_recorded[trial]) for trial in recording.trials]
    return map_trials(
        attrs.evolve(recording, recorded_angle=None),
        lambda values: keep_every(values, factor, taps),
        recorded_angle=np.concatenate(recorded),
        sampling_rate=rate,
    )
