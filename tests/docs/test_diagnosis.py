"""What the page on findings says is what the package looks for."""

import re
from pathlib import Path

import pytest

from tvsysid.quality import FAULTS

PAGE = (Path(__file__).parents[2] / "docs" / "diagnosis.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^### `([\w-]+)`(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL))


def test_it_lists_every_finding_and_no_other():
    assert list(SECTIONS) == list(FAULTS)
    assert f"{len(FAULTS)} things" in PAGE


@pytest.mark.parametrize("name", FAULTS)
def test_each_has_its_limit_effect_and_remedy(name):
    kind, told = FAULTS[name], " ".join(SECTIONS[name].split())
    assert told.lower().startswith(f": {kind.title.lower()} ")
    assert f"Measure: {kind.measure}; wrong {kind.wrong} {kind.limit:g} {kind.unit}." in told
    assert f"Effect: {kind.effect}." in told
    assert f"Remedy: {kind.remedy}." in told
