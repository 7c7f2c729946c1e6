"""The program as a whole: help, version, and errors in one line."""

import subprocess
import sys
from unittest.mock import Mock

import pytest
from tests.cli.conftest import IDENTIFY

from tvsysid.cli.app import app

FILES = []


def joint_file(tvsysid, folder):
    """A simulated recording of 40 s; made once."""
    if not FILES:
        tvsysid("simulate joint.mat --duration 40")
        FILES.append((folder / "joint.mat").read_bytes())
    return FILES[0]


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_help(tvsysid, command):
    code, out, _ = tvsysid(command, "--help")
    assert code == 0
    assert f"Usage: tvsysid {command}" in out


def test_without_a_command_the_help_is_shown(tvsysid):
    code, out, err = tvsysid()
    assert (code, err) == (0, "")
    assert "Usage: tvsysid" in out
    assert tvsysid("--help")[1] == out


def test_version(tvsysid):
    assert tvsysid("--version")[:2] == (0, "tvsysid 0.1.0\n")


IDENTIFY_JOINT = f"identify joint.mat {IDENTIFY} "


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("command", "message"),
    [
        (IDENTIFY_JOINT.replace("joint", "nowhere"), "nowhere.mat: no such file"),
        (IDENTIFY_JOINT + "--angle pos", "no channel 'pos'; it holds angle (40000 x 1, 1000 Hz)"),
        (IDENTIFY_JOINT + "--decimate 300", "not a whole multiple of 300 Hz"),
        (IDENTIFY_JOINT + "--period 90", "no realization of 90 s"),
        (IDENTIFY_JOINT + "--method arx", "unknown method 'arx'"),
        (IDENTIFY_JOINT + "--method sds:windw=1", "unknown setting 'windw'"),
        (IDENTIFY_JOINT + "--method sds:window=9", "longer than a realization"),
        (IDENTIFY_JOINT + "--torque-sign 3", "for --torque-sign. Choose from: 1, -1 (see tvsysid"),
        (IDENTIFY_JOINT + "--angle-unit grad", "grad"),
        (IDENTIFY_JOINT + "--torque angle", "angle and torque are both 'angle'; name the"),
        (IDENTIFY_JOINT + "--rate 0", "sampling_rate must be a positive number"),
        (IDENTIFY_JOINT + "--out joint.mat", "joint.mat: cannot write to this folder: File exists"),
        (IDENTIFY_JOINT + "--channel emg", "--channel emg: expected NAME=CHANNEL, as in emg=EMG_"),
        (IDENTIFY_JOINT + "--channel emg=EMG[0]", "no channel 'EMG[0]'; it holds"),
        ("identify joint.mat --angle angle --period 2", "torque is missing; give it (--torque)"),
        (
            "identify joint.mat --angle angle --torque torque --rate 1000",
            "--period is missing: the duration of one repetition",
        ),
        ("identify nowhere.mat --angle angle --torque torque --rate 9", "nowhere.mat: no such"),
        ("simulate new.mat --participant 1 --duration 9", "only --perturbation applies to it"),
        ("simulate new.mat --seed 1.5", "Invalid value for --seed: expected a whole number"),
        ("experiment --virtual 1.5", 'Invalid value for --virtual: unable to convert "1.5"'),
        ("explore joint.mat --port 80.5", "Invalid value for --port: expected a whole number"),
        ("identify", "FILE requires an argument (see tvsysid identify --help)"),
        ("inspect nowhere.mat", "nowhere.mat: no such file"),
        ("inspect joint.mat --diagnose --period 2", "angle is missing; give it (--angle)"),
        (
            "inspect joint.mat --diagnose --reference command",
            "add --channel command=CHANNEL, one of angle, torque",
        ),
        (
            "inspect joint.mat --plot joint.doc",
            "unknown ending '.doc'; give one of .png, .pdf, .svg",
        ),
        ("simulate joint.mat", "joint.mat exists already; give another name, or --overwrite"),
        ("simulate joint.docx", "unknown ending '.docx'"),
        ("simulate other.mat --duration -1", "duration must be a positive number"),
        ("benchmark --duration 3", "whole realizations of 2 s"),
        ("benchmark --trials 0", "trials"),
        ("benchmark --workers 0", "workers must be at least 1"),
        ("benchmark --method nothing", "unknown method 'nothing'"),
        ("benchmark --method nowhere:Fit", "there is no module 'nowhere'"),
        ("benchmark --stiffness step", "step"),
        ("benchmrk", 'Did you mean "benchmark"?'),
        ("benchmark --trails 3", "Unknown option: --trails. Did you mean --trials?"),
        ("check-method json:Fit", "module 'json' has no 'Fit'"),
        ("check-method", "METHOD requires an argument (see tvsysid check-method --help)"),
        ("report nowhere", "nowhere"),
    ],
)
def test_errors_are_one_line(tvsysid, tmp_path, command, message):
    (tmp_path / "joint.mat").write_bytes(joint_file(tvsysid, tmp_path))
    code, _, err = tvsysid(command)
    assert code == 2
    assert message in err
    assert err.startswith("tvsysid: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "interrupted; what is finished is kept, and a study is"),
        (KeyboardInterrupt("resumes"), 130, "resumes"),
        (MemoryError(), 2, "not enough memory; give a shorter duration"),
        (OSError(28, "No space left on device", "out.csv"), 2, "out.csv: No space left on device"),
    ],
)
def test_what_ends_a_command_is_one_line(tvsysid, monkeypatch, error, code, message):
    monkeypatch.setattr("tvsysid.methods.names", Mock(side_effect=error))
    found, _, err = tvsysid("methods")
    assert found == code
    assert err.startswith(f"tvsysid: {message}")
    assert err.count("\n") == 1


def test_start_is_light():
    program = (
        "import sys, tvsysid.cli;"
        "heavy = {'scipy', 'numpy', 'pandas', 'xarray', 'matplotlib', "
        "'jinja2'} & set(sys.modules);"
        "print(heavy or 'light')"
    )
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    assert shown == "light\n"


def test_it_is_a_module_that_can_be_run():
    done = subprocess.run(
        [sys.executable, "-m", "tvsysid.cli", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "tvsysid 0.1.0\n"
