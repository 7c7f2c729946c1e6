"""Settings of systems that make no sense are refused."""

from functools import partial

import numpy as np
import pytest
from tests.simulate.conftest import simulate

import tvsysid as tv
from tvsysid.simulate import (
    CompliantActuator,
    Constant,
    Joint,
    Multisine,
    ScheduledJoint,
    StretchReflex,
)

joint = partial(simulate, Joint())


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: joint(duration=0.0), "duration must be a positive number, got 0.0"),
        (lambda: joint(perturbation="prbs"), "perturbation must be FilteredNoise, PRBS"),
        (lambda: joint(rate=50.0), "rate must be a number of hertz above 80 Hz, got 50.0"),
        (lambda: joint(snr_db=np.nan), "snr_db must be a number of decibels"),
        (lambda: joint(perturbation=Multisine((1.0, 600.0))), "below half the sampling rate"),
        (lambda: Joint(stiffness=100.0), "stiffness must be a callable"),
        (lambda: Joint(viscosity=np.nan), "viscosity must be a finite number or a callable"),
        (lambda: StretchReflex(delay=-0.01), "delay must be a number of zero or more, got -0.01"),
        (lambda: simulate(ScheduledJoint(relation=lambda emg: -emg)), "relation must rise from 0"),
        (lambda: simulate(ScheduledJoint(Constant(500.0))), "cover the stiffness of 500 to 500"),
        (lambda: CompliantActuator(actuator_stiffness=0.0), "must be a positive number"),
        (lambda: CompliantActuator(disturbance="force"), "must be one of 'angle', 'torque', got"),
    ],
)
def test_what_makes_no_sense_is_refused(act, message):
    with pytest.raises(tv.InputError, match=message):
        act()
