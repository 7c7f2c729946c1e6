"""What bootstraps of one recording say of the random error, against many simulated recordings."""

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.preprocess import bootstrap_weights

METHODS = {key: tv.methods.parse(key) for key in ("eirf", "sds", "birf", "esm", "kbr")}
TRIALS, DRAWS, MANY, FEW = 50, 50, 75, 20


def simulated(seconds, seed):
    simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
        seconds, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=seed
    )
    return tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)


@pytest.fixture(scope="module")
def recordings():
    return [simulated(2.0 * MANY, 1000 + number) for number in range(TRIALS)]


@pytest.fixture(scope="module")
def long_recordings():
    return [simulated(600.0, number) for number in range(2)]


@pytest.mark.slow
@pytest.mark.parametrize("key", METHODS)
def test_bootstraps_of_a_recording_vary_as_recordings_do(key, recordings, long_recordings):
    method, in_one_piece = METHODS[key], key == "kbr"
    size = FEW if in_one_piece else MANY
    true = [method.identify(ensemble.select(np.arange(size))).stiffness for ensemble in recordings]
    spread = np.sqrt(np.var(true, axis=0, ddof=1).mean())
    told = []
    for ensemble in long_recordings:
        count = len(ensemble)
        weights = bootstrap_weights(count, size, DRAWS, 5, in_one_piece)
        drawn = [
            method.identify(ensemble.select(np.repeat(np.arange(count), each))).stiffness
            for each in weights
        ]
        told.append(np.sqrt(np.var(drawn, axis=0, ddof=1).mean()))
    assert np.mean(told) == pytest.approx(spread, rel=0.2)
