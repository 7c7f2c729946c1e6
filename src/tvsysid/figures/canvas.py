"""A figure that a notebook shows, whatever its backend.

Apart, because it takes Matplotlib to say what it is.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

PIXELS = 96  # to the inch, on a page
FINE = 2  # times as many are drawn, for screens that have them


class OwnFigure(Figure):
    """Figure without pyplot, which would show it a second time and never let it go."""

    look: dict[Any, Any]  # settings of Matplotlib with which it is drawn

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        content = BytesIO()
        with rc_context(self.look):
            self.savefig(content, format="png", dpi=FINE * PIXELS)
        width, height = (round(PIXELS * float(inches)) for inches in self.get_size_inches())
        return content.getvalue(), {"width": width, "height": height}
