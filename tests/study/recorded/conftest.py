"""Small experiments that tests share."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import savemat

from tvsysid.study import Experiment, prepared_recordings, run

SMALL = {"virtual": 1, "methods": ["birf", "esm", "kbr"], "realizations": [10, 20], "bootstraps": 4}
READING = {"angle": "angle", "torque": "torque", "sampling_rate": 128}
SHORT = {"reference": None, "task_limit": None, "residual_limit": None, "ends": 1.0, "period": 2}
RATE, PERIOD = 128, 2.0


@pytest.fixture(scope="session")
def small():
    experiment = Experiment(**SMALL)
    prepared = prepared_recordings(experiment)
    results = run(experiment, prepared=prepared, workers=1)
    return SimpleNamespace(experiment=experiment, prepared=prepared, results=results)


def trial(seed=0, seconds=24.0, stiffness=80.0):
    """Angle and torque of a stiff joint at 128 Hz."""
    random = np.random.default_rng(seed)
    count = round(seconds * RATE)
    angle = np.convolve(random.standard_normal(count), np.hanning(9), mode="same") * 0.004
    return {"angle": angle, "torque": stiffness * angle + 0.02 * random.standard_normal(count)}


def write_trials(folder, count=3, **settings):
    """MAT files trial0.mat, trial1.mat, ..."""
    for number in range(count):
        savemat(folder / f"trial{number}.mat", trial(number, **settings))
