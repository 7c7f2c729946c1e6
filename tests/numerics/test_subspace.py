"""Subspace identification: systems that are exactly of its kind are found exactly."""

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebvander
from scipy.signal import lfilter

from tvsysid.numerics import subspace

LAGS, HORIZON = 4, 12
POLES = np.array([0.9 + 0.1j, 0.9 - 0.1j])
NUMERATOR = np.array([0.3, -0.2, 0.5])
WEIGHTS = np.array([0.6, -0.3, 0.2])
RESPONSE = np.array([1.0, -3.0, 8.0, -20.0, 40.0, -18.0, 7.0, -2.0, 0.5])


def record(random, samples=3000):
    """Angle, which is band-limited, inputs and torque, from long before the first sample."""
    angle = lfilter([1.0], [1.0, -1.2, 0.5], random.normal(size=samples + 2 * LAGS))
    speed = random.normal(size=samples)
    inputs = chebvander(speed / np.abs(speed).max(), 3)[:, 1:]
    short = np.convolve(angle, RESPONSE, mode="valid")
    return angle, inputs, short + lfilter(NUMERATOR, np.real(np.poly(POLES)), inputs @ WEIGHTS)


def pieces_of(angle, inputs, torque, length, gap):
    starts = range(0, len(torque) - length + 1, length + gap)
    return [
        subspace.Piece(
            torque[at : at + length], angle[at : at + length + 2 * LAGS], inputs[at : at + length]
        )
        for at in starts
    ]


@pytest.mark.parametrize(("length", "gap"), [(3000, 0), (60, 13)])
def test_both_paths_are_found_from_a_record_and_from_short_segments(random, length, gap):
    pieces = pieces_of(*record(random), length, gap)
    found = subspace.dynamics(pieces, HORIZON, 2)
    np.testing.assert_allclose(found, np.real(np.poly(POLES)), atol=1e-7)
    rows = subspace.Rows.joined(subspace.rows_of(piece, found) for piece in pieces)
    np.testing.assert_allclose(subspace.project(rows).response, RESPONSE, atol=1e-5)
    rest = rows._replace(output=rows.output - rows.signals @ RESPONSE)
    weights = subspace.weights_of(rest, 2)
    np.testing.assert_allclose(weights, WEIGHTS / np.linalg.norm(WEIGHTS), atol=1e-6)
    reflex = subspace.hammerstein(rest, found, weights)
    np.testing.assert_allclose(reflex.numerator, NUMERATOR * np.linalg.norm(WEIGHTS), atol=1e-6)
    assert reflex.static_gain == pytest.approx(reflex.impulse_response(400).sum(), rel=1e-6)
    assert np.abs(reflex.left).max() < 1e-5


def test_the_short_path_is_not_among_the_inputs_where_it_is_out_of_the_output(random):
    angle, inputs, torque = record(random)
    rest = torque - np.convolve(angle, RESPONSE, mode="valid")
    found = subspace.dynamics(pieces_of(angle, inputs, rest, 3000, 0), HORIZON, 2, lagged=False)
    np.testing.assert_allclose(found, np.real(np.poly(POLES)), atol=1e-9)


def test_neither_units_nor_collinear_inputs_matter(random):
    angle, inputs, torque = record(random)
    for changed in ((1e-9 * angle, inputs), (angle, np.hstack([inputs, inputs]))):
        found = subspace.dynamics(pieces_of(*changed, torque, 3000, 0), HORIZON, 2)
        np.testing.assert_allclose(found, np.real(np.poly(POLES)), atol=1e-7)


def test_poles_outside_the_unit_circle_are_reflected(random):
    inputs = random.normal(size=(400, 1))
    output = lfilter([1.0], [1.0, -1.02], inputs[:, 0])
    found = subspace.dynamics(
        [subspace.Piece(output, np.ones(400), inputs)], HORIZON, 1, lagged=False
    )
    np.testing.assert_allclose(found, [1.0, -1 / 1.02], rtol=1e-6)
