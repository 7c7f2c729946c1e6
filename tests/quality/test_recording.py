"""Test gaps and mains hum in a recording: found by name, removed, and no false alarm."""

from functools import partial

import attrs
import numpy as np
import pytest
from tests import faults
from tests.conftest import realizations
from tests.independent import COLOURS, imposed

import tvsysid as tv
from tvsysid.quality import diagnose_recording

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def recorded(perturbation="noise", colour="pink", seed=1, duration=80.0, snr_db=10):
    """Recording with a mean angle and torque, and the true stiffness over a period."""
    signals, truth = imposed("sine", perturbation, colour, snr_db, seed, duration)
    return tv.Recording(signals[0] + 0.1, signals[1] + 5.0, 1000.0), truth[:2000:10]


def cut(recording, gaps=()):
    return tv.preprocess.subtract_mean(realizations(recording, 2.0, 0.5, gaps))


def error(ensemble, truth):
    stiffness = tv.BasisIRF().identify(ensemble).stiffness
    return np.sqrt(np.mean((stiffness - truth) ** 2))


def found(recording):
    return {name for name, check in diagnose_recording(recording).items() if check.found}


def in_steps(recording, bits):
    """A recording through converters whose range is twice that of the signals."""
    signals = np.stack([recording.angle, recording.torque])
    steps = 4 * np.abs(signals - signals.mean(axis=1, keepdims=True)).max(axis=1)[:, None] / 2**bits
    angle, torque = np.round(signals / steps) * steps
    return attrs.evolve(recording, angle=angle, torque=torque)


@pytest.mark.parametrize("kind", ["held", "zero", "line"])
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_realizations_with_gaps_are_left_out_and_spoil_nothing(kind, perturbation):
    recording, truth = recorded(perturbation)
    spoilt = faults.gapped(recording, kind)
    assert found(spoilt) == {"gaps"}
    gaps = tv.preprocess.find_gaps(spoilt)
    assert [(gap.trial, gap.start) for gap in gaps] == [
        (0, pytest.approx(7 + 10 * n, abs=0.0011)) for n in range(3)
    ]
    whole, left = cut(recording), cut(spoilt, gaps)
    assert len(left) == len(whole) - 3
    assert error(left, truth) < 1.2 * error(whole, truth)
    if kind == "zero" and perturbation == "noise":
        assert error(cut(spoilt), truth) > 3 * error(left, truth)


def test_gaps_are_found_in_trials_and_after_the_ends_are_taken_off():
    recording = faults.gapped(recorded()[0], count=2)
    recording = attrs.evolve(recording, trial_starts=(0, 16_000), start=-1.0)
    first, second = tv.preprocess.find_gaps(recording)
    assert (first.trial, second.trial) == (0, 1)
    assert [first.start, second.start] == pytest.approx([6, 0], abs=0.0011)
    trimmed = tv.preprocess.trim(recording, 3.5)
    onsets = tv.preprocess.segment(trimmed, 2.0, 0.0, [first]).onsets
    np.testing.assert_allclose(onsets[:3], [0, 4, 6])  # the gap is at 6 - 2.5 s


@pytest.mark.parametrize("frequency", [49.97, 60.03])
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_mains_hum_is_found_and_taken_out(frequency, perturbation):
    recording, truth = recorded(perturbation)
    spoilt = faults.humming(recording, frequency)
    check = diagnose_recording(spoilt)["mains"]
    assert found(spoilt) == {"mains"}
    assert check.value == pytest.approx(5, abs=0.1)
    assert "remove_mains(recording, 50)" in check.fault.remedy
    nominal, _ = tv.preprocess.find_mains(spoilt)
    assert nominal == round(frequency, -1)
    mended = tv.preprocess.remove_mains(spoilt, nominal)
    usual = error(cut(recording), truth)
    assert error(cut(mended), truth) == pytest.approx(usual, rel=0.05)
    assert error(cut(spoilt), truth) > 1.4 * usual


def test_mains_that_drift_are_taken_out_of_all_channels_of_each_trial():
    recording, _ = recorded()
    drift = 50 + 0.05 * np.sin(2 * np.pi * recording.time / 60)
    hum = 0.001 * np.sin(2 * np.pi * np.cumsum(drift) / 1000)
    spoilt = attrs.evolve(recording, channels={"emg": hum}, trial_starts=(0, 30_000))
    left = tv.preprocess.remove_mains(spoilt, 50.0).channels["emg"]
    assert left[np.r_[1000:29_000, 31_000:79_000]].std() < 0.02 * hum.std()
    with pytest.raises(tv.InputError, match="before decimation"):
        tv.preprocess.remove_mains(tv.preprocess.decimate(spoilt, 125), 50.0)


@pytest.mark.parametrize("bits", [None, 8, 12])
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_neither_is_found_in_clean_records_however_coarse(perturbation, bits):
    recordings = [
        recorded(perturbation, colour, seed, 30.0, (5, 20)[seed % 2])[0]
        for seed, colour in enumerate(COLOURS)
    ]
    for recording in recordings:
        assert not found(recording if bits is None else in_steps(recording, bits))


def in_lines(spacing):
    """A perturbation that has a line wherever mains has one."""
    samples = 30_000
    lines = np.arange(samples // 2 + 1) % round(30 * spacing) == 0
    angle = np.fft.irfft(15 * lines * (np.fft.rfftfreq(samples, 1e-3) < 80), samples)
    noise = np.random.default_rng(1).normal(size=samples)
    return tv.Recording(angle, 80 * angle + noise, 1000.0)


def at_rest(noise):
    """A rest of 2 s, then movement, both in coarse steps; noise as a share of the step."""
    signals, _ = imposed("sine", "prbs", "white", 20, 1, 40.0)
    signals /= 1 + np.exp(-(np.arange(40_000) - 2000) / 20)
    steps = 4 * np.abs(signals).max(axis=1, keepdims=True) / 2**12
    signals += noise * steps * np.random.default_rng(2).normal(size=signals.shape)
    return tv.Recording(*(np.round(signals / steps) * steps), 1000.0)


@pytest.mark.parametrize(
    "make",
    [
        *(partial(in_lines, spacing) for spacing in (0.1, 1.0, 5.0)),
        *(partial(at_rest, noise) for noise in (0.0, 0.3)),
        lambda: faults.clipped(recorded("prbs", "slow")[0], "torque", 1.0),
        lambda: faults.clipped(recorded("prbs", "slow")[0], "torque", 3.0),
    ],
)
def test_neither_is_found_where_signals_only_look_alike(make):
    assert not found(make())


def test_a_diagnosis_looks_at_the_recording_that_it_is_given():
    spoilt = faults.gapped(faults.humming(recorded(duration=40.0)[0]))
    findings = tv.diagnose(cut(spoilt), recording=spoilt).findings
    assert {"gaps", "mains"} <= {check.name for check in findings}
