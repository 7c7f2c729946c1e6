"""The page on reflexes: its example makes its picture, and its table names methods that there are."""

import re
import warnings
from pathlib import Path

import pytest

import tvsysid as tv

PAGE = (Path(__file__).parents[2] / "docs" / "reflex.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_example_makes_the_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"^```python\n(.+?)\n```$", PAGE, re.MULTILINE | re.DOTALL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        names = {}
        exec(code, names)
    assert (tmp_path / "reflex.png").stat().st_size > 10_000
    error = tv.ShortDataSegments().identify(names["ensemble"]).stiffness - names["truth"]["stiffness"].mean(axis=0)
    assert int(re.search(r"finds (\d+)\s+N·m/rad too much", PAGE)[1]) == round(error.mean())


def test_the_methods_of_the_table_are_those_of_two_pathways():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)
    assert {key for key in tv.methods.METHODS if tv.methods.describe(key).purpose == "two pathways"} == set(rows)
