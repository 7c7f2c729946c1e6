"""A figure that a notebook shows, whatever its backend.

Apart, because it takes Matplotlib to define it.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.style import context

PIXELS = 96  # to the inch, on a page
FINE = 2  # times as many are drawn, for screens that have them


class OwnFigure(Figure):
    """Figure without pyplot, which would show it a second time and keep it in memory."""

    look: Path  # style sheet with which it is drawn

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        content = BytesIO()
        with context(self.look):
            self.savefig(content, format="png", dpi=FINE * PIXELS)
        width, height = (round(PIXELS * float(inches)) for inches in self.get_size_inches())
        return content.getvalue(), {"width": width, "height": height}
