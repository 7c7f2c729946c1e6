import pytest
from matplotlib.style import context
from tests.drawing import draw

from tvsysid.figures.style import LOOK, finish, panels


@pytest.mark.parametrize("lengths", [(5, 5, 5), (40, 3, 3, 3, 40, 12), (70,) * 4, (8,) * 13])
def test_a_legend_below_fits_the_figure(lengths):
    with context(LOOK):
        figure, ((axes,),) = panels("", (6.2, 1.9))
        for number, length in enumerate(lengths):
            axes.plot([], label=f"{number:0>{length}}")
        finish(figure)
    draw(figure)
    (legend,) = figure.legends
    assert [len(text.get_text()) for text in legend.texts] == list(lengths)
    box = legend.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
