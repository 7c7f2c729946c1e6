"""Names from files and users that would steer a terminal, break a picture or are no text."""

import math
import os

import pandas as pd
import pytest

from tvsysid.cli.console import output, show_table

ANGLE, TORQUE, FILE = "[/a]\x1b[31m$x_{$\x07", "[bold]\u202etq$", "[red]$\x1b\udce9.csv"


def steering(text):
    return [sign for sign in text if not sign.isprintable() and sign != "\n"]


@pytest.mark.slow
@pytest.mark.usefixtures("not_held_out")
@pytest.mark.skipif(os.name != "posix", reason="names of files are bytes on POSIX only")
def test_names_neither_steer_the_terminal_nor_stop_the_work(tvsysid, tmp_path):
    tvsysid("simulate joint.csv --duration 40")
    table = pd.read_csv(tmp_path / "joint.csv")[["angle", "torque"]]
    table.set_axis([ANGLE, TORQUE], axis=1).to_csv(tmp_path / "named.csv", index=False)
    os.replace(tmp_path / "named.csv", tmp_path / FILE)
    words = ("--angle", ANGLE, "--torque", TORQUE, "--rate", 1000, "--period", 2)
    for command, files in (
        (("inspect", FILE, "--diagnose", *words), 2),
        (("identify", FILE, *words, "--decimate", 100, "--method", "sds"), 5),
    ):
        code, out, err = tvsysid(*command)
        assert (code, err) == (0, "")
        assert not steering(out)
        assert len(list((tmp_path / f"tvsysid-{command[0]}").iterdir())) == files
    code, _, err = tvsysid("identify", FILE, *words[2:], "--angle", "no")
    assert code == 2
    assert not steering(err)


def test_names_are_broken_before_numbers(monkeypatch, capsys):
    monkeypatch.setattr(output, "width", 40)
    record = {"name": "kbr:reference=disturbance,weighting=residual", "a": -13.7, "b": math.nan}
    columns = {"method": "name", "a": "a:.2f", "b": "b:.2f"}
    show_table("scores", [record], columns)
    _, title, headings, _, *rows = capsys.readouterr().out.splitlines()
    assert (title, headings.split()) == ("scores", ["method", "a"])  # nothing is known of b
    assert rows[0].endswith("-13.70")
    assert "".join(row.removesuffix("-13.70").strip() for row in rows) == record["name"]
