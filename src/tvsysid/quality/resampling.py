"""Lower the sampling rate of an ensemble to some 100 Hz."""

from __future__ import annotations

import math

import attrs
import numpy as np

from tvsysid.numerics.decimation import TAPS, windows_about
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.signals import Array, Ensemble

MIN_RATE_HZ = 100.0
MIN_KNOWN_SAMPLES = 30  # of a realization, with known derivatives


def known_region(samples: int, context: int) -> slice:
    """Return the samples, context counted, whose derivatives are known.

    These are all samples but those at the edges of a record.
    """
    margin = max(context, HALF_WIDTH)
    return slice(margin, max(margin, samples + 2 * context - margin))


def lowered(ensemble: Ensemble) -> Ensemble:
    """Return an ensemble at some 100 Hz, with a whole number of samples per realization.

    The signals pass the low-pass of :func:`tvsysid.preprocess.decimate`, a windowed sinc, which
    also interpolates where the new samples lie between the old ones.
    """
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    count = max(math.ceil(samples * MIN_RATE_HZ / rate), MIN_KNOWN_SAMPLES + 2 * HALF_WIDTH)
    if count > samples // 2:
        return ensemble
    step, margin = samples / count, context * count // samples
    places = context + step * np.arange(-margin, count + margin)
    nearest = np.round(places).astype(np.int64)
    lags = np.arange(TAPS) - TAPS // 2 - (places - nearest)[:, None]
    weights = np.sinc(lags / step) * (0.54 + 0.46 * np.cos(2 * np.pi / (TAPS - 1) * lags))
    weights /= weights.sum(axis=1, keepdims=True)

    def resampled(values: Array) -> Array:
        return np.asarray(np.einsum("rtk,tk->rt", windows_about(values)[:, nearest], weights))

    signals = attrs.evolve(ensemble, recorded_angle=None).mapped(resampled)
    if step.is_integer():
        recorded = ensemble.angle_as_recorded[:, nearest[0] : nearest[-1] + int(step)]
        signals["recorded_angle"] = recorded.reshape(*signals["angle"].shape, -1)
    return attrs.evolve(ensemble, **signals, context=margin, sampling_rate=rate / step)
