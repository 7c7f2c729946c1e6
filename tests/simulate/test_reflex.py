import numpy as np
import pytest
from tests.simulate.conftest import simulate

from tvsysid.simulate import ReflexJoint, StretchReflex


@pytest.mark.parametrize(
    "reflex",
    [
        StretchReflex(),
        StretchReflex(0.05, 10.0, 1.0, threshold=0.3, direction=-1),
        StretchReflex(delay=0.0),
    ],
)
def test_the_torque_obeys_its_equation(random, reflex):
    rate, time = 1e4, np.arange(30_000) / 1e4
    velocity = np.convolve(random.standard_normal(30_000), np.hanning(400), "same") / 10
    gain, frequency = 8 + 4 * np.sin(3 * time), reflex.frequency
    torque, late = reflex.torque(velocity, gain, rate), round(reflex.delay * rate)
    speed = np.maximum(reflex.direction * velocity - reflex.threshold, 0)
    stretch = reflex.direction * np.concatenate([np.zeros(late), speed])[: len(speed)]
    slope = np.gradient(torque, 1 / rate)
    found = np.gradient(slope, 1 / rate) + 2 * reflex.damping * frequency * slope
    error = found + frequency**2 * (torque - gain * stretch)
    assert np.std(error[10:-10]) < 5e-3 * np.std(frequency**2 * gain * stretch)


@pytest.mark.parametrize(("direction", "threshold"), [(1, 0.0), (-1, 0.1)])
def test_the_emg_is_what_arrives_at_the_muscle_10_ms_before_it_pulls(direction, threshold):
    reflex = StretchReflex(direction=direction, threshold=threshold)
    recording = simulate(ReflexJoint(reflex=reflex), 120.0).recording
    emg, velocity = recording.channels["emg"], np.gradient(recording.angle, 1e-3)
    stretch = np.maximum(direction * velocity - threshold, 0.0)
    assert emg.min() == 0.0
    assert not emg[30:][stretch[:-30] == 0.0][:1000].max() > 0.01 * emg.max()
    products = [np.dot(emg[late:-100], stretch[: -100 - late]) for late in range(100)]
    assert np.argmax(products) == pytest.approx(30, abs=3)
    assert max(products) / np.dot(stretch, stretch) == pytest.approx(1.0, abs=0.03)
