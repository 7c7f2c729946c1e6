"""No file of a method is long."""

from pathlib import Path

import pytest

from tvsysid import methods

ROOM = Path(methods.__file__).parent


@pytest.mark.parametrize(
    "file", sorted(ROOM.rglob("*.py")), ids=lambda file: str(file.relative_to(ROOM))
)
def test_no_file_is_long(file):
    assert len(file.read_text(encoding="utf-8").splitlines()) <= 400
