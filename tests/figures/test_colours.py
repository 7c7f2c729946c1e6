"""Test that methods are distinguishable by colour on white paper, and by more than colour.

Colours also suffice without one kind of cone.
"""

import numpy as np
import pytest

from tvsysid.figures.style import MARKERS, PALETTE, TRUTH, lines
from tvsysid.methods import METHODS, STUDIED_METHODS

# What is left of linear RGB without the cone for red, green or blue: Machado, Oliveira and
# Fernandes 2009, severity 1.
EYES = {
    "all cones": np.eye(3),
    "no red": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "no green": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "no blue": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.119192, 0.9503041],
    ]
)


def linear(colour):
    part = np.array([int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)])
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def lab(colour, eye):
    relative = TO_XYZ @ np.clip(np.asarray(EYES[eye]) @ linear(colour), 0, 1) / TO_XYZ.sum(axis=1)
    f = np.where(relative > 216 / 24389, np.cbrt(relative), (24389 / 27 * relative + 16) / 116)
    return 116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])


def distance(one, other, eye):
    return ciede2000(lab(one, eye), lab(other, eye))


def ciede2000(one, other):
    (l1, a1, b1), (l2, a2, b2) = one, other
    mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    stretch = 1.5 - 0.5 * np.sqrt(mean**7 / (mean**7 + 25**7))
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = np.arctan2(b1, stretch * a1), np.arctan2(b2, stretch * a2)
    turn = (h2 - h1 + np.pi) % (2 * np.pi) - np.pi
    hue, chroma, light = h1 + turn / 2, (c1 + c2) / 2, (l1 + l2) / 2 - 50
    t = (
        1
        - 0.17 * np.cos(hue - np.pi / 6)
        + 0.24 * np.cos(2 * hue)
        + 0.32 * np.cos(3 * hue + np.radians(6))
    )
    t -= 0.2 * np.cos(4 * hue - np.radians(63))
    bend = np.exp(-(((np.degrees(hue) % 360 - 275) / 25) ** 2))
    rotation = -2 * np.sqrt(chroma**7 / (chroma**7 + 25**7)) * np.sin(np.radians(60 * bend))
    parts = (
        (l2 - l1) / (1 + 0.015 * light**2 / np.sqrt(20 + light**2)),
        (c2 - c1) / (1 + 0.045 * chroma),
        2 * np.sqrt(c1 * c2) * np.sin(turn / 2) / (1 + 0.015 * chroma * t),
    )
    return np.sqrt(sum(part**2 for part in parts) + rotation * parts[1] * parts[2])


def test_contrast_on_white():
    for colour in (*PALETTE, TRUTH):
        assert 1.05 / (linear(colour) @ TO_XYZ[1] + 0.05) >= 3


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize(("count", "least"), [(6, 19), (9, 10.5), (15, 8)])
def test_colours_differ(eye, count, least):
    assert len(PALETTE) >= len(METHODS)
    assert {list(METHODS).index(key) for key in STUDIED_METHODS} == set(range(6))
    pairs = [(one, other) for place, one in enumerate(PALETTE[:count]) for other in PALETTE[:place]]
    assert min(distance(*pair, eye) for pair in pairs) > least


@pytest.mark.parametrize("eye", EYES)
def test_the_truth_looks_like_no_method_of_the_usual_ones(eye):
    assert min(distance(TRUTH, colour, eye) for colour in PALETTE[:6]) > 17


def test_the_distance_is_that_of_its_authors():
    # Sharma, Wu and Dalal 2005, table 1: pairs 1, 17 and 20.
    pairs = [
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((50, 2.5, 0), (58, 24, 15), 19.4535),
    ]
    for one, other, published in pairs:
        assert ciede2000(one, other) == pytest.approx(published, abs=1e-4)


def test_methods_have_markers_and_settings_are_hollow():
    looks = lines([*METHODS, "sds:window=0.2", "ShortDataSegments(window=0.3)"])
    assert len({looks[key]["marker"] for key in METHODS}) == len(METHODS) == len(MARKERS)
    hollow = [label for label, look in looks.items() if look["markerfacecolor"] == "white"]
    assert hollow == ["sds:window=0.2", "ShortDataSegments(window=0.3)"]
    assert looks["ShortDataSegments(window=0.3)"]["color"] == looks["sds"]["color"]
    assert lines(["sds"])["sds"]["marker"] == ""
