"""The picture of an example: the ``figure`` that it makes, drawn as the package saves it."""

import ast
from pathlib import Path
from typing import Any

import matplotlib
from sphinx_gallery.scrapers import figure_rst

import tvsysid as tv
from tvsysid.figures.style import PALETTE


def use_palette(settings: dict[str, Any], file: str) -> None:
    """Draw what an example gives no colour in the package's, which all eyes tell apart."""
    matplotlib.rcParams["axes.prop_cycle"] = matplotlib.cycler(color=PALETTE)


def scrape(block: tuple[Any, ...], found: dict[str, Any], settings: dict[str, Any]) -> str:
    """Save the ``figure`` of a block of code, if it made one; its text is the example's title."""
    figure = found["example_globals"].pop("figure", None)
    if figure is None:
        return ""
    path = next(found["image_path_iterator"])
    tv.figures.save(figure, path)
    source = ast.parse(Path(found["src_file"]).read_text(encoding="utf-8"))
    title = (ast.get_docstring(source) or "").strip().splitlines()[0]
    return str(figure_rst([path], settings["src_dir"], f"Picture of this example: {title}"))
