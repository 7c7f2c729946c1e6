"""A method's own file is read from top to bottom, and leans on few others."""

import ast
from pathlib import Path

import pytest

from tvsysid import methods

ROOM = Path(methods.__file__).parent


@pytest.mark.parametrize("file", ["eirf.py", "sds.py", "birf.py", "esm.py", "kbr/kbr.py"])
def test_a_method_imports_from_at_most_eight_modules_of_the_package(file):
    tree = ast.parse((ROOM / file).read_text(encoding="utf-8"))
    modules = {
        node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module
    }
    own = {module for module in modules if module.startswith("tvsysid")}
    assert len(own) <= 8, own


@pytest.mark.parametrize(
    "file", sorted(ROOM.rglob("*.py")), ids=lambda file: str(file.relative_to(ROOM))
)
def test_no_file_is_long(file):
    assert len(file.read_text(encoding="utf-8").splitlines()) <= 400
