import numpy as np
import pytest
from tests.simulate.conftest import simulate

import tvsysid as tv
from tvsysid.simulate import ScheduledJoint, SineWave, SquareWave


def rooted(activity):
    return 20 + 180 * np.sqrt(activity)


@pytest.mark.parametrize("stiffness", [SineWave(), SquareWave()])
def test_stiffness_is_the_relation_of_the_channel(stiffness):
    simulation = simulate(ScheduledJoint(stiffness, relation=rooted, variable="activity"), 20.0)
    (name,) = simulation.recording.channels
    assert name == "activity"
    np.testing.assert_array_equal(
        simulation.truth["stiffness"], rooted(simulation.recording.channels[name])
    )
    assert simulation.recording.channels[name].min() >= 0
    assert set(simulation.truth["viscosity"]) == {2.2}


def test_the_variable_differs_between_realizations_and_gives_the_profile_on_average():
    simulation = simulate(ScheduledJoint(), 2000.0, rate=200.0)
    ensemble = tv.preprocess.segment(simulation.recording, 2.0)
    stiffness = simulation.truth_of(ensemble)["stiffness"]
    np.testing.assert_allclose(stiffness.mean(axis=0), SineWave()(ensemble.time), rtol=0.03)
    activity = (SineWave()(ensemble.time) - 20) / 200
    # Strengths are drawn at -1, 1, 3, ... s, and linear in between
    late = (ensemble.time + 1) / 2 % 1
    expected = 200 * 0.3 * activity * np.hypot(late, 1 - late)
    np.testing.assert_allclose(stiffness.std(axis=0), expected, rtol=0.1)
    np.testing.assert_allclose(ensemble.channels["emg"][:, ensemble.core], (stiffness - 20) / 200)
