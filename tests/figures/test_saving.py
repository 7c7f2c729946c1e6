import re
from xml.etree import ElementTree

import numpy as np
import pytest

from tvsysid.figures import Illustration, Visit, draw_all, drawn, save, stiffness_of_visits


def made():
    return stiffness_of_visits([Visit("May", *np.linspace(1, 2, 40).reshape(4, 10))], "Visits")


@pytest.mark.slow
def test_every_form_is_saved_and_the_svg_returned(tmp_path):
    illustrations = {"folder/figure": Illustration(made, "T0")}
    (picture,) = draw_all(illustrations, tmp_path).values()
    files = sorted(path.name for path in (tmp_path / "folder").iterdir())
    assert files == ["figure.pdf", "figure.png", "figure.svg"]
    assert picture.contents["svg"] == (tmp_path / "folder" / "figure.svg").read_bytes()
    assert (picture.title, picture.width, picture.height) == ("T0", 108 * 9, round(108 * 3.2))


def test_without_a_folder_only_the_page_gets_its_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert draw_all({"a": Illustration(made, "A")})["a"].contents["svg"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")]
)
def test_files_are_whole_and_the_same_each_time(tmp_path, ending, start):
    one, two = (tmp_path / f"{name}.{ending}" for name in ("one", "two"))
    for path in (one, two):
        save(made(), path)
    assert one.read_bytes().startswith(start)
    assert one.read_bytes() == two.read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_a_figure_is_laid_out_once_and_its_text_stays_text():
    figure = made()
    first = drawn(figure, "svg")
    assert figure.get_layout_engine() is None
    assert not re.search(rb"/Subtype\s*/Type3", drawn(figure, "pdf"))
    assert drawn(figure, "svg") == first
    root = ElementTree.fromstring(first)
    texts = {element.text for element in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"Visits", "time within a realization (s)", "stiffness (N·m/rad), 95 % band"} <= texts


def test_a_figure_that_cannot_be_drawn_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="not supported"):
        save(made(), tmp_path / "figure.doc")
    assert list(tmp_path.iterdir()) == []
