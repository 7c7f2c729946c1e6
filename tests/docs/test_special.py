"""The page on special perturbations: its example runs."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "special-perturbations.md"


def test_the_example_runs(capsys):
    names = {}
    for code in re.findall(
        r"^```python\n(.+?)\n```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    ):
        exec(code, names)
    assert names["error"] < 4.0
    assert "no impulses" in capsys.readouterr().out
