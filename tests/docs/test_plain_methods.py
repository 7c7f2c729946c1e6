"""The page on the plain methods shows the code that the package is checked against."""

import ast
import re
from pathlib import Path

from benchmarks import plain

import tvsysid as tv

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "plain-methods.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"^```python\n(.+?)\n```$", PAGE, re.MULTILINE | re.DOTALL)


def test_the_page_shows_every_function_of_the_file():
    parts = ast.parse(Path(plain.__file__).read_text(encoding="utf-8")).body
    shown = re.findall(
        r"^```{literalinclude} \.\./benchmarks/plain\.py\n:pyobject: (\w+)\n```$",
        PAGE,
        re.MULTILINE,
    )
    assert sorted(shown) == sorted(part.name for part in parts if isinstance(part, ast.FunctionDef))


def test_every_method_has_its_section():
    assert set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^## .+", PAGE, re.MULTILINE)))) == set(
        tv.methods.PAPER_METHODS
    )


def test_the_example_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend("")  # so that what the example adds to sys.path is taken away again
    exec(EXAMPLE, {})
