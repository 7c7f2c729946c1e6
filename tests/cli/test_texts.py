"""Names from files and users that would steer a terminal, break a picture or are no text."""

import os
import warnings

import pandas as pd
import pytest
from tests.cli.conftest import IDENTIFY

from tvsysid.cli.console import output, show_table, shown_warnings
from tvsysid.errors import DataQualityWarning, one_line, printable

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


@pytest.mark.skipif(os.name != "posix", reason="sets a limit that only POSIX knows")
def test_where_no_file_may_be_larger_the_error_names_the_file_and_nothing_is_left(
    tvsysid, tmp_path
):
    import resource

    tvsysid("simulate joint.mat --duration 40")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:  # HDF5 would end this process
        code, _, err = tvsysid(f"identify joint.mat {IDENTIFY} --method sds")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 2
    name = os.path.join("tvsysid-identify", "models.nc")
    assert f"tvsysid: {name}: File too large" in err
    assert [file.name for file in (tmp_path / "tvsysid-identify").iterdir()] == ["stiffness.csv"]


@pytest.mark.parametrize("name", ["sds", "kbr:reference=disturbance,weighting=residual"])
def test_names_are_broken_before_numbers_and_in_few_lines(monkeypatch, capsys, name):
    monkeypatch.setattr(output, "width", 80)
    headings = [
        "method",
        "bias\n(N·m/rad)",
        "random\n(N·m/rad)",
        "total\n(N·m/rad)",
        "VAF\n(%)",
        "VAF 1-10 Hz\n(%)",
    ]
    show_table("scores", headings, [[name, "4.5", "3.7", "5.8", "98.4", "99.5"]])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    rows = [line.split("│")[1].strip() for line in lines if line.startswith("│")]
    assert "".join(rows) == name
    assert len(rows) <= 3
    assert sum(line.count("(N·m/rad)") for line in lines) == 3


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
    told = ["9.5 to 12 % is odd (sds, esm)", "kbr: 5 lags", "what is odd: it"]
    assert capsys.readouterr().err.splitlines() == [f"warning: {text}" for text in told]
