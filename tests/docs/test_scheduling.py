"""What docs/scheduling.md says of a joint that follows a measured variable is so."""

import re
from pathlib import Path

import numpy as np

import tvsysid as tv

TEXT = (Path(__file__).parents[2] / "docs" / "scheduling.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"^```python\n(.+?)\n^```", TEXT, re.MULTILINE | re.DOTALL)


def test_the_example_finds_the_relation():
    names = {}
    exec(EXAMPLE, names)
    truth = names["joint"].relation(np.array([-0.3, 0.0, 0.2]))
    assert np.abs(names["found"]["stiffness"].values - truth).max() < 2
    assert names["model"].diagnostics.details["vaf_folds"] > 95


def test_methods_and_settings_that_are_named_are_there():
    for text in set(re.findall(r"`(lpv[\w:=,]*)`", TEXT)):
        tv.methods.parse(text)
