import numpy as np
import pytest

import tvsysid as tv
from tvsysid.simulate import FilteredNoise, Joint, ReflexJoint, SineWave, StretchReflex


def simulate(system, duration=10.0, **settings):
    return system.simulate(duration, **({"perturbation": FilteredNoise(), "snr_db": 10.0, "seed": 1} | settings))


def slowly(reflex, velocity, gain, rate):
    """Reflex torque sample by sample: late, beyond the threshold, through the muscle by the trapezoidal rule."""
    system = np.array([[0.0, 1.0], [-(reflex.frequency**2), -2 * reflex.damping * reflex.frequency]])
    entry, late = np.array([0.0, reflex.frequency**2]), round(reflex.delay * rate)
    state, before, torque = np.zeros(2), 0.0, []
    for sample in range(len(velocity)):
        speed = reflex.direction * velocity[sample - late] if sample >= late else 0.0
        force = reflex.direction * gain[sample] * max(speed - reflex.threshold, 0.0)
        known = state + (system @ state + entry * (before + force)) / (2 * rate)
        state = np.linalg.solve(np.eye(2) - system / (2 * rate), known)
        before = force
        torque.append(state[0])
    return np.array(torque)


@pytest.mark.parametrize(
    "reflex",
    [StretchReflex(), StretchReflex(0.05, 10.0, 1.0, threshold=0.3, direction=-1), StretchReflex(delay=0.0)],
)
def test_reflex_torque_equals_a_plain_loop(random, reflex):
    velocity = np.convolve(random.standard_normal(3000), np.ones(20) / 20, "same")
    gain = 8 + 4 * np.sin(np.arange(3000) / 300)
    np.testing.assert_allclose(
        reflex.torque(velocity, gain, 1000.0), slowly(reflex, velocity, gain, 1000.0), atol=1e-10
    )


def test_the_gain_is_that_of_steady_stretch():
    torque = StretchReflex(threshold=0.1).torque(np.full(5000, 0.5), 8.0, 1000.0)
    assert torque[-1] == pytest.approx(8.0 * 0.4)
    assert not torque[:40].any()


def test_a_joint_with_a_reflex_is_a_joint_and_its_reflex():
    plain, joint = simulate(Joint(SineWave()), snr_db=np.inf), ReflexJoint(SineWave(), reflex_gain=SineWave(8.0, 4.0))
    simulation = simulate(joint, snr_db=np.inf)
    np.testing.assert_array_equal(simulation.recording.angle, plain.recording.angle)
    np.testing.assert_array_equal(simulation.pathways["intrinsic"], plain.pathways["intrinsic"])
    np.testing.assert_array_equal(simulation.recording.torque, sum(simulation.pathways.values()))
    time = simulation.recording.time
    np.testing.assert_allclose(simulation.truth["reflex_gain"], SineWave(8.0, 4.0)(time), atol=1e-9)
    # The recording's own velocity, by differences; the second before it is forgotten after another.
    velocity = np.gradient(simulation.recording.angle, 1e-3)
    expected = slowly(StretchReflex(), velocity, simulation.truth["reflex_gain"], 1000.0)
    found = simulation.pathways["reflex"]
    assert np.std((found - expected)[1000:]) < 2e-3 * np.std(found)
    assert np.abs(found[:100]).max() > 0.05 * found.max()  # it does not start from rest


def test_without_gain_all_is_as_without_a_reflex():
    none = simulate(ReflexJoint(reflex_gain=0.0))
    assert not none.pathways["reflex"].any()
    np.testing.assert_array_equal(none.recording.torque, simulate(Joint()).recording.torque)


@pytest.mark.parametrize(
    ("create", "message"),
    [
        (lambda: StretchReflex(delay=-0.01), "delay must be a number of zero or more, got -0.01"),
        (lambda: StretchReflex(threshold=np.nan), "threshold must be a number of zero or more"),
        (lambda: StretchReflex(frequency=0.0), "frequency must be a positive number"),
        (lambda: StretchReflex(direction=2), "direction must be 1 or -1, got 2"),
        (lambda: ReflexJoint(reflex_gain="strong"), "reflex_gain must be a finite number or a callable of time"),
        (lambda: ReflexJoint(reflex=0.04), "reflex must be a StretchReflex, got 0.04"),
        (lambda: simulate(ReflexJoint(reflex_gain=lambda time: 8.0)), r"ReflexJoint: reflex_gain .* of shape \(\)"),
    ],
)
def test_settings_that_make_no_sense_are_refused(create, message):
    with pytest.raises(tv.InputError, match=message):
        create()
