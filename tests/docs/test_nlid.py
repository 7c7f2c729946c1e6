"""The page for those who know NLID: its example runs, and every name that it gives exists."""

import re
from pathlib import Path

import pytest

import tvsysid as tv

PAGE = (Path(__file__).parents[2] / "docs" / "nlid.md").read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")
def test_the_example_runs(capsys):
    (code,) = re.findall(r"^```python\n(.+?)\n^```", PAGE, re.MULTILINE | re.DOTALL)
    names = {}
    exec(code, names)
    explained, area = capsys.readouterr().out.split()
    assert float(explained) > 70
    assert area == "True"
    assert set(names["pathways"]) == {"intrinsic", "reflex"}
    assert abs(names["sdss"].stiffness.mean() - 100) < 6


def test_names_that_are_given_exist():
    for name in set(re.findall(r"\btv((?:\.\w+)+)", PAGE)):
        found = tv
        for part in name.strip(".").split("."):
            found = getattr(found, part)
