"""From a template to a page that is complete in itself."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

from tvsysid.figures import Illustration, drawn


def filled(template: str, content: Mapping[str, Any]) -> str:
    """Page or part of one: a template of this package with its content, escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  # heavy

    environment = Environment(
        loader=PackageLoader("tvsysid.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(content)


def picture(illustration: Illustration) -> dict[str, Any]:
    """Figure as the source of an image, with its size in pixels, title and description."""
    figure = illustration.figure
    return {
        "title": illustration.title,
        "description": illustration.description,
        "source": "data:image/svg+xml;base64," + base64.b64encode(drawn(figure, "svg")).decode(),
        "width": round(96 * figure.get_figwidth()),
        "height": round(96 * figure.get_figheight()),
    }
