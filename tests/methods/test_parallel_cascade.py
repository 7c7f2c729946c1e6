"""The parallel cascade against its authors' code, on real ankles."""

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import cheby1, sosfiltfilt
from tests.reflexive import ANKLES

import tvsysid as tv
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.stretch import recorded_velocity

LAGS, MEMORY, TIMES = 4, 100, 200  # ±40 ms, a reflex of 1 s, pieces of 2 s


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
    starts = range(MEMORY, len(torque) - TIMES - LAGS, TIMES)

    def pieces(signal, before, after):
        return np.stack([signal[at - before : at + TIMES + after] for at in starts])

    signals = pieces(angle, LAGS, LAGS), pieces(drive, MEMORY, 0), pieces(torque, 0, 0)
    model, reflex = tv.ParallelCascade().in_turn(*signals, 100.0)
    stiffness, vaf = (parallel_reference[f"{record}__pc_rect_{name}"] for name in ("K", "vaf"))
    assert model.stiffness[0] == pytest.approx(stiffness, rel=0.02)
    responses = model.impulse_response / 100, reflex / 100
    left = signals[2] - sum(map(convolve_lags, signals, responses))
    explained = 1 - np.sum(left**2) / np.sum(signals[2] ** 2)
    assert 100 * explained == pytest.approx(vaf[0], abs=1.5)
