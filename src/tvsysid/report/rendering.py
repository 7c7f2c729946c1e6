"""How the content of a page becomes a file, and what all pages hold."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.figures import Picture
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    import xarray as xr


def write_page(path: str | Path, template: str, content: Mapping[str, Any]) -> None:
    """Fill a template of this room and write the page, which appears whole or not at all."""
    page = filled(template, content)
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def filled(template: str, content: Mapping[str, Any]) -> str:
    """Page or part of one: a template of this room with its content, escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  # heavy

    environment = Environment(
        loader=PackageLoader("tvsysid.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(content)


def embedded(pictures: Mapping[str, Picture]) -> list[dict[str, Any]]:
    """Pictures as the templates take them."""
    return [{"stem": stem, **embedded_one(each)} for stem, each in pictures.items()]


def embedded_one(picture: Picture) -> dict[str, Any]:
    """Picture as the source of an image, with its size in pixels, title and description."""
    return {
        "title": picture.title,
        "description": picture.description,
        "source": "data:image/svg+xml;base64," + base64.b64encode(picture.svg).decode(),
        "width": picture.width,
        "height": picture.height,
    }


def settings_of(results: xr.Dataset, name: str) -> dict[str, Any]:
    """Attribute that holds settings as JSON text; empty where it is missing or is something else."""
    try:
        settings = json.loads(results.attrs.get(name, "{}"))
    except (TypeError, ValueError):
        return {}
    return settings if isinstance(settings, dict) else {}


def words(value: Any) -> str:
    """Setting as text.

    Examples
    --------
    >>> words([1.0, "eirf", None]), words({"alignment": 2})
    ('1, eirf, none', 'alignment 2')
    """
    if isinstance(value, list):
        return ", ".join(map(words, value))
    if isinstance(value, dict):
        return ", ".join(f"{name} {words(each)}" for name, each in value.items())
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
