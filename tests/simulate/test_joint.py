import numpy as np
import pytest
from scipy.signal import welch
from tests.simulate.conftest import simulate

from tvsysid.simulate import PRBS, FilteredNoise, Joint, Pulses


def test_the_angle_has_an_rms_of_half_a_degree():
    recording = simulate(Joint(), 60.0).recording
    inside = (recording.time >= -1e-9) & (recording.time < 60.0 - 1e-9)
    assert (inside.sum(), len(recording), recording.start) == (60_000, 62_000, -1.0)
    assert np.sqrt(np.mean(recording.angle[inside] ** 2)) == pytest.approx(np.radians(0.5))


@pytest.mark.parametrize(
    ("perturbation", "speed"), [(FilteredNoise(), 0.198), (PRBS(), 0.060), (PRBS(0.109), 0.0815)]
)
def test_mean_speed_is_the_published_one(perturbation, speed):
    recording = simulate(Joint(), 300.0, perturbation=perturbation).recording
    assert np.abs(np.diff(recording.angle) * 1000).mean() == pytest.approx(speed, rel=0.03)


def test_noise_and_perturbation_have_their_cutoff():
    simulation = simulate(Joint(), 400.0, perturbation=FilteredNoise(8.0), snr_db=0.0)
    noise = simulation.recording.torque - simulation.pathways["intrinsic"]
    for signal, cutoff, top in ((noise, 40, 10), (simulation.recording.angle, 8, 3)):
        frequencies, power = welch(signal, 1000.0, nperseg=4000)
        low = power[(frequencies > 0.5) & (frequencies < top)].mean()
        at_cutoff = power[np.abs(frequencies - cutoff) < 0.05 * cutoff].mean()
        assert at_cutoff / low == pytest.approx(0.5, abs=0.08)
    assert power[frequencies > 200].mean() / low < 1e-2


def test_prbs_switches_on_its_clock():
    samples = PRBS(0.1003).generate(20_000, 1000.0, np.random.default_rng(2))
    assert set(samples) == {-1.0, 1.0}
    switches = np.flatnonzero(np.diff(samples)) + 1
    turned = np.exp(2j * np.pi * switches / 100.3)
    assert np.abs(np.angle(turned / turned.mean())).max() <= 2 * np.pi * 0.0011 / 0.1003
    assert len(switches) == pytest.approx(20 / 0.1003 / 2, rel=0.25)
    assert abs(samples.mean()) < 0.35


def test_pulses_have_the_length_and_the_interval_asked_for(random):
    pulses = Pulses(0.1, 0.35)
    samples = pulses.generate(200_000, 1000.0, random)
    assert set(samples) == {-1.0, 0.0, 1.0}
    edges = np.flatnonzero(np.diff(samples)) + 1
    lengths, kinds = np.diff(edges) / 1000, samples[edges[:-1]]
    for mean, own in ((0.1, lengths[kinds != 0]), (0.25, lengths[kinds == 0])):
        assert np.abs(own - mean).max() <= 0.2 * mean + 0.0011
        assert own.mean() == pytest.approx(mean, rel=0.03)
