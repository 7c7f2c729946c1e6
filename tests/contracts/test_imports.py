"""Imports go one way, and the package is light until it is used."""

import ast
import collections
import graphlib
import subprocess
import sys
import types
from pathlib import Path

import cloudpickle
import pytest

import tvsysid

PACKAGE = Path(tvsysid.__file__).parent
# From the bottom up. A file imports from lower floors, or from other rooms of its own floor.
FLOORS = [
    ["errors", "validators", "numerics", "progress"],
    ["arrays", "signals", "models", "dataset_layout"],
    ["recordings", "preprocess", "simulate", "metrics"],
    ["methods"],
    ["quality"],
    ["recommendation", "comparison", "uncertainty", "planning", "check"],
    ["study"],
    ["figures", "report"],
    ["studies", "explorer", "cli"],
]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}


def room_of(module: str) -> str:
    return module.split(".")[1]


def modules_imported(tree: ast.AST) -> set[str]:
    """Return the modules of the package that a file imports, at once or later.

    The method ``plot`` may import the figure that it shows. Imports for types do not run.
    """
    for node in ast.walk(tree):
        is_plot = isinstance(node, ast.FunctionDef) and node.name == "plot"
        if is_plot or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            node.body = []
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                names.add(name if name in MODULES else node.module)
    return names & MODULES.keys()


FILES = sorted(file for file in PACKAGE.rglob("*.py") if file != PACKAGE / "__init__.py")
MODULES = {
    ".".join(("tvsysid", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(
        ".__init__"
    ): file
    for file in FILES
}


@pytest.fixture(scope="module")
def imports():
    return {
        module: modules_imported(ast.parse(file.read_text(encoding="utf-8")))
        for module, file in MODULES.items()
    }


def test_imports_run_down(imports):
    upward = [
        (module, each)
        for module, imported in imports.items()
        for each in imported
        if FLOOR[room_of(each)] > FLOOR[room_of(module)]
    ]
    assert upward == []


@pytest.mark.parametrize("name", [str, room_of], ids=["files", "rooms"])
def test_imports_make_no_circle(imports, name):
    graph = collections.defaultdict(set)
    for module, imported in imports.items():
        graph[name(module)] |= set(map(name, imported)) - {name(module)}
    graphlib.TopologicalSorter(graph).prepare()


def test_truth_cannot_leak_into_an_estimator(imports):
    for module, imported in imports.items():
        if room_of(module) == "methods":
            assert "simulate" not in map(room_of, imported)


def test_no_room_for_everything():
    for file in PACKAGE.rglob("*"):
        assert file.stem not in {"utils", "helpers", "common", "misc"}


@pytest.mark.slow
def test_identification_and_diagnosis_need_no_pictures_tables_and_stores():
    program = """
import sys, tvsysid as tv
heavy = {"matplotlib", "dask", "xarray", "pandas", "jinja2", "scipy.signal", "scipy.stats"}
print("import", {"scipy", *heavy} & set(sys.modules) or "light")
tv.ShortDataSegments(), tv.simulate.Joint, tv.metrics.vaf
print("identification", heavy & set(sys.modules) or "light")
import numpy as np
x = np.random.default_rng(0).normal(size=(10, 100))
ensemble = tv.Ensemble(x, x + 1, 100.0)
repr(tv.diagnose(ensemble))
print("diagnosis", heavy & set(sys.modules) or "light")
found = tv.compare(ensemble, ["birf"])
found.held_out_vaf, found.vaf
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
