"""The page that runs tvsysid in the reader's browser: its scripts, and the packages that they load.

Pyodide, NumPy and SciPy are what ``docs/get_pyodide.py`` fetched; without them the page says so.
"""

import importlib.util
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

from sphinx.application import Sphinx

PAGE = "browser"
PACKAGES = ("tvsysid", "lazy_loader", "threadpoolctl")  # pure Python, as they are installed here


def fetched(app: Sphinx) -> bool:
    """Whether Python for browsers is there."""
    return (Path(app.srcdir) / "static/pyodide/pyodide.mjs").exists()


def add_scripts(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Give the page its script and style, and no other page."""
    if page == PAGE:
        app.add_css_file("browser/page.css")
        app.add_js_file(
            "browser/page.js",
            loading_method="defer",
            **{"data-pyodide": "yes" if fetched(app) else ""},
        )


def files_of(package: str) -> list[tuple[Path, str]]:
    """Files of an installed package or module, and their names in the archive."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    origin = Path(spec.origin)
    if origin.name != "__init__.py":
        return [(origin, origin.name)]
    sources = (path for path in sorted(origin.parent.rglob("*")) if path.suffix in {".py", ".pyi"})
    return [(path, f"{package}/{path.relative_to(origin.parent)}") for path in sources]


def pack(app: Sphinx, error: Exception | None) -> None:
    """Put tvsysid and what it needs beside Pyodide, in one archive."""
    if error is None and fetched(app):
        with ZipFile(
            Path(app.outdir) / "_static/pyodide/packages.zip", "w", ZIP_DEFLATED
        ) as archive:
            for package in PACKAGES:
                for path, name in files_of(package):
                    archive.write(path, name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register both."""
    app.connect("html-page-context", add_scripts)
    app.connect("build-finished", pack)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
