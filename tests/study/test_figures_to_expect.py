"""The simulation study's figures, against those of two independent implementations.

They hold the drive of the actuator over each sample, which puts inertia and viscosity into the
torque that are not in the truth, and so, at the same signal-to-noise ratio, more noise
(docs/simulation.md). Done in their way, the study must give their figures; done in ours, their
biases and rise times, and no higher random errors."""

import sys

import numpy as np
import pytest
from scipy.signal import bessel, cont2discrete, lfilter, ss2tf

from tvsysid.methods import PAPER_METHODS
from tvsysid.study import Study, run, score, summarize

pytestmark = pytest.mark.slow

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


def study_figures(trials):
    table = summarize(score(run(Study(methods=PAPER_METHODS, trials=trials), workers=1)))
    return table.set_index(["perturbation", "method", "metric"]).sort_index().value


def actuate_held_drive(drive, rate):
    """Return angle, velocity and acceleration behind the actuator.

    The drive is held over each sample.
    """
    _, (_, damping, stiffness) = bessel(2, 2 * np.pi * 40, analog=True, norm="phase")
    system = (
        np.array([[0, 1], [-stiffness, -damping]]),
        np.array([[0], [stiffness]]),
        np.eye(2),
        np.zeros((2, 1)),
    )
    numerators, denominator = ss2tf(*cont2discrete(system, 1 / rate, method="zoh")[:4])
    position, velocity = (lfilter(numerator, denominator, drive) for numerator in numerators)
    acceleration = stiffness * (drive - position) - damping * velocity
    return np.stack([position, velocity, acceleration])


@pytest.fixture(scope="module")
def ours():
    return study_figures(20)


@pytest.fixture(scope="module")
def theirs():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys.modules["tvsysid.simulate.joint"], "actuate", actuate_held_drive)
        return study_figures(20)


def failures(table, least_random, most_random):
    """Cells whose bias, random error or rise time is not that of the other implementations."""
    for cell, (low_bias, high_bias, low_random, high_random, quick, late) in INDEPENDENT.items():
        found = [table[*cell, metric] for metric in ("bias_error", "random_error", "rise_time")]
        limits = [
            (0.9 * low_bias, 1.1 * high_bias),
            (least_random * low_random, most_random * high_random),
            (quick - 0.021, late + 0.021),
        ]
        if not all(low < value < high for value, (low, high) in zip(found, limits, strict=True)):
            yield cell, found, limits


def test_with_the_drive_held_errors_are_theirs_within_a_tenth(theirs):
    assert list(failures(theirs, 0.9, 1.1)) == []


def test_in_our_way_random_errors_are_no_higher(ours):
    """Biases and rise times are theirs, random errors no higher, and VAFs above 85 %."""
    assert list(failures(ours, 0.75, 1.05)) == []
    assert {
        cell: ours[*cell, "lowest_vaf"]
        for cell in INDEPENDENT
        if not ours[*cell, "lowest_vaf"] > 85
    } == {}
