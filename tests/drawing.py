"""Drawing without a picture."""

import warnings

from matplotlib.style import context

from tvsysid.figures.style import LOOK


def draw(figure):
    """Lay out and draw a figure, but on no canvas: in half the time of `tvsysid.figures.drawn`."""
    with context(LOOK), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        figure.get_layout_engine().execute(figure)
        figure.set_layout_engine(None)
        figure.draw_without_rendering()
