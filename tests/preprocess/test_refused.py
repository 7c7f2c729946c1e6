"""What no step can do is refused."""

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.preprocess import align, align_channels, bootstrap_weights, decimate, segment
from tvsysid.preprocess import subtract_mean as subtract

ANGLE, TORQUE = np.random.default_rng(1).normal(size=(2, 1000))
RECORDING = tv.Recording(ANGLE, TORQUE, 100.0, channels={"target": TORQUE + 1})
ENSEMBLE = segment(RECORDING, 1.0)
ALIKE = tv.Ensemble(np.tile(ANGLE[:50], (7, 1)), TORQUE[:350].reshape(7, 50), 100.0)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (lambda: align(ENSEMBLE, "goal"), "there is no 'goal'"),
        (lambda: align(ENSEMBLE, "target", 1.5), "1.5 s need that much context, but .* have 0.5 s"),
        (lambda: align(ENSEMBLE, "target", 0.5, -1.0), "every realization needs a shift of more"),
        (lambda: bootstrap_weights(20, 5, 2, -1), "seed must be a whole number of 0 or more"),
        (lambda: bootstrap_weights(20, 40, 2, 0, True), "a block of 40 .* cannot be drawn from 20"),
        (lambda: decimate(RECORDING, 30.0), "whole multiple of 30 Hz; the nearest .* is 25 Hz"),
        (lambda: decimate(RECORDING, 0.0), "rate must be a positive number"),
        (lambda: decimate(RECORDING, 2.0, sharp=True), "1000 samples is shorter than the filter's"),
        (lambda: align_channels(RECORDING, np.nan), "a finite number"),
        (lambda: align_channels(RECORDING, 19.0), "no sample is left of a trial of 10 s"),
        (lambda: segment(RECORDING, 20.0), "of 20 s with 0.5 s of .* fits into a trial of 10 s"),
        (lambda: segment(RECORDING, 1.005), "1.005 s is not a whole number of samples at 100 Hz"),
        (lambda: segment(RECORDING, None, 6.0), "no realization with 6 s of context"),
        (lambda: segment(RECORDING, 2.0, -1.0), "context must be a number of zero or more"),
        (lambda: subtract(ENSEMBLE.select([0])), "at least two realizations, got Ensemble"),
        (lambda: subtract(ALIKE), "the angle is the same in all 7"),
    ],
)
def test_what_is_impossible_is_refused(step, message):
    with pytest.raises(tv.InputError, match=message):
        step()
