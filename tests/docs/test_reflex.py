"""What docs/reflex.md says of two pathways is so."""

import re
from pathlib import Path

import numpy as np
import pytest

import tvsysid as tv

TEXT = (Path(__file__).parents[2] / "docs" / "reflex.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"^```python\n(.+?)\n^```", TEXT, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_the_example_separates_what_other_methods_take_for_stiffness(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(EXAMPLE, names)
    truth = names["simulation"].truth_of(names["ensemble"])
    models = names["found"].models
    for name, error in (("stiffness", 1.0), ("reflex_gain", 0.4)):
        off = models["cascade"].estimates[name].values - truth[name]
        assert np.sqrt(np.mean(off**2)) < error
    for key in ("kbr", "sds"):
        assert models[key].stiffness.mean() > truth["stiffness"].mean() + 10
    assert Path("reflex.png").stat().st_size > 10_000


def test_the_table_names_all_methods_of_two_pathways():
    table = TEXT.split("## Which method when")[1].split("##")[0]
    named = set(re.findall(r"`(\w+)(?::\w+=\w+)?`", table)) - {"emg"}
    assert named == {
        key for key in tv.methods.METHODS if tv.methods.describe(key).purpose == "two pathways"
    }
