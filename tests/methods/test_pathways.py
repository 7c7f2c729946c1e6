"""Test the torque of two pathways.

Samples before a realization come from where they were recorded, or are unknown.
"""

import attrs
import numpy as np
import pytest

import tvsysid as tv
from tvsysid.methods.cascade.pathways import Stretch, TwoPathwayModel, history
from tvsysid.models import Diagnostics

RATE, SAMPLES = 100.0, 40


@pytest.fixture
def record(random):
    return tv.Recording(*random.normal(size=(2, 2450)), 1000.0)


def cut(record, context):
    return tv.preprocess.segment(tv.preprocess.decimate(record, RATE), SAMPLES / RATE, context)


def model_of(response, lags):
    time = np.arange(SAMPLES) / RATE
    return TwoPathwayModel(
        method="known", sampling_rate=RATE, time=time, estimates={}, diagnostics=Diagnostics(0),
        impulse_response=np.zeros((SAMPLES, 3)), lags=np.array([-1, 0, 1]) / RATE,
        reflex_response=np.broadcast_to(response, (SAMPLES, len(response))),
        reflex_lags=lags / RATE,
        drive=Stretch(0.1, -1),
    )  # fmt: skip


def test_history_comes_from_the_realization_before(record):
    ensemble = cut(record, 0.1)
    assert len(ensemble) == 4
    low = tv.preprocess.decimate(record, RATE).angle
    found = history(ensemble, ensemble.angle, 60)
    assert found.shape == (4, 60 + SAMPLES)
    for number, start in enumerate(SAMPLES + SAMPLES * np.arange(4)):
        known = min(60, 10 + number * SAMPLES)
        np.testing.assert_array_equal(
            found[number, 60 - known :], low[start - known : start + SAMPLES]
        )
        assert np.isnan(found[number, : 60 - known]).all()
    apart = ensemble.select([2, 2, 0])
    found = history(apart, apart.angle, 15)
    np.testing.assert_array_equal(found[:, 5:], apart.angle[:, :-10])
    assert np.isnan(found[:, :5]).all()


@pytest.mark.parametrize("subtracted", [False, True])
def test_reflex_torque_is_the_convolution_of_the_whole_record(record, subtracted):
    ensemble = cut(record, 0.1)
    response, lags = np.array([1.0, 3.0, -2.0, 0.5]), np.arange(4, 8)
    # From filters of the whole record; those at realizations' ends differ by what the reflection
    # there invents.
    fine = np.gradient(record.angle) * 0
    fine[2:-2] = np.convolve(record.angle, np.array([2, 1, 0, -1, -2]) / 10 * 1000.0, mode="valid")
    whole = tv.preprocess.decimate(
        tv.Recording(-np.maximum(-fine - 0.1, 0.0), record.torque, 1000.0), RATE
    ).angle
    full = np.convolve(whole, np.concatenate([np.zeros(4), response]))[: len(whole)] / RATE
    expected = np.stack(
        [full[start : start + SAMPLES] for start in SAMPLES + SAMPLES * np.arange(4)]
    )
    if subtracted:
        ensemble, expected = tv.preprocess.subtract_mean(ensemble), expected - expected.mean(axis=0)
    found = model_of(response, lags).pathways(ensemble)
    np.testing.assert_allclose(found["reflex"], expected, atol=1e-9 * np.abs(expected).max())
    assert found.keys() == {"intrinsic", "reflex"}


def test_lags_beyond_what_was_recorded_give_no_torque(record):
    ensemble = attrs.evolve(cut(record, 0.1), onsets=None, trials=None)
    found = model_of(np.ones(3), np.arange(10, 13)).pathways(ensemble)["reflex"]
    np.testing.assert_array_equal(np.isnan(found), np.arange(SAMPLES) < np.full((4, 1), 2))
    stored = model_of(np.ones(3), np.arange(10, 13)).to_xarray(ensemble)
    assert stored.reflex_response.dims == ("time", "reflex_lag")
    np.testing.assert_allclose(stored.reflex_lag, [0.10, 0.11, 0.12])
    np.testing.assert_allclose(
        stored.nonlinearity.interp(velocity=[-0.6, -0.1, 0.0, 0.5]), [-0.5, 0, 0, 0]
    )
    assert Stretch(0.1).curve()[0].tolist() == [-1.0, 0.1, 1.1]
