"""Test cascades that identify both pathways of a changing joint in turn.

The data are simulated reflexes and real ankles.
"""

import numpy as np
import pytest
from tests.reflexive import ankle, centred, reflexive

import tvsysid as tv

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def changing(duration, **settings):
    """Return an ensemble without its mean, and the truth."""
    ensemble, truth = reflexive(duration, **settings)
    return centred(ensemble), truth


@pytest.mark.parametrize(
    ("method", "direction"),
    [
        pytest.param(tv.BasisCascade(), 1, id="bpc +", marks=pytest.mark.slow),
        pytest.param(tv.BasisCascade(), -1, id="bpc -"),
        pytest.param(tv.EnsembleCascade(), 1, id="tvpc +"),
    ],
)
def test_both_pathways_are_recovered_from_noiseless_data(method, direction):
    ensemble, truth = changing(60.0, seed=3, snr_db=np.inf, direction=direction)
    model = method.identify(ensemble)
    assert model.diagnostics.details["direction"] == direction
    assert np.abs(model.stiffness - truth["stiffness"]).mean() < 3
    # The area under the response at a time answers a gain that was there somewhat earlier.
    gain = model.estimates["reflex_gain"].values
    assert gain.mean() == pytest.approx(8, rel=0.05)
    assert np.ptp(gain) == pytest.approx(8, rel=0.15)
    for name, predicted in model.pathways(ensemble).items():
        torque = ensemble.channels[name][:, ensemble.core]
        assert tv.metrics.vaf(torque, predicted).mean() > 97
    assert model.diagnostics.details["vaf"] > 99


def test_without_a_reflex_none_is_found():
    ensemble, truth = changing(40.0, gain=0.0, seed=4)
    model = tv.BasisCascade().identify(ensemble)
    assert np.abs(model.estimates["reflex_gain"].values).max() < 0.5
    assert np.sqrt(np.mean((model.stiffness - truth["stiffness"]) ** 2)) < 4


def test_emg_drives_the_reflex():
    ensemble, _ = changing(40.0)
    model = tv.BasisCascade(emg="emg", memory=0.3).identify(ensemble)
    assert model.estimates["reflex_gain"].unit == "N m/V"
    assert model.reflex_lags[0] == 0


@pytest.mark.parametrize(
    ("record", "low", "high", "vaf"),
    [("plantarflexor", 55, 70, 87), ("dorsiflexor", 70, 80, 91), ("dorsiflexor_2", 48, 54, 93)],
)
def test_a_joint_that_does_not_change_is_found_not_to(recordings_folder, record, low, high, vaf):
    method = tv.BasisCascade(basis=tv.CubicBSplines(4))
    model = method.identify(ankle(recordings_folder, record))
    assert low < model.stiffness.mean() < high
    assert model.diagnostics.details["vaf"] > vaf


@pytest.mark.slow
def test_realizations_without_their_past_are_left_out():
    ensemble, truth = changing(60.0, seed=3, snr_db=np.inf)
    method = tv.BasisCascade(memory=0.7)
    mixed = ensemble.select(np.r_[0:22, 23, 25, 27])
    model = method.identify(mixed)
    assert np.abs(model.stiffness - truth["stiffness"]).mean() < 3
    unknown = np.isnan(model.predict(mixed)).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(unknown), [0, 22, 23, 24])
    assert method.skip(ensemble.select(range(0, 30, 2))).startswith(
        "0 of 15 realizations have 0.7 s recorded"
    )
