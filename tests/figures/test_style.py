import re
from xml.etree import ElementTree

import pytest
from tests.synthetic import responses_of

from tvsysid.figures import drawn, impulse_responses, save


@pytest.mark.parametrize(("ending", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")])
def test_files_are_whole_and_the_same_each_time(tmp_path, ending, start):
    for name in ("one", "two"):
        save(impulse_responses(responses_of()), tmp_path / f"{name}.{ending}")
    one, two = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("one", "two"))
    assert one.startswith(start)
    assert one == two
    assert len(list(tmp_path.iterdir())) == 2


def test_text_of_an_svg_stays_text():
    root = ElementTree.fromstring(drawn(impulse_responses(responses_of()), "svg"))
    texts = {element.text for element in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"lag (s)", "k = 50 N·m/rad, at 0.25 s", "truth", "eirf"} <= texts


def test_a_pdf_has_no_type_3_fonts():
    assert not re.search(rb"/Subtype\s*/Type3", drawn(impulse_responses(responses_of()), "pdf"))


def test_a_figure_that_cannot_be_drawn_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="not supported"):
        save(impulse_responses(responses_of()), tmp_path / "figure.doc")
    assert list(tmp_path.iterdir()) == []
