"""The program as a whole: help, version, and errors in one line."""

import subprocess
import sys
import warnings
from unittest.mock import Mock

import attrs
import pytest
from tests.cli.conftest import IDENTIFY

from tvsysid.cli.app import app
from tvsysid.cli.console import output
from tvsysid.errors import DataQualityWarning
from tvsysid.recordings import Reading, Segmentation

IDENTIFY_JOINT = f"identify joint.mat {IDENTIFY} "
SIGNALS = "--angle angle --torque torque --rate 1000"


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_help(tvsysid, command):
    code, out, _ = tvsysid(command, "--help")
    assert code == 0
    assert f"Usage: tvsysid {command}" in out


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_a_command_has_at_most_12_options_beside_those_of_a_recording(command):
    fields = {*attrs.fields_dict(Reading), *attrs.fields_dict(Segmentation)}
    names = {argument.name for argument in app[command].assemble_argument_collection()}
    options = {name for name in names if name.startswith("--")}
    assert len(options - {f"--{name.replace('_', '-')}" for name in fields}) <= 12


def test_the_help_of_identify_is_one_screen(tvsysid, monkeypatch):
    monkeypatch.setattr(output, "width", 100)
    assert tvsysid("identify --help")[1].count("\n") <= 50


def test_without_a_command_the_help_is_shown(tvsysid):
    code, out, err = tvsysid()
    assert (code, err) == (0, "")
    assert "Usage: tvsysid" in out
    assert "Compare methods on simulated data" in out
    assert tvsysid("--help")[1] == out


@pytest.mark.usefixtures("undrawn", "joint")
@pytest.mark.parametrize(
    ("command", "message"),
    [
        (f"identify nowhere.mat {SIGNALS} --decimate 100 --period 2", "nowhere.mat: no such file"),
        (
            "identify joint.mat",
            "missing: angle, torque, sampling_rate, period; add --angle angle --torque torque "
            "--rate 1000 --decimate 100 --period SECONDS",
        ),
        ("identify joint.mat --angle angle --rate 100 --period 2", "add --torque torque"),
        ("identify", "FILE requires an argument (see tvsysid identify --help)"),
        (IDENTIFY_JOINT + "--angle pos", "no channel 'pos'; the file holds angle (40000 x 1"),
        (IDENTIFY_JOINT + "--torque-sign 3", "for --torque-sign. Choose from: 1, -1 (see tvsysid"),
        (IDENTIFY_JOINT + "--torque angle", "angle and torque are both 'angle'; name the"),
        (IDENTIFY_JOINT + "--out joint.mat", "tvsysid: joint.mat: File exists"),
        (IDENTIFY_JOINT + "--channel emg", "--channel emg: expected NAME=CHANNEL, as in emg=EMG_"),
        (
            "inspect joint.mat --diagnose --period 2",
            "missing: angle, torque, sampling_rate; add --angle --torque --rate.",
        ),
        (
            IDENTIFY_JOINT.replace("identify", "inspect --diagnose") + "--reference command",
            "there is no 'command'; the signals are 'angle', 'torque'; read it as a channel",
        ),
        ("simulate joint.docx", "unknown ending '.docx'"),
        ("simulate new.mat --seed one", 'Invalid value for --seed: unable to convert "one"'),
        ("benchmark --method nowhere:Fit", "No module named 'nowhere'"),
        ("benchmark --system ankle", "unknown system 'ankle'; expected one of joint, reflex, ref"),
        ("benchmrk", 'Did you mean "benchmark"?'),
        ("benchmark --trails 3", "Unknown option: --trails. Did you mean --trials?"),
        ("report nowhere", "nowhere"),
        ("plan --pilot pilot.mat", "pilot.mat: no such file"),
        ("plan --pilot pilot.mat --noise 1", "the pilot shows system, stiffness and noise; leave"),
        ("plan --rate 100", "options that describe a recording (such as --angle and --rate) need"),
    ],
)
def test_errors_are_one_line(tvsysid, command, message):
    code, _, err = tvsysid(command)
    assert code == 2
    assert message in err
    assert err.startswith("tvsysid: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (MemoryError(), 2, "not enough memory"),
        (OSError(28, "No space left on device", "out.csv"), 2, "out.csv: No space left on device"),
    ],
)
def test_what_ends_a_command_is_one_line(tvsysid, monkeypatch, error, code, message):
    monkeypatch.setattr("tvsysid.methods.describe", Mock(side_effect=error))
    found, _, err = tvsysid("methods")
    assert found == code
    assert err.startswith(f"tvsysid: {message}")
    assert err.count("\n") == 1


def test_a_warning_is_printed_once(tvsysid, monkeypatch):
    from tvsysid.methods import describe

    def warn(key):
        for text in ("9.5 % is odd", "sds: 5 lags", "9.5 % is odd"):
            warnings.warn(text, DataQualityWarning, stacklevel=1)
        return describe(key)

    monkeypatch.setattr("tvsysid.methods.describe", warn)
    assert tvsysid("methods")[2].splitlines() == ["warning: 9.5 % is odd", "warning: sds: 5 lags"]


def shown(*words, **settings):
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, check=True, **settings
    ).stdout


def test_start_is_light():
    program = (
        "import sys, tvsysid.cli;heavy = {'scipy', 'numpy', 'pandas', 'xarray', 'matplotlib', "
        "'jinja2'} & set(sys.modules);print(heavy or 'light')"
    )
    assert shown("-c", program) == "light\n"


def test_a_terminal_without_unicode(monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    assert "N?m/rad" in shown("-m", "tvsysid.cli", "--help")
