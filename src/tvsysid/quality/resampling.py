"""Lower the sampling rate of an ensemble to some 100 Hz."""

from __future__ import annotations

import math

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.numerics.decimation import decimation_weights, keep_every
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.signals import Array, Ensemble

MIN_RATE_HZ = 100.0
MIN_KNOWN_SAMPLES = 30  # of a realization, with known derivatives
LOW_PASS_SAMPLES = 3  # length of a low-pass in samples of the lower rate


def known_region(samples: int, context: int) -> slice:
    """Return the samples, context counted, whose derivatives are known.

    These are all samples but those at the edges of a record.
    """
    margin = max(context, HALF_WIDTH)
    return slice(margin, max(margin, samples + min(context, 2 * context - HALF_WIDTH)))


def known_samples(samples: int, context: int) -> int:
    """Return the number of samples of a realization whose derivatives are known."""
    region = known_region(samples, context)
    return int(region.stop - region.start)


def lowered(ensemble: Ensemble) -> Ensemble:
    """Return an ensemble at some 100 Hz, with a whole number of samples per realization.

    Where the samples of realization and context share a factor, the ensemble is decimated as by
    :func:`tvsysid.preprocess.decimate`. Where they do not, it passes the same low-pass and is
    interpolated.
    """
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    plain = attrs.evolve(ensemble, recorded_angle=None)
    factors = [
        factor
        for factor in range(2, int(rate / MIN_RATE_HZ) + 1)
        if math.gcd(samples, context) % factor == 0
        and known_samples(samples // factor, context // factor) >= MIN_KNOWN_SAMPLES
    ]
    factor = max(factors, default=1)
    counts = range(math.ceil(samples * MIN_RATE_HZ / rate), samples // 2 + 1)
    long_enough = (
        n for n in counts if known_samples(n, context * n // samples) >= MIN_KNOWN_SAMPLES
    )
    if rate / factor > 2 * MIN_RATE_HZ and (count := next(long_enough, 0)):
        step, margin = samples / count, context * count // samples
        places = context + step * np.arange(-margin, count + margin)
        signals = plain.mapped(lambda values: _interpolated(values, step, places))
        return attrs.evolve(ensemble, **signals, context=margin, sampling_rate=rate / step)
    if factor == 1:
        return ensemble
    signals = plain.mapped(lambda values: keep_every(values, factor))
    signals["recorded_angle"] = ensemble.angle_as_recorded.reshape(*signals["angle"].shape, -1)
    return attrs.evolve(ensemble, **signals, context=context // factor, sampling_rate=rate / factor)


def _interpolated(values: Array, step: float, places: NDArray[np.floating]) -> Array:
    """Return low-passed values (realization, time) at places between the samples."""
    taps = decimation_weights(step, 2 * round(LOW_PASS_SAMPLES * step / 2) + 1)
    half = len(taps) // 2
    extended = np.pad(values, ((0, 0), (half, half)), "reflect", reflect_type="odd")
    smooth = scipy.signal.oaconvolve(extended, taps[None], mode="valid", axes=1)
    time = np.arange(values.shape[1])
    return np.asarray(scipy.interpolate.make_interp_spline(time, smooth, axis=1)(places))
