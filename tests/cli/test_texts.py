"""Names from files and users that would steer a terminal, break a picture or are no text."""

import errno
import io
import os
import sys

import pandas as pd
import pytest

from tvsysid.cli.console import output
from tvsysid.errors import one_line, printable

ANGLE, TORQUE, FILE = "[/a]\x1b[31m$x_{$\x07", "[bold]\u202etq$", "[red]$\x1b\udce9.csv"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Größe 角度 \t[b]\na\N{NO-BREAK SPACE}b", "Größe 角度 \t[b]\na\N{NO-BREAK SPACE}b"),
        ("\x1b[31m\r\x07\x9b", r"\x1b[31m\r\x07\x9b"),
        ("caf\udce9\u202e\u2066\u2028\ufeff", r"caf\udce9\u202e\u2066\u2028\ufeff"),
    ],
)
def test_what_is_printable(text, shown):
    assert printable(text) == shown
    assert one_line(f"{text}\n  more") == shown.replace("\n", " ") + " more"


def steering(text):
    return [sign for sign in text if not sign.isprintable() and sign != "\n"]


@pytest.mark.skipif(os.name != "posix", reason="names of files are bytes on POSIX only")
def test_names_neither_steer_the_terminal_nor_stop_the_work(tvsysid, tmp_path):
    tvsysid("simulate", "joint.csv", "--duration", 40)
    table = pd.read_csv(tmp_path / "joint.csv")[["angle", "torque"]]
    table.set_axis([ANGLE, TORQUE], axis=1).to_csv(tmp_path / "named.csv", index=False)
    os.replace(tmp_path / "named.csv", tmp_path / FILE)
    words = ("--angle", ANGLE, "--torque", TORQUE, "--rate", 1000, "--period", 2)
    for command, files in (
        (("inspect", FILE, "--diagnose", *words), 2),
        (("identify", FILE, *words, "--decimate", 100, "--method", "sds"), 4),
    ):
        code, out, err = tvsysid(*command)
        assert (code, err) == (0, "")
        assert not steering(out)
        assert len(list((tmp_path / f"tvsysid-{command[0]}").iterdir())) == files
    for command in (("inspect", "no" + FILE), ("identify", FILE, *words[2:], "--angle", "no"), ("report", FILE)):
        code, _, err = tvsysid(*command)
        assert code == 2
        assert not steering(err)


@pytest.mark.parametrize(("number", "code"), [(errno.ENOSPC, 2), (errno.EPIPE, 0)])
def test_the_work_is_done_though_nothing_can_be_printed(tvsysid, tmp_path, monkeypatch, number, code):
    class Lost(io.StringIO):
        def write(self, text):
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(output, "quiet", False)
    monkeypatch.setattr(output, "lost", None)
    monkeypatch.setattr(sys, "stdout", Lost())
    found, _, err = tvsysid("simulate", "joint.csv", "--duration", 2)
    assert found == code
    assert err.startswith("tvsysid: standard output: No space left on device") if code else not err
    assert (tmp_path / "joint.csv").exists()
