"""What bootstraps of one recording say of the random error, against many simulated recordings."""

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.preprocess import bootstrap_weights

TRIALS, DRAWS, MANY, FEW = 50, 50, 75, 20


def spread_of(method, ensembles):
    found = [method.identify(ensemble).stiffness for ensemble in ensembles]
    return np.sqrt(np.var(found, axis=0, ddof=1).mean())


@pytest.mark.slow
@pytest.mark.parametrize("key", tv.methods.PAPER_METHODS)
def test_bootstraps_of_a_recording_vary_as_recordings_do(key):
    method, in_one_piece = tv.methods.parse(key), key == "kbr"
    size = FEW if in_one_piece else MANY
    recordings = (ensemble_of(2.0 * MANY, seed=1000 + number) for number in range(TRIALS))
    spread = spread_of(method, (each.select(np.arange(size)) for each in recordings))
    told = []
    for ensemble in (ensemble_of(600.0, seed=number) for number in range(2)):
        every = np.arange(len(ensemble))
        weights = bootstrap_weights(len(ensemble), size, DRAWS, 5, in_one_piece)
        drawn = (ensemble.select(np.repeat(every, each)) for each in weights)
        told.append(spread_of(method, drawn))
    assert np.mean(told) == pytest.approx(spread, rel=0.2)
