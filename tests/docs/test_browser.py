"""The page for the browser: its code runs in a native Python, and gives the answers that it states.

`tests/browser` runs it in Chromium.
"""

import hashlib
import importlib.util
import json
import re
from pathlib import Path

import pytest

import tvsysid as tv

DOCS = Path(__file__).parents[2] / "docs"


def module(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


RUN = module(DOCS / "static/browser/run.py").run
FIRST, *EXERCISES = re.findall(
    r"^## (.+?)\n(.+?)(?=^## )", (DOCS / "browser.md").read_text("utf-8"), re.M | re.S
)


def code_of(section):
    (code,) = re.findall(r"^```python\n(.+?)^```", section, re.MULTILINE | re.DOTALL)
    return code


def choices(code):
    """As ``page.js`` reads them: first value and others, by name."""
    found = re.findall(r"^(\w+) = (.+?)  # or ([^;\n]+)(?:; .+)?$", code, re.MULTILINE)
    return {name: [first, *others.split(" or ")] for name, first, others in found}


def chosen(code, line):
    name = line.partition(" = ")[0]
    return re.sub(rf"^{name} = .+?(?=  #)", lambda _: line, code, flags=re.MULTILINE)


def long(number):
    return [pytest.mark.slow] if number >= 2 else []


@pytest.mark.parametrize(
    "section",
    [
        pytest.param(text, id=title, marks=long(int(title.split()[1][0])))
        for title, text in EXERCISES
    ],
)
def test_an_exercise_gives_the_answers_that_are_stated(section):
    code = code_of(section)
    stated = re.findall(
        r"^`(\w+ = [^`]+)`\n\n```text\n(.+?)^```", section, re.MULTILINE | re.DOTALL
    )
    (values,) = choices(code).values()
    assert len(stated) >= 2
    for line, text in stated:
        assert line.partition(" = ")[2] in values
        found = json.loads(RUN(chosen(code, line)))
        assert found["error"] is None
        assert found["text"] == text
    *models, truth = found["curves"]
    assert truth["name"] == "truth"
    assert all(len(curve["lower"]) == len(truth["values"]) == 200 for curve in models)


def test_the_first_block_and_all_of_its_choices():
    assert len(EXERCISES) == 4
    code = code_of(FIRST[1])
    verbs = {"perturbation": "generate", "stiffness": "__call__"}
    assert set(choices(code)) == {"stiffness", "perturbation", "duration", "noise", "method"}
    for name, values in choices(code).items():
        for value in values:
            made = eval(value, {"tv": tv})
            assert (
                hasattr(made, verbs[name])
                if name in verbs
                else made in tv.methods.METHODS or made >= 0
            ), (
                name,
                value,
            )
    (estimate, truth) = json.loads(RUN(chosen(code, 'method = "sds"')))["curves"]
    assert 0.5 < estimate["holds"] < 1
    assert {50.0, 150.0} == set(truth["values"])


def test_errors_and_warnings_are_read():
    assert json.loads(RUN("import tvsysid as tv\ntv.ShortDataSegments(window=-1)"))["error"] == (
        "Line 2: InputError: ShortDataSegments: window must be a number of zero or more, got -1"
    )
    assert json.loads(RUN("x = 1\ndef f(:"))["error"].startswith("Line 2: SyntaxError: ")
    assert json.loads(RUN("raise SystemExit(3)"))["error"] == "Line 1: SystemExit: 3"
    warned = json.loads(
        RUN("import warnings, tvsysid\nwarnings.warn('few', tvsysid.DataQualityWarning)")
    )
    assert warned == {"text": "Warning: few\n", "error": None, "curves": []}


def test_a_file_that_is_not_the_one_meant_is_refused(tmp_path, monkeypatch):
    get = module(DOCS / "get_pyodide.py")
    listed = {
        "info": {},
        "packages": {name: {"name": name} for name in ("numpy", "scipy", "pandas")},
    }
    there = {"a": b"1", "b": b"2", get.LIST: json.dumps(listed).encode()}
    meant = there | {get.LIST: get.shortened(there[get.LIST])}
    monkeypatch.setattr(
        get, "FILES", {name: hashlib.sha256(content).hexdigest() for name, content in meant.items()}
    )
    get.keep(there.__getitem__, tmp_path / "kept")
    assert set(json.loads((tmp_path / "kept" / get.LIST).read_text())["packages"]) == {
        "numpy",
        "scipy",
    }
    with pytest.raises(SystemExit, match=r"b: its SHA-256 is .*, expected"):
        get.keep((there | {"b": b"3"}).__getitem__, tmp_path / "refused")
    listed["packages"]["numpy"]["file_name"] = "https://elsewhere.org/numpy.whl"
    with pytest.raises(SystemExit, match=r"pyodide-lock\.json: its SHA-256 is .*, expected"):
        get.keep(
            (there | {get.LIST: json.dumps(listed).encode()}).__getitem__, tmp_path / "refused"
        )
    assert not (tmp_path / "refused").exists()
