"""What the page on findings says is what the package looks for."""

import importlib
import re
from pathlib import Path

import pytest
from scipy.io import savemat

import tvsysid as tv
from tvsysid.quality import FAULTS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "diagnosis.md").read_text(encoding="utf-8")


def test_the_site_lists_every_check_with_its_limit_effect_and_remedy(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "extensions")
    told = importlib.import_module("reference").checks()
    for name, fault in FAULTS.items():
        assert f"### `{name}`: {fault.title}" in told
        assert f"wrong {fault.wrong} {fault.limit:g} {fault.unit}" in told
        assert f"- Effect: {fault.effect}.\n- Remedy: {fault.remedy}." in told


@pytest.mark.usefixtures("sketched")
def test_the_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = (
        tv.simulate.Joint()
        .simulate(60, perturbation=tv.simulate.FilteredNoise(), snr_db=20, seed=0)
        .recording
    )
    savemat("ankle.mat", {"angle": recording.angle, "torque": -recording.torque})
    (code,) = re.findall(r"^```python\n(.+?)\n^```", PAGE, re.MULTILINE | re.DOTALL)
    exec(code, {})
    assert "reversed" in capsys.readouterr().out
    assert (tmp_path / "page.html").exists()
