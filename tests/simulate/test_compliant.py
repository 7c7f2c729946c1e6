import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tvsysid.simulate import (
    PERTURBATIONS,
    CompliantActuator,
    FilteredNoise,
    SineWave,
)

perturbed = pytest.mark.parametrize("perturbation", PERTURBATIONS)


def simulate(system, duration=10.0, **settings):
    return system.simulate(
        duration, **({"perturbation": FilteredNoise(), "snr_db": 10.0, "seed": 1} | settings)
    )


@perturbed
def test_the_loop_obeys_both_equations(perturbation):
    # Angle, torque and reference as recorded; derivatives by differences.
    system = CompliantActuator(SineWave(), actuator_stiffness=150.0, actuator_inertia=0.04)
    simulation = simulate(system, perturbation=PERTURBATIONS[perturbation], snr_db=5.0, rate=8000.0)
    recording = simulation.recording
    angle, torque, reference = recording.angle, recording.torque, recording.channels["disturbance"]
    velocity = np.gradient(angle, 1 / 8000)
    moved = (
        0.04 * np.gradient(velocity, 1 / 8000)
        + 1.4 * math.sqrt(150 * 0.04) * velocity
        + 150 * (angle - reference)
    )
    # The acceleration that a PRBS imposes jumps, which differences smear.
    limit = {"noise": 2e-3, "prbs": 5e-3, "pulses": 5e-3, "multisine": 2e-3}[perturbation]
    assert np.std((moved + torque)[10:-10]) < limit * np.std(torque)


LOADS = {"elastic": (30.0, None, 0.05), "viscous": (0.0, 3.0, 0.0), "inertial": (0.0, 0.0, 0.2)}


@pytest.mark.parametrize("load", LOADS)
def test_a_torque_on_a_load_equals_the_differential_equation(load):
    # Torque and noise as recorded, linear between samples. The stiffness switches twice in 2 s.
    stiffness, viscosity, inertia = LOADS[load]
    system = CompliantActuator(
        actuator_stiffness=stiffness,
        actuator_viscosity=viscosity,
        actuator_inertia=inertia,
        noise_bandwidth=5.0,
        disturbance="torque",
    )
    simulation = simulate(system, 2.0, perturbation=FilteredNoise(20.0), snr_db=5.0)
    recording, time = simulation.recording, simulation.recording.time
    noise = recording.torque - simulation.noiseless.torque
    viscosity = 1.4 * math.sqrt(stiffness * inertia) if viscosity is None else viscosity
    force = recording.channels["disturbance"] - noise

    def slope(t, state):
        whole, part = divmod(1000 * t, 1)
        now, then = force[1000 + int(whole) : 1002 + int(whole)]
        own = stiffness + (150 if 0.5 <= t < 1.5 else 50)
        net = now + part * (then - now) - (2.2 + viscosity) * state[1] - own * state[0]
        return [state[1], net / (0.02 + inertia)]

    inside, angle = slice(1000, 3001), recording.angle
    velocity = (angle[998] - 8 * angle[999] + 8 * angle[1001] - angle[1002]) / 12e-3
    state = [angle[1000], velocity]
    # It steps from sample to sample, so that no finer tolerance is needed.
    found = solve_ivp(slope, (0, 2), state, t_eval=time[inside], rtol=1e-6, max_step=1e-3).y[0]
    assert np.std(found - angle[inside]) < 1e-3 * np.std(angle)


def test_the_disturbance_alone_moves_the_angle_by_half_a_degree():
    quiet, loud = (simulate(CompliantActuator(), 40.0, snr_db=snr_db) for snr_db in (np.inf, 0.0))
    inside = slice(1000, 41_000)
    assert np.sqrt(np.mean(quiet.recording.angle[inside] ** 2)) == pytest.approx(math.radians(0.5))
    noise = loud.recording.torque - loud.noiseless.torque
    assert np.std(noise[inside]) == pytest.approx(np.std(quiet.recording.torque[inside]))
