"""Names from files and users that would steer a terminal, break a picture or are no text."""

import os
import warnings

import pandas as pd
import pytest

from tvsysid.cli.console import output, show_table, shown_warnings
from tvsysid.errors import DataQualityWarning

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
    for command in (
        ("inspect", "no" + FILE),
        ("identify", FILE, *words[2:], "--angle", "no"),
        ("report", FILE),
    ):
        code, _, err = tvsysid(*command)
        assert code == 2
        assert not steering(err)


@pytest.mark.parametrize("name", ["sds", "kbr:reference=disturbance,weighting=residual"])
def test_names_are_broken_before_numbers_and_in_few_lines(monkeypatch, capsys, name):
    monkeypatch.setattr(output, "width", 80)
    values = dict(zip("abcdefgh", [4.5, -13.7, 105.8, 98.4, None, 99.5, 0.02, 1.1], strict=True))
    columns = {"method": "name", **{f"long\n{key}": f"{key}:.2f" for key in values}}
    show_table("scores", [{"name": name, **values}], columns)
    _, title, _, headings, line, *rows = capsys.readouterr().out.splitlines()
    assert title == "scores"
    assert len(line) <= 80
    assert headings.split() == ["method", *"abcdfgh"]  # nothing is known of e
    assert rows[0].split()[1:] == ["4.50", "-13.70", "105.80", "98.40", "99.50", "0.02", "1.10"]
    assert "".join(row.split("  ")[0].strip() for row in rows) == name


def test_a_warning_is_printed_once_with_all_who_gave_it(capsys):
    with shown_warnings():
        for text in (
            "sds: 9.5 % is odd",
            "esm: 12 % is odd",
            "sds: 9.5 % is odd",
            "kbr: 5 lags",
            "what is odd: it",
        ):
            warnings.warn(text, DataQualityWarning, stacklevel=1)
    told = ["sds, esm: 9.5 to 12 % is odd", "kbr: 5 lags", "what is odd: it"]
    assert capsys.readouterr().err.splitlines() == [f"warning: {text}" for text in told]
