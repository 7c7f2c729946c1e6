"""Options of the command line in one piece: a browser would break a line behind their hyphens."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # its test has no Sphinx
    from sphinx.application import Sphinx

TAG_OR_OPTION = re.compile(r"<[^>]*>|(?<![\w-])--[a-z][\w-]*")


def join(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Mark the options in the text of a page; its style sheet says that they are not broken."""
    if "body" in context:
        context["body"] = TAG_OR_OPTION.sub(_marked, context["body"])


def _marked(found: re.Match[str]) -> str:
    return found[0] if found[0].startswith("<") else f'<span class="option">{found[0]}</span>'


def setup(app: Sphinx) -> dict[str, bool]:
    """Register what is done to pages with options."""
    app.connect("html-page-context", join)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
