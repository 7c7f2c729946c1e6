"""`tvsysid simulate` with every system, and with parts of one's own."""

import numpy as np
import pytest
from scipy.io import loadmat

import tvsysid as tv

OWN = """
import numpy as np
import tvsysid as tv


class Steps:
    period = 4.0

    def __call__(self, time):
        return np.where(time % 4.0 < 2.0, 60.0, 90.0)


def broken(time):
    return 1 / 0


class Hum:
    def generate(self, samples, rate, random):
        return np.sin(2 * np.pi * np.cumsum(3 + random.random(samples)) / rate)


class Empty:
    def simulate(self, duration, **settings):
        return 3


class Rigid:
    def simulate(self, duration, **settings):
        return tv.simulate.Joint(stiffness=tv.simulate.Constant(400.0)).simulate(
            duration, **settings
        )
"""
COMMON = {"angle", "torque", "noiseless_torque", "stiffness", "viscosity", "inertia"}


@pytest.fixture
def simulate(tvsysid, tmp_path, monkeypatch):
    """Simulate 8 s; return output and signals, or the error."""
    (tmp_path / "own_systems.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)

    def command(options):
        code, out, err = tvsysid(f"simulate joint.mat --duration 8 --overwrite {options}")
        if code:
            assert (code, err.count("\n")) == (2, 1)
            return err
        signals = loadmat("joint.mat").items()
        return out, {name: each.ravel() for name, each in signals if not name.startswith("__")}

    return command


@pytest.mark.parametrize(
    ("name", "further"),
    [
        ("joint", set()),
        ("reflex", {"emg", "torque_intrinsic", "torque_reflex", "reflex_gain"}),
        ("compliant", {"disturbance"}),
        ("scheduled", {"emg"}),
    ],
)
def test_the_file_holds_channels_and_truth_of_the_system(simulate, name, further):
    out, signals = simulate(f"--system {name} --seed 3")
    assert set(signals) == COMMON | {"sampling_rate"} | further
    simulation = tv.simulate.SYSTEMS[name].simulate(
        8, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=3
    )
    inner = slice(1000, 9000)
    np.testing.assert_array_equal(signals["stiffness"], simulation.truth["stiffness"][inner])
    np.testing.assert_array_equal(signals["torque"], simulation.recording.torque[inner])
    # What is printed can be typed: channels are named.
    for channel in simulation.recording.channels:
        assert f"--channel {channel}={channel}" in out
    assert ("--scheduling emg" in out) == (name == "scheduled")
    assert ("--method kbr:reference=disturbance" in out) == (name == "compliant")


@pytest.mark.parametrize(
    ("options", "name", "values"),
    [
        (
            "--stiffness own_systems:Steps --perturbation own_systems:Hum",
            "stiffness",
            {60.0, 90.0},
        ),
        (
            "--system reflex-sine:inertia=0.03 --perturbation pulses:duration=0.1",
            "inertia",
            {0.03},
        ),
        ("--system own_systems:Rigid", "stiffness", {400.0}),
    ],
)
def test_ones_own_profile_perturbation_and_system(simulate, options, name, values):
    out, signals = simulate(options)
    assert set(signals[name]) == values
    assert f"--period {4 if 'Steps' in options else 2}" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--stiffness step", "unknown profile 'step'; expected one of square, sine, constant, or"),
        ("--system own_systems:Empty", "'int' object has no attribute 'recording'"),
        ("--system own_systems:Rigid --stiffness sine", "has no setting stiffness; set it there"),
        (
            "--stiffness own_systems:broken",
            "system joint: ZeroDivisionError: division by zero (own_systems.py",
        ),
    ],
)
def test_errors_say_what_was_expected(simulate, options, message):
    assert message in simulate(options)


def test_a_file_that_exists_is_kept_unless_told(tvsysid, tmp_path):
    command, file = "simulate joint.csv --duration 4", tmp_path / "joint.csv"
    assert tvsysid(command)[0] == 0
    before = file.read_bytes()
    code, _, err = tvsysid(f"{command} --seed 1")
    assert code == 2
    assert "joint.csv exists already; give another name, or --overwrite" in err
    assert file.read_bytes() == before
