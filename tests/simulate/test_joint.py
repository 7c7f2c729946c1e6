import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import bessel, welch

import tvsysid as tv
from tvsysid.simulate import PRBS, FilteredNoise, Joint, Multisine, Pulses, SineWave, SquareWave
from tvsysid.simulate.actuator import actuate


def simulate(duration=20.0, **settings):
    asked = {"perturbation": FilteredNoise(), "snr_db": 10, "seed": 1, "rate": 1000.0}
    asked |= {name: settings.pop(name) for name in asked if name in settings}
    return Joint(**settings).simulate(duration, **asked)


def test_the_angle_has_an_rms_of_half_a_degree():
    recording = simulate(60.0).recording
    inside = (recording.time >= -1e-9) & (recording.time < 60.0 - 1e-9)
    assert (inside.sum(), len(recording), recording.start) == (60_000, 62_000, -1.0)
    assert np.sqrt(np.mean(recording.angle[inside] ** 2)) == pytest.approx(np.radians(0.5))


@pytest.mark.parametrize(
    ("perturbation", "speed"), [(FilteredNoise(), 0.198), (PRBS(), 0.060), (PRBS(0.109), 0.0815)]
)
def test_mean_speed_is_the_published_one(perturbation, speed):
    recording = simulate(300.0, perturbation=perturbation).recording
    assert np.abs(np.diff(recording.angle) * 1000).mean() == pytest.approx(speed, rel=0.03)


def test_actuator_equals_the_differential_equation():
    rate, drive = 1000.0, np.cumsum(np.random.default_rng(3).normal(size=60))
    _, (_, damping, stiffness) = bessel(2, 2 * np.pi * 40, analog=True, norm="phase")
    time = np.arange(-1, 60) / rate  # rises from rest before the first sample
    padded = np.concatenate([[0.0], drive])

    def slope(t, state):
        return [state[1], stiffness * (np.interp(t, time, padded) - state[0]) - damping * state[1]]

    accurate = {"rtol": 1e-9, "atol": 1e-12, "max_step": 2e-4}
    solution = solve_ivp(slope, time[[0, -1]], [0, 0], t_eval=time[1:], **accurate).y
    position, velocity, acceleration = actuate(drive, rate)
    np.testing.assert_allclose(position, solution[0], atol=1e-6)
    np.testing.assert_allclose(velocity, solution[1], atol=1e-3)
    expected = stiffness * (drive - solution[0]) - damping * solution[1]
    np.testing.assert_allclose(acceleration, expected, atol=1.0)


def test_noise_and_perturbation_have_their_cutoff():
    simulation = simulate(400.0, perturbation=FilteredNoise(8.0), snr_db=0.0)
    noise = simulation.recording.torque - simulation.pathways["intrinsic"]
    for signal, cutoff, top in ((noise, 40, 10), (simulation.recording.angle, 8, 3)):
        frequencies, power = welch(signal, 1000.0, nperseg=4000)
        low = power[(frequencies > 0.5) & (frequencies < top)].mean()
        at_cutoff = power[np.abs(frequencies - cutoff) < 0.05 * cutoff].mean()
        assert at_cutoff / low == pytest.approx(0.5, abs=0.08)
    assert power[frequencies > 200].mean() / low < 1e-2


def test_the_noise_level_does_not_change_the_perturbation():
    quiet, loud = simulate(snr_db=30), simulate(snr_db=0)
    np.testing.assert_array_equal(quiet.recording.angle, loud.recording.angle)
    np.testing.assert_array_equal(quiet.pathways["intrinsic"], loud.pathways["intrinsic"])


@pytest.mark.parametrize("rate", [200.0, 1024.0])
@pytest.mark.parametrize("profile", [SquareWave(), lambda time: 100 + 3 * time])
def test_other_rates_and_any_callable_as_a_profile(rate, profile):
    simulation = simulate(10.0, rate=rate, stiffness=profile)
    recording = simulation.recording
    assert (recording.sampling_rate, len(recording)) == (rate, 12 * rate)
    np.testing.assert_allclose(simulation.truth["stiffness"], profile(recording.time), rtol=1e-12)


def test_prbs_switches_on_its_clock():
    samples = PRBS(0.1003).generate(20_000, 1000.0, np.random.default_rng(2))
    assert set(samples) == {-1.0, 1.0}
    switches = np.flatnonzero(np.diff(samples)) + 1
    turned = np.exp(2j * np.pi * switches / 100.3)
    assert np.abs(np.angle(turned / turned.mean())).max() <= 2 * np.pi * 0.0011 / 0.1003
    assert len(switches) == pytest.approx(20 / 0.1003 / 2, rel=0.25)
    assert abs(samples.mean()) < 0.35


@pytest.mark.parametrize("pulses", [Pulses(), Pulses(0.1, 0.35, 0.0)])
def test_pulses_have_the_length_and_the_interval_asked_for(random, pulses):
    samples = pulses.generate(200_000, 1000.0, random)
    assert set(samples) == {-1.0, 0.0, 1.0}
    edges = np.flatnonzero(np.diff(samples)) + 1
    lengths, kinds = np.diff(edges) / 1000, samples[edges[:-1]]
    rest = pulses.interval - pulses.duration
    for mean, own in ((pulses.duration, lengths[kinds != 0]), (rest, lengths[kinds == 0])):
        assert np.abs(own - mean).max() <= pulses.variation * mean + 0.0011
        assert own.mean() == pytest.approx(mean, rel=0.03)
    assert abs(samples.sum()) < 0.2 * np.abs(samples).sum()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 0.0}, "duration must be a positive number"),
        ({"seed": -1}, "seed must be a whole number of zero or more, got -1"),
        ({"stiffness": 100.0}, "stiffness must be a callable"),
        ({"perturbation": "prbs"}, "perturbation must be FilteredNoise, PRBS"),
        ({"viscosity": float("nan")}, "viscosity must be a finite number or a callable"),
        ({"rate": 50.0}, "rate must be a number of hertz above 80 Hz, got 50.0"),
        ({"snr_db": float("nan")}, "snr_db must be a number of decibels"),
        (
            {"stiffness": lambda time: np.full(len(time), np.nan)},
            "stiffness must give one finite number for each of 12000 values",
        ),
        ({"stiffness": lambda time: time[1:]}, r"got shape \(11999,\)"),
        ({"perturbation": FilteredNoise(600.0)}, "must be below half the sampling rate"),
        ({"perturbation": Multisine((1.0, 600.0))}, "must be below half the sampling rate"),
    ],
)
def test_what_cannot_be_simulated_is_refused(change, message):
    with pytest.raises(tv.InputError, match=message):
        simulate(**({"duration": 10.0} | change))


@pytest.mark.parametrize(
    ("create", "message"),
    [
        (lambda: SquareWave(period=0.0), "period must be a positive number"),
        (lambda: SineWave(mean=float("nan")), "mean must be a finite number"),
        (lambda: Pulses(duration=0.5), "expected a duration below the interval"),
        (lambda: Multisine(()), "frequencies must be positive numbers of hertz"),
    ],
)
def test_settings_out_of_range_are_refused(create, message):
    with pytest.raises(tv.InputError, match=message):
        create()
