"""The tutorials, as they stand, but for the number of bootstraps.

On the command line, two of the methods, and no held-out VAF.

All in this process: `test_own_method.py` has a script in a Python of its own.
"""

import shlex
import shutil
from pathlib import Path

import pandas as pd
import pytest
import xarray as xr
from tests.docs.pages import blocks

pytestmark = pytest.mark.slow


def fewer(text, bootstraps):
    """Three bootstraps, for haste."""
    return text.replace(bootstraps, bootstraps.replace("10", "3"))


def words_of(line):
    name, *words = shlex.split(line)
    assert name == "tvsysid"
    return words


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    return tmp_path_factory.mktemp("simulated")


@pytest.fixture
def folder(tvsysid, tmp_path, simulated):
    """Folder with the recordings of both tutorials, which are simulated once."""
    if not any(simulated.iterdir()):
        for line in blocks("tutorial-command-line.md", "")[0].splitlines():
            assert tvsysid(*words_of(line))[0] == 0
        shutil.copytree(tmp_path, simulated, dirs_exist_ok=True)
    return Path(shutil.copytree(simulated, tmp_path, dirs_exist_ok=True))


def test_the_python_tutorial_runs(folder):
    codes = [fewer(code, "bootstraps=10") for code in blocks("tutorial-python.md")]
    main = codes[0].split('if __name__ == "__main__":')[1]
    assert len([line for line in main.splitlines() if line.strip()]) <= 10
    for code in codes:
        exec(code, {"__name__": "__main__"})
    for name in ("figure7.pdf", "figure8.pdf", "figure9.pdf"):
        assert (folder / name).read_bytes().startswith(b"%PDF")
    results = xr.load_dataset(folder / "P1" / "results.nc")
    assert results.sizes["bootstrap"] == 3
    assert (results.failure == "").all()
    assert {str(each).rpartition("-")[0] for each in results.analysis.values} == {
        "eirf",
        "sds",
        "birf",
        "esm",
        "kbr",
    }


@pytest.mark.usefixtures("sketched")
def test_the_command_line_tutorial_runs(tvsysid, folder, request, monkeypatch):
    monkeypatch.setattr(
        "tvsysid.comparison.Comparison.predict_held_out", lambda *given, **words: {}
    )
    _, inspect, experiment, wide, alone, sheet = blocks("tutorial-command-line.md", "")
    (study,) = blocks("tutorial-command-line.md", "toml")
    study = f'methods = ["eirf", "sds"]\n{fewer(study, "bootstraps = 10")}'
    (folder / "study.toml").write_text(study, encoding="utf-8")
    code, shown, _ = tvsysid(*words_of(inspect))
    assert code == 0
    assert "71680 x 10" in shown
    assert (folder / "tvsysid-inspect" / "P1-noise.mat.png").is_file()
    code, told, _ = tvsysid(*words_of(experiment), "--workers", 1)
    assert code == 0
    assert "random" in told
    for name in (
        "report.html",
        "figures/participants.pdf",
        "figures/participant.pdf",
        "exclusions.csv",
    ):
        assert (folder / "P1" / name).stat().st_size > 1000
    table = pd.read_csv(folder / "P1" / "stiffness.csv")
    assert set(table.method) == {"eirf", "sds"}
    # The virtual participant of the file is the one of the package, and its truth is in the file.
    assert len(pd.read_csv(folder / "P1" / "exclusions.csv")) == 600
    request.getfixturevalue("undrawn")
    assert tvsysid(*words_of(wide), "--workers", 1)[0] == 0
    assert set(pd.read_csv(folder / "wide" / "summary.csv").method) == {"sds:window=0.2"}
    code, told, _ = tvsysid(*words_of(alone), "--method", "sds")
    assert code == 0
    assert "wrote report.html, " in told
    assert tvsysid(*words_of(sheet))[0] == 0
    assert "1. P1-noise.mat" in (folder / "alone" / "P1-prbs.mat" / "sheet.html").read_text()
