"""What the README says is so."""

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.faults import simulated

import tvsysid as tv
from tvsysid import cli

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def blocks(heading):
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", README, re.MULTILINE | re.DOTALL)[1]
    return re.findall(r"^```\w*\n(.+?)\n^```", section, re.MULTILINE | re.DOTALL)


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording = simulated(60.0, "prbs", "sine", 20.0, 0)
    savemat("ankle.mat", {"angle": recording.angle, "torque": recording.torque})


@pytest.mark.parametrize(
    ("heading", "command"),
    [
        (
            "Run it",
            "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/tvsysid benchmark",
        ),
        (
            "Test it",
            'python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/python -m '
            "pytest",
        ),
    ],
)
def test_commands_are_one_line_each(heading, command):
    assert blocks(heading) == [command]


@pytest.mark.usefixtures("recorded")
@pytest.mark.slow
def test_python_example_runs():
    (code,) = blocks("From Python")
    names = {}
    exec(code, names)
    assert np.isfinite(names["model"].stiffness).all()


@pytest.mark.usefixtures("recorded", "sketched")
def test_a_recording_is_diagnosed_as_told(tmp_path, monkeypatch, capsys):
    (command,) = (text for text in blocks("Identify your own recording") if "--diagnose" in text)
    monkeypatch.setattr(sys, "argv", shlex.split(command))
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 0
    assert (tmp_path / "tvsysid-inspect" / "ankle.mat.angle-torque.diagnosis.html").exists()
    count = len(tv.quality.FAULTS)
    assert f"looks for [{count} faults]" in README
    assert f"no fault found ({count - 4} of {count} checks are possible)" in " ".join(
        capsys.readouterr().out.split()
    )


def test_methods_are_those_of_the_package():
    section = re.search(r"^## The methods\n(.*?)(?=^## )", README, re.MULTILINE | re.DOTALL)[1]
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \|", section, re.MULTILINE)
    assert rows == [(key, type(tv.methods.parse(key)).__name__) for key in tv.methods.METHODS]


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!http)([^)]+)\)", README):
        assert (Path(__file__).parents[1] / target.partition("#")[0]).exists(), target
