"""Test that methods are distinguishable by colour on white paper, and by more than colour.

Colours also suffice without one kind of cone.
"""

import numpy as np
import pytest

from tvsysid.figures.style import MARKERS, PALETTE, TRUTH, lines
from tvsysid.methods import DEFAULT_METHODS, METHODS

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
    """Return the CIE 1976 colour difference; about 2.3 is just noticeable."""
    return np.linalg.norm(np.subtract(lab(one, eye), lab(other, eye)))


def test_contrast_on_white():
    for colour in (*PALETTE, TRUTH):
        assert 1.05 / (linear(colour) @ TO_XYZ[1] + 0.05) >= 3


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize(("count", "least"), [(6, 22), (9, 13), (15, 10)])
def test_colours_differ(eye, count, least):
    assert len(PALETTE) >= len(METHODS)
    assert {list(METHODS).index(key) for key in DEFAULT_METHODS} == set(range(6))
    pairs = [(one, other) for place, one in enumerate(PALETTE[:count]) for other in PALETTE[:place]]
    assert min(distance(*pair, eye) for pair in pairs) > least


@pytest.mark.parametrize("eye", EYES)
def test_the_truth_looks_like_no_method_of_the_usual_ones(eye):
    assert min(distance(TRUTH, colour, eye) for colour in PALETTE[:6]) > 17


def test_methods_have_markers_and_settings_are_hollow():
    looks = lines([*METHODS, "sds:window=0.2", "ShortDataSegments(window=0.3)"])
    assert len({looks[key].marker for key in METHODS}) == len(METHODS) == len(MARKERS)
    assert looks["sds:window=0.2"].hollow
    assert not looks["sds"].hollow
    assert looks["ShortDataSegments(window=0.3)"].hue == looks["sds"].hue
    assert lines(["sds"])["sds"].marker == ""
