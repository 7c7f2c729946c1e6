"""Real human ankles: what every method must find in them."""

import numpy as np
import pytest

import tvsysid as tv

MUSCLES = ("plantarflexor", "dorsiflexor", "dorsiflexor_2")
# Time-averaged stiffness by independent fits.
EXPECTED = {"plantarflexor": (107, 112), "dorsiflexor": (100, 105), "dorsiflexor_2": (55, 61)}


def read(file, angle, torque, period):
    recording = tv.read_recording(file, angle=angle, torque=torque, sampling_rate=1000, torque_sign=-1)
    return tv.preprocess.subtract_mean(tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period))


def tonic(folder, muscle, period=2.0):
    return read(folder / "tonic_ankle.mat", f"{muscle}_angle", f"{muscle}_torque", period)


@pytest.fixture(scope="module")
def walking(recordings_folder):
    return read(recordings_folder / "walking_ankle_small_reflex.mat", "POSITION_SIGNAL", "TORQUE_SIGNAL", 1.5)


@pytest.mark.parametrize("key", ["sds", "birf", "esm", "kbr"])
@pytest.mark.parametrize("muscle", MUSCLES)
def test_tonic_stiffness_is_flat_and_as_expected(recordings_folder, muscle, key):
    model = tv.methods.create(key).identify(tonic(recordings_folder, muscle))
    low, high = EXPECTED[muscle]
    # The range is that of methods, not of the joint: a tenth beyond it is still the same joint.
    assert 0.95 * low < model.stiffness.mean() < 1.05 * high
    # Strong reflexes make the plantarflexors' torque vary from realization to realization.
    allowed = 0.25 if muscle == "plantarflexor" else 0.1
    assert model.stiffness.std() / model.stiffness.mean() < allowed
