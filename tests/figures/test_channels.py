from xml.etree import ElementTree

import numpy as np
import pytest
from tests.drawing import draw

from tvsysid.figures import drawn, recorded_channels
from tvsysid.recordings import Channel


def test_axes_have_units_and_time_where_they_are_stated():
    values = np.sin(np.arange(100) / 10)
    channels = {
        "pos $x$": Channel((100,), "float64", "rad", 50.0, values=lambda: values),
        "tq": Channel((100, 2), "float64", values=lambda: np.stack([values, -values], axis=1)),
    }
    figure = recorded_channels(channels, "ankle_$1$.mat")
    draw(figure)
    first, second = figure.axes
    assert [axes.get_title("left") for axes in figure.axes] == ["pos $x$", "tq"]
    assert (first.get_xlabel(), first.get_ylabel()) == ("time (s)", "rad")
    assert (second.get_xlabel(), second.get_ylabel()) == ("sample", "unit not stated")
    np.testing.assert_array_equal(first.lines[0].get_xdata(), np.arange(100) / 50)
    np.testing.assert_array_equal(second.lines[1].get_ydata(), -values)


@pytest.mark.slow
def test_names_are_drawn_letter_by_letter():
    names = ["x_{$", "$\\frac{$", "\x1b[31mred\r\x07", "caf\udce9\u202e", "角度"]
    figure = recorded_channels(
        {name: Channel((100,), "float64", name, values=lambda: np.arange(100.0)) for name in names},
        "".join(names),
    )
    for form in ("png", "pdf", "svg"):
        content = drawn(figure, form)
    assert all(
        texts in content.decode()
        for texts in ("x_{$", "角度", r"\x1b[31mred\r\x07", r"caf\udce9\u202e")
    )
    ElementTree.fromstring(content)
