"""The simulation study's figures, against those of two independent implementations.

They hold the drive of the actuator over each sample, which puts inertia and viscosity into the torque that are not in
the truth, and so, at the same signal-to-noise ratio, more noise (docs/simulation.md). Their random errors are
compared after taking that off.
"""

import numpy as np
import pytest
from scipy.signal import bessel, cont2discrete, dlsim
from tests.conftest import PERTURBATIONS

from tvsysid.benchmark import Study, run, summarize

# Lowest and highest bias, random error (N·m/rad) and rise time (s) at 150 s.
INDEPENDENT = {
    ("noise", "eirf"): (4.8, 5.5, 9.4, 9.7, 0.01, 0.01),
    ("noise", "sds"): (9.6, 9.7, 3.1, 3.1, 0.09, 0.09),
    ("noise", "birf"): (15.4, 15.7, 1.5, 1.7, 0.21, 0.21),
    ("noise", "esm"): (10.9, 11.2, 4.1, 4.1, 0.12, 0.12),
    ("noise", "kbr"): (10.4, 11.7, 1.6, 1.9, 0.09, 0.13),
    ("prbs", "eirf"): (4.5, 5.4, 11.4, 11.4, 0.01, 0.01),
    ("prbs", "sds"): (9.6, 9.8, 4.1, 4.1, 0.09, 0.09),
    ("prbs", "birf"): (15.5, 15.7, 1.8, 2.0, 0.21, 0.21),
    ("prbs", "esm"): (11.3, 11.3, 3.0, 3.0, 0.12, 0.12),
    ("prbs", "kbr"): (10.7, 12.0, 2.2, 2.6, 0.13, 0.13),
}


def torque_power(perturbation, method):
    """Mean square of the torque of a joint with stiffness 100 N·m/rad for an angle of unit RMS."""
    _, (_, damping, stiffness) = bessel(2, 2 * np.pi * 40, analog=True, norm="phase")
    system = np.array([[0, 1], [-stiffness, -damping]]), np.array([[0], [stiffness]])
    # Acceleration is the derivative of the second state; stiffness 100, viscosity 2.2, inertia 0.02.
    torque_row = np.array([100, 2.2]) + 0.02 * system[0][1]
    output = np.array([[1, 0], torque_row]), np.array([[0], [0.02 * stiffness]])
    discrete = cont2discrete((*system, *output), 1e-3, method=method)
    drive = PERTURBATIONS[perturbation].generate(200_000, 1000.0, np.random.default_rng(0))
    _, signals, _ = dlsim(discrete, drive)
    angle, torque = signals[2000:].T
    return np.mean(torque**2) / np.mean(angle**2)


@pytest.fixture(scope="module")
def found():
    return (
        summarize(run(Study(trials=40), workers=1)).set_index(["perturbation", "method", "metric"]).sort_index().value
    )


@pytest.mark.parametrize(("perturbation", "method"), INDEPENDENT)
def test_errors_are_within_a_tenth(found, perturbation, method):
    low_bias, high_bias, low_random, high_random, quick, slow = INDEPENDENT[perturbation, method]
    cell = found[perturbation, method]
    assert 0.9 * low_bias < cell["bias_error"] < 1.1 * high_bias
    assert quick - 0.021 < cell["rise_time"] < slow + 0.021
    excess = np.sqrt(torque_power(perturbation, "zoh") / torque_power(perturbation, "foh"))
    assert 1.05 < excess < 1.25
    assert 0.9 * low_random < cell["random_error"] * excess < 1.1 * high_random


@pytest.mark.parametrize(("perturbation", "method"), INDEPENDENT)
def test_vaf_is_above_85_per_cent(found, perturbation, method):
    assert found[perturbation, method, "lowest_vaf"] > 85
