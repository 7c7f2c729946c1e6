"""What docs/closed-loop.md says is so."""

import re
from pathlib import Path

import pytest

import tvsysid as tv

TEXT = (Path(__file__).parents[2] / "docs" / "closed-loop.md").read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")
def test_the_example_mends_what_the_loop_biases(capsys):
    (example,) = re.findall(r"^```python\n(.+?)\n^```", TEXT, re.MULTILINE | re.DOTALL)
    exec(example, {})
    opened, closed, predicted = map(float, capsys.readouterr().out.split())
    assert opened < 85
    assert abs(closed - 100) < 8
    assert predicted > 80


def test_the_methods_of_the_table_take_a_reference():
    words = re.findall(r"^\| `(\w+:[\w=,]*reference=NAME[\w=,]*)`", TEXT, re.MULTILINE)
    assert {word.partition(":")[0] for word in words} == {"kbr", "birf", "esm", "sds"}
    assert all(tv.methods.parse(word).inputs[0].kind == "reference" for word in words)
