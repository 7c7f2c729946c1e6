"""Lower the sampling rate of an ensemble to some 100 Hz."""

from __future__ import annotations

import math

import attrs
import numpy as np
import scipy

from tvsysid.numerics.decimation import decimation_weights, windows_about
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


def known_samples(samples: int, context: int) -> int:
    """Return the number of samples of a realization whose derivatives are known."""
    region = known_region(samples, context)
    return int(region.stop - region.start)


def lowered(ensemble: Ensemble) -> Ensemble:
    """Return an ensemble at some 100 Hz, with a whole number of samples per realization.

    The signals pass the low-pass of :func:`tvsysid.preprocess.decimate`, and are interpolated
    where the new samples lie between the old ones.
    """
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    counts = range(math.ceil(samples * MIN_RATE_HZ / rate), samples // 2 + 1)
    enough = (n for n in counts if known_samples(n, context * n // samples) >= MIN_KNOWN_SAMPLES)
    count = next(enough, samples)
    if count == samples:
        return ensemble
    step, margin = samples / count, context * count // samples
    places = context + step * np.arange(-margin, count + margin)

    def resampled(values: Array) -> Array:
        windows, weights = windows_about(values), decimation_weights(step)
        if step.is_integer():
            first, last = int(places[0]), int(places[-1])
            return np.asarray(np.einsum("rtk,k", windows[:, first : last + 1 : int(step)], weights))
        smooth, time = np.einsum("rtk,k", windows, weights), np.arange(values.shape[1])
        return np.asarray(scipy.interpolate.make_interp_spline(time, smooth, axis=1)(places))

    signals = attrs.evolve(ensemble, recorded_angle=None).mapped(resampled)
    if step.is_integer():
        first, last = places[[0, -1]].astype(int)
        recorded = ensemble.angle_as_recorded[:, first : last + int(step)]
        signals["recorded_angle"] = recorded.reshape(*signals["angle"].shape, -1)
    return attrs.evolve(ensemble, **signals, context=margin, sampling_rate=rate / step)
