"""Imports go one way, and the package is light until it is used."""

import ast
import re
import subprocess
import sys
import types
from pathlib import Path

import cloudpickle
import pytest

import tvsysid

PACKAGE = Path(tvsysid.__file__).parent
# From the foundations up; rooms on one line do not import each other.
LEVELS = [
    ["errors", "limits"],
    ["numerics", "showing"],
    ["checked", "validators"],
    ["signals", "impedance", "estimates"],
    ["models"],
    ["preprocess"],
    ["recordings", "simulate", "methods", "metrics"],
    ["quality"],
    ["recommendation"],
    ["uncertainty", "comparison"],
    ["study", "check", "planning"],
    ["figures"],
    ["report"],
    ["studies", "explorer"],
    ["cli"],
]
LEVEL = {room: number for number, rooms in enumerate(LEVELS) for room in rooms}


def room_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_rooms(file: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(file.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "tvsysid":
                names = [f"tvsysid.{alias.name}" for alias in node.names]
        rooms |= {name.split(".")[1] for name in names if name.startswith("tvsysid.")}
    return rooms


FILES = sorted(file for file in PACKAGE.rglob("*.py") if room_of(file) != "__init__")


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_go_one_way(file):
    room = room_of(file)
    for other in imported_rooms(file) - {room, "__version__"}:
        assert LEVEL[other] < LEVEL[room], f"{room} must not import {other}"


def test_truth_cannot_leak_into_an_estimator():
    for file in FILES:
        if room_of(file) == "methods":
            assert "simulate" not in imported_rooms(file)


def test_no_room_for_everything():
    for file in PACKAGE.rglob("*"):
        assert file.stem not in {"utils", "helpers", "common", "misc"}


def test_headings_of_docstrings_stand_above_their_lines():
    for file in PACKAGE.rglob("*.py"):
        assert not re.search(
            r"\w +-{3,}$|^ *-{5,} *\w", file.read_text(encoding="utf-8"), re.MULTILINE
        ), file


@pytest.mark.slow
def test_identification_and_diagnosis_need_no_pictures_tables_and_stores():
    program = """
import sys, tvsysid as tv
heavy = {"matplotlib", "zarr", "dask", "xarray", "pandas", "jinja2", "scipy.signal", "scipy.stats"}
print("import", {"scipy", *heavy} & set(sys.modules) or "light")
tv.ShortDataSegments(), tv.simulate.Joint, tv.metrics.vaf
print("identification", heavy & set(sys.modules) or "light")
import numpy as np
x = np.random.default_rng(0).normal(size=(10, 100))
ensemble = tv.Ensemble(x, x + 1, 100.0)
repr(tv.diagnose(ensemble))
print("diagnosis", heavy & set(sys.modules) or "light")
found = tv.compare(ensemble, ["birf"])
found.held_out_vaf(2), found.rows(), found.rows_over_time()
print("comparison", heavy & set(sys.modules) or "light")
"""
    command = [sys.executable, "-W", "ignore", "-c", program]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert shown.splitlines() == [
        "import light",
        "identification light",
        "diagnosis light",
        "comparison light",
    ]


def test_no_public_name_is_that_of_the_module_that_has_it():
    # The module would take the name's place once it is imported; and what guards against that
    # cannot be pickled, so
    # that no method of a script that uses the package would reach a worker.
    for package in (tvsysid, tvsysid.figures, tvsysid.recordings, tvsysid.report):
        assert type(package) is types.ModuleType
        assert cloudpickle.loads(cloudpickle.dumps(package)) is package
