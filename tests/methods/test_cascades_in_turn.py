"""Test cascades that identify both pathways in turn, on simulated reflexes and real ankles."""

import numpy as np
import pytest
from tests.reflexive import centred, reflexive
from tests.test_real_recordings import tonic

import tvsysid as tv

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def changing(duration, **settings):
    """Return an ensemble without its mean, and the truth."""
    ensemble, truth = reflexive(duration, **settings)
    return centred(ensemble), truth


@pytest.mark.parametrize("direction", [1, -1])
def test_pc_recovers_a_constant_reflex_from_noiseless_data(direction):
    ensemble, _ = changing(
        60.0, stiffness="constant", gain=8.0, snr_db=np.inf, seed=7, direction=direction
    )
    model = tv.ParallelCascade().identify(ensemble)
    assert model.stiffness[0] == pytest.approx(100, rel=0.03)
    assert model.estimates["reflex_gain"].values[0] == pytest.approx(8, rel=0.05)
    assert model.diagnostics.details["direction"] == direction
    assert model.diagnostics.details["vaf"] > 99.5
    assert np.ptp(model.stiffness) == np.ptp(model.estimates["reflex_gain"].values) == 0


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


@pytest.mark.parametrize(
    ("method", "stiffness", "largest", "error"),
    [
        (tv.BasisCascade(), "sine", 0.5, 4),
        pytest.param(tv.SubspaceCascade(), "constant", 0.3, 2, marks=pytest.mark.slow),
    ],
)
def test_without_a_reflex_none_is_found(method, stiffness, largest, error):
    ensemble, truth = changing(40.0, stiffness=stiffness, gain=0.0, seed=4)
    model = method.identify(ensemble)
    assert np.abs(model.estimates["reflex_gain"].values).max() < largest
    assert np.sqrt(np.nanmean((model.stiffness - truth["stiffness"]) ** 2)) < error


PC, BPC, SDSS = (
    tv.ParallelCascade(),
    tv.BasisCascade(basis=tv.CubicBSplines(4)),
    tv.SubspaceCascade(),
)


@pytest.mark.parametrize(
    ("method", "record", "low", "high", "vaf"),
    [
        (PC, "plantarflexor", 58, 64, 88), (PC, "dorsiflexor", 72, 80, 92),
        (PC, "dorsiflexor_2", 48, 54, 94), (BPC, "plantarflexor", 55, 70, 87),
        (BPC, "dorsiflexor", 70, 80, 91), (BPC, "dorsiflexor_2", 48, 54, 93),
        (SDSS, "dorsiflexor", 69.5, 73.7, 93),
        pytest.param(SDSS, "dorsiflexor_2", 51.6, 54.8, 93, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_real_ankles_in_contraction(recordings_folder, method, record, low, high, vaf):
    model = method.identify(tonic(recordings_folder, record))
    assert low < model.stiffness.mean() < high
    assert vaf < model.diagnostics.details["vaf"]


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


def test_a_memory_within_the_lags_of_the_intrinsic_response_is_refused():
    ensemble, _ = changing(20.0)
    assert "has 4 samples, and 6 to 250 are needed" in tv.BasisCascade(memory=0.04).skip(ensemble)
