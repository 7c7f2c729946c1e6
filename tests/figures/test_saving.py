from functools import partial
from xml.etree import ElementTree

import pytest
from tests.synthetic import responses_of

from tvsysid.figures import Illustration, draw_all, drawn, impulse_responses, save


def illustrations(count=2):
    responses = responses_of()
    return {
        f"folder/figure-{number}": Illustration(
            partial(impulse_responses, responses, f"Number {number}"), f"T{number}"
        )
        for number in range(count)
    }


@pytest.mark.slow
def test_every_form_is_saved_and_the_svg_returned(tmp_path):
    pictures = draw_all(illustrations(1), tmp_path)
    (picture,) = pictures.values()
    files = sorted(path.name for path in (tmp_path / "folder").iterdir())
    assert files == ["figure-0.pdf", "figure-0.png", "figure-0.svg"]
    assert picture.svg == (tmp_path / "folder" / "figure-0.svg").read_bytes()
    assert ElementTree.fromstring(picture.svg).tag.endswith("svg")
    assert (picture.title, picture.width, picture.height) == (
        "T0",
        round(96 * 7.2),
        round(96 * 3.6),
    )


def test_without_a_folder_only_the_page_gets_its_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drawing = partial(impulse_responses, responses_of())
    pictures = draw_all(
        {"a": Illustration(drawing, "A", endings=("png",)), "b": Illustration(drawing, "B")}
    )
    assert pictures["a"].svg == b""
    assert pictures["b"].svg
    assert list(tmp_path.iterdir()) == []


def test_a_figure_is_laid_out_once():
    figure = impulse_responses(responses_of())
    first = drawn(figure, "svg")
    assert figure.get_layout_engine() is None
    drawn(figure, "png")
    assert drawn(figure, "svg") == first


def test_a_figure_that_cannot_be_drawn_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="not supported"):
        save(impulse_responses(responses_of()), tmp_path / "figure.doc")
    assert list(tmp_path.iterdir()) == []
