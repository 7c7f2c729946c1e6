"""The parallel cascade against its authors' code, on simulated reflexes and on real ankles."""

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import cheby1, sosfiltfilt
from tests.reflexive import ANKLES, centred, reflexive

import tvsysid as tv
from tvsysid.numerics.hammerstein import lagged_moments, parallel_cascade
from tvsysid.numerics.stretch import recorded_velocity

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


@pytest.mark.parametrize(
    "record", [ANKLES[0], *(pytest.param(each, marks=pytest.mark.slow) for each in ANKLES[1:])]
)
def test_stiffness_and_vaf_are_those_of_the_authors_code(
    recordings_folder, parallel_reference, record
):
    # As their toolbox prepares the data: the velocity of the recorded angle, decimated by a
    # Chebyshev filter.
    tonic = loadmat(recordings_folder / "tonic_ankle.mat")
    angle, torque = (tonic[f"{record}_{name}"].ravel() * 1.0 for name in ("angle", "torque"))
    lowpass = cheby1(8, 0.05, 0.08, output="sos")
    signals = (angle, recorded_velocity(angle[None, :, None], 1000.0)[0], torque)
    angle, velocity, torque = (sosfiltfilt(lowpass, each)[9::10] for each in signals)
    drive = np.maximum(velocity, 0.0)
    angle, drive, torque = (each - each.mean() for each in (angle, drive, torque))
    # Lags of ±40 ms, a reflex of 1 s.
    rows = [(np.stack([angle[4:], drive[:-4]])[:, None], torque[None, 99:-4])]
    found = parallel_cascade(lagged_moments(rows), 4)
    stiffness, vaf = (parallel_reference[f"{record}__pc_rect_{name}"] for name in ("K", "vaf"))
    assert found.details[0].solution.weights.sum() == pytest.approx(stiffness, rel=0.02)
    assert 100 * found.explained == pytest.approx(vaf[0], abs=1.5)


def test_it_says_where_the_past_is_not_recorded():
    ensemble = centred(reflexive(60.0)[0])
    method = tv.ParallelCascade(memory=1.9)
    assert method.skip(ensemble) is None
    apart = ensemble.select(np.arange(0, len(ensemble), 2))
    assert "only 900 samples have 1.9 s recorded" in method.skip(apart)
