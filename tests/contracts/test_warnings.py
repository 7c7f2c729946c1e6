"""Methods warn where their own model does not fit, and the diagnostics keep the warnings."""

import warnings

import attrs
import numpy as np
import pytest
from scipy.signal import bilinear, lfilter
from tests.conftest import ensemble_of, realizations

import tvsysid as tv

FIVE = [tv.methods.parse(key) for key in tv.methods.PAPER_METHODS]
five = pytest.mark.parametrize("method", FIVE, ids=list(tv.methods.PAPER_METHODS))


def warnings_of(method, ensemble):
    with pytest.warns(tv.DataQualityWarning) as caught:
        model = method.identify(ensemble)
    texts = [str(warning.message) for warning in caught]
    assert [f"{method.key}: {text}" for text in model.diagnostics.warnings] == texts
    assert all(warning.filename == __file__ for warning in caught), (
        "the warning points at the caller"
    )
    return " ".join(texts)


@five
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_clean_data_give_no_warning(method, perturbation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(5):
            model = method.identify(ensemble_of(150.0, "square", perturbation, seed=seed))
            assert model.diagnostics.warnings == ()


def test_fewer_realizations_than_lags():
    assert "20 realizations are fewer than the 25 lags" in warnings_of(
        tv.EnsembleIRF(), ensemble_of(40.0)
    )


@pytest.mark.parametrize("method", [tv.ShortDataSegments(), tv.EnsembleSpectral()])
def test_too_few_realizations_for_a_window(method):
    assert "hardly determined" in warnings_of(method, ensemble_of(40.0).select([3, 4]))


@pytest.mark.parametrize("key", ["eirf", "sds", "esm"])
@pytest.mark.parametrize("perturbation", [tv.simulate.FilteredNoise(), tv.simulate.PRBS()])
def test_a_joint_that_is_not_of_second_order(key, perturbation):
    joint = tv.simulate.Joint(stiffness=tv.simulate.Constant(100.0))
    recording = joint.simulate(150, perturbation=perturbation, snr_db=10, seed=4).recording
    # A reflex: velocity 40 ms ago, through a second-order low-pass of some 2.5 Hz.
    velocity = np.roll(np.gradient(recording.angle, 1e-3), 40)
    reflex = 15 * lfilter(*bilinear([16.0**2], [1, 2 * 0.65 * 16.0, 16.0**2], fs=1000), velocity)
    with_reflex = attrs.evolve(recording, torque=recording.torque + reflex)
    ensemble = realizations(with_reflex)
    assert "is not of second order" in warnings_of(tv.methods.parse(key), ensemble)
