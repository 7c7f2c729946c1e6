"""The page on the plain methods shows the code that the package is checked against."""

import ast
import re
from pathlib import Path

from benchmarks import plain
from tests.docs.pages import DOCS, run, text_of

import tvsysid as tv

PAGE = text_of("plain-methods.md")


def test_the_page_shows_every_function_of_the_file():
    parts = ast.parse(Path(plain.__file__).read_text(encoding="utf-8")).body
    shown = re.findall(
        r"^```{literalinclude} \.\./benchmarks/plain\.py\n:pyobject: (\w+)\n:language: python$",
        PAGE,
        re.MULTILINE,
    )
    assert sorted(shown) == sorted(part.name for part in parts if isinstance(part, ast.FunctionDef))


def test_every_method_has_its_section():
    assert set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^## .+", PAGE, re.MULTILINE)))) == set(
        tv.methods.PAPER_METHODS
    )


def test_the_example_runs(monkeypatch):
    monkeypatch.chdir(DOCS.parent)
    monkeypatch.syspath_prepend("")  # so that what the example adds to sys.path is taken away again
    run("plain-methods.md")
