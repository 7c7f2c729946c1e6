"""The program as a whole: help, version, and errors in one line."""

import subprocess
import sys

import pytest
from tests.cli.conftest import IDENTIFY

COMMANDS = (
    "benchmark",
    "experiment",
    "report",
    "identify",
    "explore",
    "inspect",
    "methods",
    "check-method",
    "simulate",
)


FILES = []


def joint_file(tvsysid, folder):
    """A simulated recording of 40 s; made once."""
    if not FILES:
        tvsysid("simulate", "joint.mat", "--duration", 40)
        FILES.append((folder / "joint.mat").read_bytes())
    return FILES[0]


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_help(tvsysid, command):
    code, out, _ = tvsysid(*command, "--help")
    assert code == 0
    assert "Usage: tvsysid" in out
    assert "<bool>" not in out


def test_without_a_command_the_help_is_shown(tvsysid):
    code, out, err = tvsysid()
    assert (code, err) == (0, "")
    assert "Usage: tvsysid" in out


def test_version(tvsysid):
    assert tvsysid("--version")[:2] == (0, "tvsysid 0.1.0\n")


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("identify", "nowhere.mat", *IDENTIFY), "nowhere.mat: no such file"),
        (
            ("identify", "joint.mat", "--angle", "pos", *IDENTIFY[2:]),
            "no channel 'pos'; it holds angle (40000 x 1, 1000 Hz)",
        ),
        (
            ("identify", "joint.mat", *IDENTIFY, "--decimate", "300"),
            "not a whole multiple of 300 Hz",
        ),
        (("identify", "joint.mat", *IDENTIFY, "--period", "90"), "no realization of 90 s"),
        (("identify", "joint.mat", *IDENTIFY, "--method", "arx"), "unknown method 'arx'"),
        (
            ("identify", "joint.mat", *IDENTIFY, "--method", "sds:windw=1"),
            "unknown setting 'windw'",
        ),
        (
            ("identify", "joint.mat", *IDENTIFY, "--method", "sds:window=9"),
            "longer than a realization",
        ),
        (("identify", "joint.mat", *IDENTIFY, "--torque-sign", "3"), "torque_sign must be 1 or -1"),
        (("identify", "joint.mat", *IDENTIFY, "--angle-unit", "grad"), "grad"),
        (("identify", "joint.mat", *IDENTIFY, "--columns", "rows"), "rows"),
        (
            ("identify", "joint.mat", "--angle", "angle"),
            "missing: --torque, --rate (see tvsysid identify --help)",
        ),
        (
            ("identify", "joint.mat", *IDENTIFY[:-2]),
            "--period is missing: the duration of one repetition",
        ),
        (("identify",), "missing: FILE, --angle, --torque, --rate (see tvsysid identify --help)"),
        (
            ("identify", "joint.mat", *IDENTIFY, "--torque", "angle"),
            "angle and torque are both 'angle'; name the",
        ),
        (("identify", "joint.mat", *IDENTIFY, "--rate", "0"), "positive number of hertz"),
        (("identify", "joint.mat", *IDENTIFY, "--out", "joint.mat"), "joint.mat"),
        (("inspect", "nowhere.mat"), "nowhere.mat: no such file"),
        (
            ("inspect", "joint.mat", "--diagnose", *IDENTIFY[:4]),
            "--diagnose needs --rate, as for tvsysid identify",
        ),
        (
            ("inspect", "joint.mat", *IDENTIFY),
            "--angle: is used with --diagnose only; add --diagnose",
        ),
        (
            ("inspect", "joint.mat", "--diagnose", *IDENTIFY, "--decimate", "300"),
            "not a whole multiple of 300 Hz",
        ),
        (
            ("inspect", "joint.mat", "--plot", "joint.doc"),
            "unknown ending '.doc'; give one of .png, .pdf, .svg",
        ),
        (("simulate", "joint.mat"), "joint.mat exists already; give another name, or --overwrite"),
        (("simulate", "joint.docx"), "unknown ending '.docx'"),
        (("simulate", "other.mat", "--duration", "-1"), "duration must be a positive number"),
        (("benchmark", "--duration", "3"), "whole realizations of 2 s"),
        (("benchmark", "--trials", "0"), "trials"),
        (("benchmark", "--workers", "0"), "workers must be at least 1"),
        (("benchmark", "--method", "nothing"), "unknown method 'nothing'"),
        (("benchmark", "--method", "nowhere:Fit"), "there is no module 'nowhere'"),
        (
            ("check-method", "nowhere:Fit"),
            "there is no module 'nowhere' in the current folder",
        ),
        (("check-method", "json:Fit"), "module 'json' has no 'Fit'; its methods are none"),
        (("check-method", "nothing"), "unknown method 'nothing'"),
        (("check-method",), "missing: MODULE:CLASS (see tvsysid check-method --help)"),
        (("benchmark", "--stiffness", "step"), "step"),
        (("benchmrk",), "benchmrk"),
        (("benchmark", "--trails", "3"), "--trails"),
    ],
)
def test_errors_are_one_line(tvsysid, tmp_path, words, message):
    (tmp_path / "joint.mat").write_bytes(joint_file(tvsysid, tmp_path))
    code, _, err = tvsysid(*words)
    assert code == 2
    assert message in err
    assert err.startswith("tvsysid: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err


def test_start_is_light():
    program = (
        "import sys, tvsysid.cli;"
        "heavy = {'scipy', 'numpy', 'pandas', 'xarray', 'matplotlib', 'zarr', 'pydantic', "
        "'jinja2'} & set(sys.modules);"
        "print(heavy or 'light')"
    )
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    assert shown == "light\n"


@pytest.mark.parametrize("raised", ["KeyboardInterrupt", "SystemExit(0)"])
def test_a_module_that_ends_programs_while_it_is_imported_is_an_error(
    tvsysid, tmp_path, monkeypatch, raised
):
    monkeypatch.syspath_prepend(tmp_path)
    module = f"ends_by_{raised[:4].lower()}"
    (tmp_path / f"{module}.py").write_text(f"raise {raised}\n")
    code, _, err = tvsysid("check-method", f"{module}:Mine")
    assert code == 2
    assert raised[:-3] in err
    assert "the files that were written" not in err


@pytest.mark.slow
def test_a_thread_that_a_module_leaves_does_not_keep_the_command_from_ending(tmp_path):
    (tmp_path / "leaves.py").write_text(
        "import threading, time\nthreading.Thread(target=time.sleep, args=(600,)).start()\n"
    )
    words = [sys.executable, "-m", "tvsysid.cli", "check-method", "leaves:Mine"]
    ended = subprocess.run(
        words, check=False, capture_output=True, text=True, cwd=tmp_path, timeout=60
    )
    assert ended.returncode == 2
    assert "has no 'Mine'" in ended.stderr


def test_it_is_a_module_that_can_be_run():
    done = subprocess.run(
        [sys.executable, "-m", "tvsysid.cli", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "tvsysid 0.1.0\n"
