import numpy as np
import pytest

import tvsysid as tv


def waves(time):
    return np.sin(2 * np.pi * 3.0 * time) + 0.3 * np.sin(2 * np.pi * 11.0 * time + 1)


@pytest.mark.parametrize("delay", [0.003, -0.003, 0.0013, -0.0047, 0.0])
def test_the_torque_is_taken_so_much_earlier(delay):
    time = np.arange(4000) / 1000
    recording = tv.Recording(
        waves(time), waves(time - delay), 1000.0, trial_starts=(0, 1500), channels={"emg": time}
    )
    mended = tv.preprocess.align_channels(recording, delay)
    lost = int(np.ceil(abs(1000 * delay) - 1e-9))
    assert [trial.stop - trial.start for trial in mended.trials] == [1500 - lost, 2500 - lost]
    assert mended.start == pytest.approx(lost / 1000 if delay < 0 else 0)
    assert mended.delay_removed == delay
    for trial in mended.trials:
        inner = slice(trial.start + 20, trial.stop - 20)
        np.testing.assert_allclose(mended.torque[inner], mended.angle[inner], atol=1e-3)
        np.testing.assert_array_equal(np.diff(mended.channels["emg"][trial]).round(9), 0.001)


@pytest.mark.slow
def test_what_was_done_is_stated_from_recording_to_model(tmp_path):
    noise = tv.simulate.FilteredNoise()
    recording = tv.simulate.Joint().simulate(40, perturbation=noise, snr_db=20, seed=1).recording
    mended = tv.preprocess.align_channels(recording, 0.002)
    ensemble = tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(mended, 100), 2.0)
    )
    assert ensemble.delay_removed == 0.002
    model = tv.BasisIRF().identify(ensemble)
    assert model.diagnostics.details["delay_removed"] == 0.002
    assert model.to_xarray().attrs["delay_removed"] == 0.002
    tv.recordings.write_ensemble(tmp_path / "ensemble.nc", ensemble)
    assert tv.recordings.load_ensemble(tmp_path / "ensemble.nc").delay_removed == 0.002


def test_it_brings_the_inertia_back():
    noise = tv.simulate.FilteredNoise()
    recording = tv.simulate.Joint().simulate(60, perturbation=noise, snr_db=20, seed=1).recording
    late = tv.Recording(recording.angle[3:], recording.torque[:-3], 1000.0, start=recording.start)

    def inertia(given):
        cut = tv.preprocess.segment(tv.preprocess.decimate(given, 100), 2.0)
        return float(np.nanmean(tv.BasisIRF().identify(tv.preprocess.subtract_mean(cut)).inertia))

    assert inertia(late) < 0.014
    (delay,) = tv.diagnose(tv.preprocess.subtract_mean(tv.preprocess.segment(late, 2.0))).findings
    assert (delay.name, delay.value) == ("delay", pytest.approx(3, abs=0.4))
    assert inertia(tv.preprocess.align_channels(late, delay.value / 1000)) == pytest.approx(
        0.02, rel=0.06
    )


@pytest.mark.parametrize(
    ("delay", "message"),
    [(np.nan, "a number of seconds"), ("late", "got 'late'"), (9.0, "leaves nothing")],
)
def test_impossible_delays_are_refused(delay, message):
    time = np.arange(500) / 100
    recording = tv.Recording(waves(time), waves(time), 100.0)
    with pytest.raises(tv.InputError, match=message):
        tv.preprocess.align_channels(recording, delay)
