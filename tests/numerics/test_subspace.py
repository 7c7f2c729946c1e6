"""Subspace identification: systems that are exactly of its kind are found exactly."""

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebvander
from scipy.signal import lfilter

from tvsysid.numerics import subspace

LAGS, HORIZON = 4, 12
POLES = np.real(np.poly([0.9 + 0.1j, 0.9 - 0.1j]))
NUMERATOR = np.array([0.3, -0.2, 0.5])
WEIGHTS = np.array([0.6, -0.3, 0.2])
RESPONSE = np.array([1.0, -3.0, 8.0, -20.0, 40.0, -18.0, 7.0, -2.0, 0.5])


@pytest.fixture
def record(random):
    """Torque, angle, which is band-limited, and inputs."""
    angle = lfilter([1.0], [1.0, -1.2, 0.5], random.normal(size=3000 + 2 * LAGS))
    speed = random.normal(size=3000)
    inputs = chebvander(speed / np.abs(speed).max(), 3)[:, 1:]
    short = np.convolve(angle, RESPONSE, mode="valid")
    return subspace.Piece(short + lfilter(NUMERATOR, POLES, inputs @ WEIGHTS), angle, inputs)


@pytest.mark.parametrize(("length", "gap"), [(3000, 0), (60, 13)])
def test_both_paths_are_found_from_a_record_and_from_short_segments(record, length, gap):
    windows = [slice(at, at + length) for at in range(0, 3001 - length, length + gap)]
    pieces = [
        subspace.Piece(
            record.output[each],
            record.lagged[each.start : each.stop + 2 * LAGS],
            record.inputs[each],
        )
        for each in windows
    ]
    found = subspace.dynamics(pieces, HORIZON, 2)
    np.testing.assert_allclose(found, POLES, atol=1e-7)
    rows = subspace.rows_of(pieces, found)
    np.testing.assert_allclose(subspace.project(rows).response, RESPONSE, atol=1e-5)
    rest = rows._replace(output=rows.output - rows.signals @ RESPONSE)
    reflex = subspace.hammerstein(rest, found)
    np.testing.assert_allclose(reflex.weights, WEIGHTS / np.linalg.norm(WEIGHTS), atol=1e-6)
    np.testing.assert_allclose(reflex.numerator, NUMERATOR * np.linalg.norm(WEIGHTS), atol=1e-6)
    assert reflex.static_gain == pytest.approx(reflex.impulse_response(400).sum(), rel=1e-6)
    assert np.abs(reflex.left).max() < 1e-5


def test_the_short_path_is_not_among_the_inputs_where_it_is_out_of_the_output(record):
    found = subspace.dynamics([record.without(RESPONSE)], HORIZON, 2, lagged=False)
    np.testing.assert_allclose(found, POLES, atol=1e-9)


def test_neither_units_nor_collinear_inputs_matter(record):
    twice = np.hstack([record.inputs, record.inputs])
    for changed in ({"lagged": 1e-9 * record.lagged}, {"inputs": twice}):
        found = subspace.dynamics([record._replace(**changed)], HORIZON, 2)
        np.testing.assert_allclose(found, POLES, atol=1e-7)


def test_poles_outside_the_unit_circle_are_reflected(random):
    inputs = random.normal(size=(400, 1))
    output = lfilter([1.0], [1.0, -1.02], inputs[:, 0])
    piece = subspace.Piece(output, np.ones(400), inputs)
    found = subspace.dynamics([piece], HORIZON, 1, lagged=False)
    np.testing.assert_allclose(found, [1.0, -1 / 1.02], rtol=1e-6)


def test_lagged_products_are_those_of_the_lagged_signals(random):
    signals = random.normal(size=(3, 230))
    late = np.lib.stride_tricks.sliding_window_view(signals, 31, axis=1)[..., ::-1]
    columns = late.swapaxes(0, 1).reshape(200, -1)
    found = subspace.lagged_gram(signals, 30).reshape(93, 93)
    np.testing.assert_allclose(found, columns.T @ columns, atol=1e-10)
