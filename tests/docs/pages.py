"""The pages of the documentation."""

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def text_of(page):
    return (DOCS / page).read_text(encoding="utf-8")


def blocks(page, language="python"):
    """Return the blocks of code of a page in a language, or in none."""
    found = re.findall(r"^```(\w*)\n(.+?)\n^```$", text_of(page), re.MULTILINE | re.DOTALL)
    return [block for name, block in found if name == language]


def run(page):
    """Run the examples in Python of a page one after the other, and return their names."""
    names = {}
    for code in blocks(page):
        exec(code, names)
    return names
