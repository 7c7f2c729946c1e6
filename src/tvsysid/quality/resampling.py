"""An ensemble at some 100 Hz."""

from __future__ import annotations

import math

import attrs
import numpy as np
import scipy

from tvsysid.numerics.decimation import decimation_weights
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.preprocess.trials import decimate, map_signals
from tvsysid.signals import Array, Ensemble, Recording

LOWEST_RATE = 100.0  # in Hz; what is above is taken down to it or little more
SHORTEST = 30  # samples of a realization whose derivatives must be known
# samples of the lower rate that a low-pass is long if the rate does not divide, as that to a tenth
# is
TAPS = 3


def known_region(samples: int, context: int) -> slice:
    """Return the samples of an ensemble, context counted, whose derivatives are known.

    These are all samples but those at the edges of a record.
    """
    margin = max(context, HALF_WIDTH)
    return slice(margin, max(margin, samples + min(context, 2 * context - HALF_WIDTH)))


def known_samples(samples: int, context: int) -> int:
    """How many samples of a realization these are."""
    region = known_region(samples, context)
    return int(region.stop - region.start)


def lowered(ensemble: Ensemble) -> Ensemble:
    """Ensemble at some 100 Hz, at which a realization is a whole number of samples.

    Where the samples of realization and context share a factor, that is the decimation of
    :func:`tvsysid.preprocess.decimate`; where they do not, its low-pass, and samples between the
    old ones.
    """
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    factors = [
        factor
        for factor in range(2, int(rate / LOWEST_RATE) + 1)
        if math.gcd(samples, context) % factor == 0
        and known_samples(samples // factor, context // factor) >= SHORTEST
    ]
    factor = factors[-1] if factors else 1
    if rate / factor > 2 * LOWEST_RATE and (between_samples := _resampled(ensemble)) is not None:
        return between_samples
    if factor == 1:
        return ensemble
    # Every realization is filtered by itself, as a trial is.
    starts = tuple(range(0, ensemble.angle.size, samples + 2 * context))
    recorded = None if ensemble.recorded_angle is None else np.concatenate(ensemble.recorded_angle)
    channels = {name: values.ravel() for name, values in ensemble.channels.items()}
    angle, torque = ensemble.angle.ravel(), ensemble.torque.ravel()
    whole = Recording(
        angle, torque, rate, channels=channels, trial_starts=starts, recorded_angle=recorded
    )
    low = decimate(whole, rate / factor)
    assert low.recorded_angle is not None
    lower = map_signals(
        attrs.evolve(low, recorded_angle=None), lambda values: values.reshape(len(ensemble), -1)
    )
    lower["recorded_angle"] = low.recorded_angle.reshape(*lower["angle"].shape, -1)
    return attrs.evolve(ensemble, **lower, sampling_rate=rate / factor, context=context // factor)


def _resampled(ensemble: Ensemble) -> Ensemble | None:
    """Ensemble at a lower rate that does not divide its own.

    None if realizations are too short for that.
    """
    samples, context, rate = ensemble.samples, ensemble.context, ensemble.sampling_rate
    for count in range(math.ceil(samples * LOWEST_RATE / rate), samples // 2 + 1):
        margin = context * count // samples
        if known_samples(count, margin) >= SHORTEST:
            break
    else:
        return None
    step = samples / count
    places = context + step * np.arange(-margin, count + margin)
    taps = decimation_weights(step, 2 * round(TAPS * step / 2) + 1)
    half = len(taps) // 2

    def lower(values: Array) -> Array:
        extended = np.pad(values, ((0, 0), (half, half)), "reflect", reflect_type="odd")
        smooth = scipy.signal.oaconvolve(extended, taps[None], mode="valid", axes=1)
        return np.asarray(
            scipy.interpolate.make_interp_spline(np.arange(values.shape[1]), smooth, axis=1)(places)
        )

    signals = map_signals(attrs.evolve(ensemble, recorded_angle=None), lower)
    return attrs.evolve(ensemble, **signals, context=margin, sampling_rate=rate / step)
