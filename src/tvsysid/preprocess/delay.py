"""Correct a delay between angle and torque."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.errors import InputError
from tvsysid.numerics.interpolation import SINC, between
from tvsysid.preprocess.trials import map_trials, shortest_trial
from tvsysid.signals import Array, Recording
from tvsysid.validators import finite


def align_channels(recording: Recording, delay: float) -> Recording:
    """Shift the torque to an earlier time, to correct a delay of its filter or clock.

    Between samples, the torque is interpolated (windowed sinc). Samples without a torque are cut
    off one end of each trial. Further channels stay with the angle. ``delay_removed`` states the
    correction in the recording, in ensembles cut from it, and in the diagnostics of models.

    Parameters
    ----------
    delay
        Seconds by which the torque was recorded later than the angle; negative if earlier. The
        finding ``delay`` of :func:`tvsysid.diagnose` estimates it, in ms. Correct it before
        decimation.

    Raises
    ------
    InputError
        For a delay that is not a number, or as long as a trial.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.sin(np.arange(1000) / 50)
    >>> late = Recording(angle[3:], 80 * angle[:-3], sampling_rate=1000)
    >>> aligned = align_channels(late, 0.003)
    >>> bool(np.allclose(aligned.torque, 80 * aligned.angle)), len(aligned), aligned.delay_removed
    (True, 994, 0.003)
    """
    finite.check("align_channels", "delay", delay)
    samples = float(delay * recording.sampling_rate)
    whole, lost = round(samples), math.ceil(abs(samples) - 1e-9)
    shortest = shortest_trial(recording)
    if lost >= shortest:
        raise InputError(
            f"align_channels: a delay of {delay:g} s leaves nothing of a trial of "
            f"{shortest / recording.sampling_rate:g} s"
        )
    head, tail = (lost, 0) if samples < 0 else (0, lost)

    def shift(torque: Array) -> Array:
        padded = np.pad(torque, SINC, "reflect", reflect_type="odd")
        late = between(padded, samples - whole)[SINC:-SINC]
        index = np.arange(head, len(torque) - tail) + whole
        return late[np.clip(index, 0, len(torque) - 1)]

    return map_trials(
        recording,
        lambda values: values[head : len(values) - tail],
        torque=np.concatenate([shift(recording.torque[trial]) for trial in recording.trials]),
        start=recording.start + head / recording.sampling_rate,
        delay_removed=recording.delay_removed + delay,
    )
