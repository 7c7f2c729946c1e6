"""The command line, run in the tests' own process."""

import sys

import pytest

from tvsysid import cli


@pytest.fixture
def tvsysid(monkeypatch, capsys, tmp_path):
    """Run the command line in a folder of its own; returns exit code, output and errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["tvsysid", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        captured = capsys.readouterr()
        return stopped.value.code, captured.out, captured.err

    return command
