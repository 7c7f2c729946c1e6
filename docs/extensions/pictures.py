"""Pictures: that of an example is the ``figure`` that it makes, as the package saves it.

Each opens by itself.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

import tvsysid as tv
from tvsysid.figures.style import PALETTE

if TYPE_CHECKING:  # its test has no Sphinx
    from sphinx.application import Sphinx

PICTURE = re.compile(r'<img (?=[^>]*alt="[^"])[^>]*src="([^"]+)"[^>]*>')  # a thumbnail has no text


def use_palette(settings: dict[str, Any], file: str) -> None:
    """Draw what an example gives no colour in the package's, which all eyes tell apart."""
    matplotlib.rcParams["axes.prop_cycle"] = matplotlib.cycler(color=PALETTE)


def scrape(block: tuple[Any, ...], found: dict[str, Any], settings: dict[str, Any]) -> str:
    """Save the ``figure`` of a block of code, if it made one; its text is the example's title."""
    from sphinx_gallery.scrapers import figure_rst  # noqa: PLC0415

    figure = found["example_globals"].pop("figure", None)
    if figure is None:
        return ""
    path = next(found["image_path_iterator"])
    tv.figures.save(figure, path)
    source = ast.parse(Path(found["src_file"]).read_text(encoding="utf-8"))
    title = (ast.get_docstring(source) or "").strip().splitlines()[0]
    return str(figure_rst([path], settings["src_dir"], f"Picture of this example: {title}"))


def link(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Make each picture a link to itself, because a page shows it smaller than it is."""
    if "body" in context:
        context["body"] = PICTURE.sub(r'<a class="picture" href="\1">\g<0></a>', context["body"])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register what is done to pages with pictures."""
    app.connect("html-page-context", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
