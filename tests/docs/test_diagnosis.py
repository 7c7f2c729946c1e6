"""What the page on findings says is what the package looks for."""

import re
from pathlib import Path

import pytest
from scipy.io import savemat

import tvsysid as tv
from tvsysid.quality import FAULTS

PAGE = (Path(__file__).parents[2] / "docs" / "diagnosis.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^### `([\w-]+)`(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL))


def test_it_lists_every_finding_and_no_other():
    assert list(SECTIONS) == list(FAULTS)
    assert f"{len(FAULTS)} things" in PAGE


@pytest.mark.parametrize("name", FAULTS)
def test_each_has_its_limit_effect_and_remedy(name):
    kind, told = FAULTS[name], " ".join(SECTIONS[name].split())
    assert told.lower().startswith(f": {kind.title.lower()} ")
    lowest = f" or below {kind.lowest:g} {kind.unit}" if kind.lowest else ""
    assert (
        f"Measure: {kind.measure}; wrong {kind.wrong} {kind.limit:g} {kind.unit}{lowest}." in told
    )
    assert f"Effect: {kind.effect}." in told
    assert f"Remedy: {kind.remedy}." in told


@pytest.mark.usefixtures("sketched")
def test_the_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = (
        tv.simulate.Joint()
        .simulate(60, perturbation=tv.simulate.FilteredNoise(), snr_db=20, seed=0)
        .recording
    )
    savemat("ankle.mat", {"pos": recording.angle, "tq": -recording.torque})
    (code,) = re.findall(r"^```python\n(.+?)\n^```", PAGE, re.MULTILINE | re.DOTALL)
    exec(code, {})
    assert "reversed" in capsys.readouterr().out
    assert (tmp_path / "page.html").exists()
