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


class Short:
    def generate(self, samples, rate, random):
        return np.zeros(3)


class Empty:
    def simulate(self, duration, **settings):
        return 3


class Rigid:
    def simulate(self, duration, *, perturbation, snr_db, seed, rate=1000.0):
        return tv.simulate.Joint(stiffness=tv.simulate.Constant(400.0)).simulate(
            duration, perturbation=perturbation, snr_db=snr_db, seed=seed, rate=rate
        )
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "own_systems.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize(
    ("name", "further"),
    [
        ("joint", set()),
        ("reflex", {"emg", "torque_intrinsic", "torque_reflex", "reflex_gain"}),
        ("compliant", {"disturbance"}),
        ("scheduled", {"emg"}),
    ],
)
def test_the_file_holds_channels_and_truth_of_the_system(tvsysid, name, further):
    code, out, err = tvsysid(f"simulate joint.mat --system {name} --duration 8 --seed 3")
    assert (code, err) == (0, "")
    signals = {
        name: values for name, values in loadmat("joint.mat").items() if not name.startswith("__")
    }
    usual = {
        "angle",
        "torque",
        "noiseless_torque",
        "stiffness",
        "viscosity",
        "inertia",
        "sampling_rate",
    }
    assert set(signals) == usual | further
    simulation = tv.simulate.SYSTEMS[name].simulate(
        8, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=3
    )
    np.testing.assert_array_equal(
        signals["stiffness"].ravel(), simulation.truth["stiffness"][1000:9000]
    )
    np.testing.assert_array_equal(signals["torque"].ravel(), simulation.recording.torque[1000:9000])
    # What is printed can be typed: channels are named.
    for channel in simulation.recording.channels:
        assert f"--channel {channel}={channel}" in out
    assert ("--scheduling emg" in out) == (name == "scheduled")
    assert ("--method kbr:reference=disturbance" in out) == (name == "compliant")


@pytest.mark.usefixtures("own")
def test_ones_own_profile_perturbation_and_system(tvsysid):
    code, out, err = tvsysid(
        "simulate joint.mat --stiffness own_systems:Steps --perturbation own_systems:Hum "
        "--duration 8"
    )
    assert (code, err) == (0, "")
    assert "--period 4" in out
    assert set(np.unique(loadmat("joint.mat")["stiffness"])) == {60.0, 90.0}
    system = "tvsysid.simulate:ReflexJoint:inertia=0.03"
    code, _, _ = tvsysid(f"simulate reflex.mat --system {system} --stiffness sine --duration 8")
    assert code == 0
    assert set(np.unique(loadmat("reflex.mat")["inertia"])) == {0.03}
    options = "--system reflex-sine:inertia=0.03 --perturbation pulses:duration=0.1 --duration 8"
    assert tvsysid(f"simulate pulses.mat {options}")[0] == 0
    pulses = loadmat("pulses.mat")
    assert (pulses["inertia"] == 0.03).all()
    assert np.ptp(pulses["reflex_gain"]) == pytest.approx(8.0)
    assert tvsysid("simulate rigid.mat --system own_systems:Rigid --duration 8")[0] == 0
    assert set(np.unique(loadmat("rigid.mat")["stiffness"])) == {400.0}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "--system arm",
            "unknown system 'arm'; expected one of joint, reflex, reflex-sine,",
        ),
        (
            "--stiffness step",
            "unknown profile 'step'; expected one of square, sine, constant, or",
        ),
        (
            "--perturbation pink",
            "unknown perturbation 'pink'; expected one of noise, prbs, pulses, multisine, or",
        ),
        ("--system own_systems:Hum", "Hum has no simulate"),
        ("--perturbation own_systems:Short", "each sample, shape (11000,); got shape (3,)"),
        (
            "--system own_systems:Empty",
            "simulate must return a tvsysid.simulate.Simulation, got int",
        ),
        (
            "--system own_systems:Rigid --stiffness sine",
            "has no setting stiffness; set it there",
        ),
        (
            "--stiffness own_systems:broken",
            "system joint: ZeroDivisionError: division by zero (own_systems.py",
        ),
    ],
)
def test_errors_say_what_was_expected(tvsysid, options, message):
    code, _, err = tvsysid(f"simulate joint.mat {options} --duration 8")
    assert code == 2
    assert message in err
    assert err.count("\n") == 1


def test_a_file_that_exists_is_kept_unless_told(tvsysid, tmp_path):
    command = "simulate joint.csv --duration 4"
    assert tvsysid(command)[0] == 0
    before = (tmp_path / "joint.csv").read_bytes()
    code, _, err = tvsysid(f"{command} --seed 1")
    assert code == 2
    assert "joint.csv exists already; give another name, or --overwrite" in err
    assert (tmp_path / "joint.csv").read_bytes() == before
    assert tvsysid(f"{command} --seed 1 --overwrite")[0] == 0
    assert (tmp_path / "joint.csv").read_bytes() != before
