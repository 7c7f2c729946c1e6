"""Test that methods are distinguishable on white paper, by colour and by more than colour."""

import numpy as np

from tvsysid.figures.style import PALETTE, TRUTH, lines
from tvsysid.methods import METHODS

LUMINANCE = np.array([0.2126729, 0.7151522, 0.0721750])


def linear(colour):
    part = np.array([int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)])
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def test_contrast_on_white():
    for colour in (*PALETTE, TRUTH):
        assert 1.05 / (linear(colour) @ LUMINANCE + 0.05) >= 3


def test_each_method_has_its_own_colour_and_marker_and_settings_are_dashed():
    looks = lines([*METHODS, "sds:window=0.2", "ShortDataSegments(window=0.3)"])
    for key in ("color", "marker"):
        assert len({looks[method][key] for method in METHODS}) == len(METHODS)
    dashed = [label for label, look in looks.items() if look["linestyle"] != "-"]
    assert dashed == ["sds:window=0.2", "ShortDataSegments(window=0.3)"]
    assert looks["ShortDataSegments(window=0.3)"]["color"] == looks["sds"]["color"]
    assert lines(["sds"])["sds"]["marker"] == ""
