"""The command line, run in the tests' own process."""

import sys
from contextlib import nullcontext

import pytest

from tvsysid import cli
from tvsysid.cli.console import errors, output

IDENTIFY = ("--angle", "angle", "--torque", "torque", "--rate", 1000, "--decimate", 100, "--period", 2)
"""How a simulated recording is identified."""


@pytest.fixture
def tvsysid(monkeypatch, capsys, tmp_path):
    """Run the command line in a folder of its own; returns exit code, output and errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    for console in (output, errors):  # made before, they have read another width
        monkeypatch.setattr(console, "width", 200)

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["tvsysid", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        captured = capsys.readouterr()
        return stopped.value.code, captured.out, captured.err

    return command


@pytest.fixture
def undrawn(monkeypatch):
    """Without figures, which take most of the time; other tests have them."""
    for name in ("study_figures", "experiment_figures", "participant_figures"):
        monkeypatch.setattr(f"tvsysid.studies.van_de_ruit_2021.folder.{name}", lambda *given: {})
    monkeypatch.setattr("tvsysid.studies.van_de_ruit_2021.folder.write_diagnosis", lambda *given: None)
    monkeypatch.setattr("tvsysid.studies.van_de_ruit_2021.folder.helpers", lambda workers: nullcontext())
    monkeypatch.setattr("tvsysid.figures.save", lambda figure, file: None)
