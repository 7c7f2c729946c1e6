import re
from xml.etree import ElementTree

import pytest
from matplotlib.style import context
from tests.drawing import draw
from tests.synthetic import responses_of

from tvsysid.figures import drawn, impulse_responses, save
from tvsysid.figures.style import LOOK, finish, panels


@pytest.fixture(scope="module")
def twins():
    return [impulse_responses(responses_of()) for _ in range(2)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")]
)
def test_files_are_whole_and_the_same_each_time(tmp_path, twins, ending, start):
    for name, figure in zip(("one", "two"), twins, strict=True):
        save(figure, tmp_path / f"{name}.{ending}")
    one, two = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("one", "two"))
    assert one.startswith(start)
    assert one == two
    assert len(list(tmp_path.iterdir())) == 2


def test_text_of_an_svg_stays_text(twins):
    root = ElementTree.fromstring(drawn(twins[0], "svg"))
    texts = {element.text for element in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"lag (s)", "k = 50 N·m/rad, at 0.25 s", "truth", "eirf"} <= texts


def test_a_pdf_has_no_type_3_fonts(twins):
    assert not re.search(rb"/Subtype\s*/Type3", drawn(twins[0], "pdf"))


@pytest.mark.parametrize("lengths", [(5, 5, 5), (40, 3, 3, 3, 40, 12), (70,) * 4, (8,) * 13])
def test_a_legend_below_fits_the_figure(lengths):
    with context(LOOK):
        figure, ((axes,),) = panels(1, 1, 7, 3)
        for number, length in enumerate(lengths):
            axes.plot([], label=f"{number:0>{length}}")
        finish(figure)
    draw(figure)
    (legend,) = figure.legends
    assert [len(text.get_text()) for text in legend.texts] == list(lengths)
    box = legend.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
