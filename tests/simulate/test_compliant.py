import math

import numpy as np
import pytest
from tests.simulate.conftest import simulate

from tvsysid.simulate import (
    PERTURBATIONS,
    CompliantActuator,
    SineWave,
)

# Stiffness, viscosity (None for 0.7 of critical damping) and inertia of the load
LOADS = {
    "actuator": (150.0, None, 0.04, "angle"),
    "elastic": (30.0, None, 0.05, "torque"),
    "viscous": (0.0, 3.0, 0.0, "torque"),
    "inertial": (0.0, 0.0, 0.2, "torque"),
}


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("perturbation", PERTURBATIONS)
def test_the_load_obeys_its_equation(load, perturbation):
    # Angle, torque and disturbance as recorded; derivatives by differences.
    stiffness, viscosity, inertia, disturbance = LOADS[load]
    system = CompliantActuator(SineWave(), 2.2, 0.02, *LOADS[load])
    simulation = simulate(system, perturbation=PERTURBATIONS[perturbation], snr_db=5.0, rate=8000.0)
    recording = simulation.recording
    given = recording.channels["disturbance"] * (stiffness if disturbance == "angle" else 1.0)
    velocity = np.gradient(recording.angle, 1 / 8000)
    damping = 1.4 * math.sqrt(stiffness * inertia) if viscosity is None else viscosity
    moved = inertia * np.gradient(velocity, 1 / 8000) + damping * velocity
    moved += stiffness * recording.angle + recording.torque - given
    # The acceleration jumps where a PRBS does, which differences smear over two samples.
    assert np.quantile(np.abs(moved[10:-10]), 0.99) < 5e-3 * np.std(recording.torque)


def test_the_disturbance_alone_moves_the_angle_by_half_a_degree():
    quiet, loud = (simulate(CompliantActuator(), 40.0, snr_db=snr_db) for snr_db in (np.inf, 0.0))
    inside = slice(1000, 41_000)
    assert np.sqrt(np.mean(quiet.recording.angle[inside] ** 2)) == pytest.approx(math.radians(0.5))
    noise = loud.recording.torque - loud.noiseless.torque
    assert np.std(noise[inside]) == pytest.approx(np.std(quiet.recording.torque[inside]))
