from functools import partial

import numpy as np
import pytest

from tvsysid.simulate import FilteredNoise, ReflexJoint, SineWave, StretchReflex


def simulate(system, duration=10.0, **settings):
    return system.simulate(
        duration, **({"perturbation": FilteredNoise(), "snr_db": 10.0, "seed": 1} | settings)
    )


def slowly(reflex, velocity, gain, rate):
    """Reflex torque sample by sample, by the trapezoidal rule."""
    late, state, before, torque = round(reflex.delay * rate), np.zeros(2), 0.0, []
    profile = reflex.frequency if callable(reflex.frequency) else lambda time: reflex.frequency
    for sample in range(len(velocity)):
        frequency = profile(sample / rate)
        system = np.array([[0.0, 1.0], [-(frequency**2), -2 * reflex.damping * frequency]])
        speed = reflex.direction * velocity[sample - late] if sample >= late else 0.0
        stretch = reflex.direction * max(speed - reflex.threshold, 0.0)
        force = stretch if reflex.gain_after else gain[sample] * stretch
        entry = np.array([0.0, frequency**2]) * (before + force)
        known = state + (system @ state + entry) / (2 * rate)
        state = np.linalg.solve(np.eye(2) - system / (2 * rate), known)
        before = force
        torque.append(state[0] * (gain[sample] if reflex.gain_after else 1))
    return np.array(torque)


@pytest.mark.parametrize(
    "reflex",
    [
        StretchReflex(),
        StretchReflex(0.05, 10.0, 1.0, threshold=0.3, direction=-1),
        StretchReflex(delay=0.0),
        StretchReflex(gain_after=True),
        StretchReflex(frequency=SineWave(16.0, 6.0, period=3.0)),
    ],
)
def test_reflex_torque_equals_a_plain_loop(random, reflex):
    velocity = np.convolve(random.standard_normal(3000), np.ones(20) / 20, "same")
    gain = 8 + 4 * np.sin(np.arange(3000) / 300)
    found, expected = (
        make(velocity, gain, 1000.0) for make in (reflex.torque, partial(slowly, reflex))
    )
    # A muscle that changes is solved exactly, which the trapezoidal rule is not.
    np.testing.assert_allclose(
        found, expected, atol=1e-10 if not callable(reflex.frequency) else 5e-4 * found.max()
    )


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
