"""Draw figures once and save them in all formats."""

from __future__ import annotations

import base64
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs

from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOK: Path = Path(__file__).with_name("tvsysid.mplstyle")
PAGE_DPI = 108
# A date would make each file a new one.
UNDATED = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


@attrs.frozen
class Illustration:
    """A figure that is still to be drawn, and its content in words.

    ``draw`` returns the figure. The description, in full sentences, stands for the picture where
    it cannot be seen.
    """

    draw: Callable[[], Figure]
    title: str
    description: str = ""


def illustrated(draw: Callable[..., Any], *data: Any, title: str, text: str) -> Illustration:
    """Return the figure that a function draws of data, with its title and its content in words."""
    return Illustration(partial(draw, *data, title=title), title, text)


@attrs.frozen
class Picture:
    """Drawn figure: its files by their format, and its size on a page in pixels."""

    title: str
    description: str
    width: int
    height: int
    contents: Mapping[str, bytes]

    @property
    def source(self) -> str:
        """The picture itself as the address of an image."""
        return "data:image/svg+xml;base64," + base64.b64encode(self.contents["svg"]).decode()


def draw_all(
    illustrations: Mapping[str, Illustration],
    folder: str | Path | None = None,
    call_each: Callable[..., Iterator[Any]] = map,
) -> dict[str, Picture]:
    """Draw figures, and save each as SVG, PNG and PDF.

    Parameters
    ----------
    illustrations
        By the stem of the file's name, which may name a folder too, as in ``"participants/P1"``.
    folder
        Where the files go; each appears whole or not at all. None saves nothing.
    call_each
        Calls a function of each item. The ``map`` of an executor draws in its workers.
    """
    formats = ("svg",) if folder is None else ("svg", "png", "pdf")
    drawn_each = call_each(partial(_draw, formats=formats), illustrations.values())
    pictures = dict(zip(illustrations, drawn_each, strict=True))
    for stem, picture in pictures.items() if folder else ():
        for format, content in picture.contents.items():
            _write(content, f"{folder}/{stem}.{format}")
    return pictures


def _draw(illustration: Illustration, formats: Sequence[str]) -> Picture:
    figure = illustration.draw()
    contents = {format: drawn(figure, format) for format in formats}
    size = size_in_pixels(figure)
    return Picture(illustration.title, illustration.description, *size, contents)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure whole, and close it in pyplot.

    Its ending says in which format: svg, pdf or png.
    """
    from matplotlib import pyplot  # noqa: PLC0415  # heavy

    _write(drawn(figure, Path(path).suffix.removeprefix(".")), path)
    pyplot.close(figure)


def _write(content: bytes, path: str | Path) -> None:
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def drawn(figure: Figure, format: str) -> bytes:
    """Return a figure as the content of an SVG (with text as text), PDF or PNG file.

    The same figure, the same bytes.
    """
    from matplotlib.style import context  # noqa: PLC0415  # heavy

    content = BytesIO()
    with context(LOOK), warnings.catch_warnings():
        # Chinese characters, for example. The SVG shows them.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        if (engine := figure.get_layout_engine()) is not None:
            # Laid out once for all formats.
            engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(content, format=format, metadata=UNDATED.get(format))
    return content.getvalue()


def size_in_pixels(figure: Figure) -> tuple[int, int]:
    """Return width and height of a figure on a page."""
    width, height = figure.get_size_inches()
    return round(PAGE_DPI * width), round(PAGE_DPI * height)
