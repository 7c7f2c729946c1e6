"""What one-path, open-loop methods make of systems that are neither.

Ranges from independent simulators.
"""

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.simulate import CompliantActuator, FilteredNoise, ReflexJoint, SineWave


def gain(time):
    return SineWave(8.0, 4.0)(np.asarray(time) + 0.5)


@pytest.mark.parametrize(
    ("system", "bandwidth", "snr_db", "low", "high"),
    [
        (ReflexJoint(SineWave(), reflex_gain=gain), 5.0, 10.0, 10.0, 18.0),
        (CompliantActuator(SineWave(), noise_bandwidth=5.0), 20.0, 5.0, -27.0, -16.0),
        (CompliantActuator(SineWave()), 20.0, 10.0, -3.0, -0.5),
    ],
    ids=["reflex", "slow noise in the loop", "wide noise in the loop"],
)
def test_stiffness_is_biased_by_what_the_method_does_not_know(system, bandwidth, snr_db, low, high):
    simulation = system.simulate(
        300.0, perturbation=FilteredNoise(bandwidth), snr_db=snr_db, seed=1000
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    ensemble = tv.preprocess.subtract_mean(ensemble)
    error = tv.BasisIRF().identify(ensemble).stiffness - simulation.truth_of(ensemble)[
        "stiffness"
    ].mean(axis=0)
    assert low < error.mean() < high
