"""Test the torque of two pathways.

Samples before a realization come from where they were recorded, or are unknown.
"""

import attrs
import numpy as np
import pytest
from scipy.signal import lfilter

import tvsysid as tv
from tvsysid.methods.pathways import Stretch, TwoPathwayModel, history
from tvsysid.models import Diagnostics

RATE, SAMPLES = 100.0, 40
STARTS = SAMPLES * np.arange(1, 5)  # of the realizations in the record


@pytest.fixture
def record(random):
    return tv.Recording(*random.normal(size=(2, 2450)), 1000.0)


@pytest.fixture
def ensemble(record):
    return tv.preprocess.segment(tv.preprocess.decimate(record, RATE), SAMPLES / RATE, 0.1)


def model_of(response, first):
    return TwoPathwayModel(
        method="known", sampling_rate=RATE, time=np.arange(SAMPLES) / RATE, estimates={},
        diagnostics=Diagnostics(0), impulse_response=np.zeros((SAMPLES, 3)),
        lags=np.array([-1, 0, 1]) / RATE, reflex_response=np.tile(response, (SAMPLES, 1)),
        reflex_lags=(first + np.arange(len(response))) / RATE, drive=Stretch(0.1, -1),
    )  # fmt: skip


def test_history_comes_from_the_realization_before(record, ensemble):
    low = tv.preprocess.decimate(record, RATE).angle
    found = history(ensemble, ensemble.angle, 60)
    for row, start, known in zip(found, STARTS, (10, 50, 60, 60), strict=True):
        np.testing.assert_array_equal(row[60 - known :], low[start - known : start + SAMPLES])
        assert np.isnan(row[: 60 - known]).all()
    apart = ensemble.select([2, 2, 0])
    found = history(apart, apart.angle, 15)
    np.testing.assert_array_equal(found[:, 5:], apart.angle[:, :-10])
    assert np.isnan(found[:, :5]).all()


@pytest.mark.parametrize("subtracted", [False, True])
def test_reflex_torque_is_the_convolution_of_the_whole_record(record, ensemble, subtracted):
    response = np.array([1.0, 3.0, -2.0, 0.5])
    # From filters of the whole record; those at realizations' ends differ by what the reflection
    # there invents.
    slope = np.convolve(record.angle, [200.0, 100, 0, -100, -200], mode="valid")
    stretch = np.pad(-np.maximum(-slope - 0.1, 0.0), 2)
    whole = tv.preprocess.decimate(tv.Recording(stretch, record.torque, 1000.0), RATE).angle
    full = lfilter([0, 0, 0, 0, *response], 1, whole) / RATE
    expected = np.stack([full[start : start + SAMPLES] for start in STARTS])
    if subtracted:
        ensemble, expected = tv.preprocess.subtract_mean(ensemble), expected - expected.mean(axis=0)
    found = model_of(response, 4).pathways(ensemble)
    np.testing.assert_allclose(found["reflex"], expected, atol=1e-9 * np.abs(expected).max())
    assert found.keys() == {"intrinsic", "reflex"}


def test_lags_beyond_what_was_recorded_give_no_torque(ensemble):
    ensemble, model = attrs.evolve(ensemble, onsets=None, trials=None), model_of(np.ones(3), 10)
    found = model.pathways(ensemble)["reflex"]
    np.testing.assert_array_equal(np.isnan(found), np.arange(SAMPLES) < np.full((4, 1), 2))
    stored = model.to_xarray(ensemble)
    assert stored.reflex_response.dims == ("time", "reflex_lag")
    np.testing.assert_allclose(stored.reflex_lag, [0.10, 0.11, 0.12])
