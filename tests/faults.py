"""Faults planted into records and ensembles, each named after the finding that must name it."""

from functools import cache, lru_cache, partial

import attrs
import numpy as np
from scipy.signal import butter, filtfilt, lfilter
from tests.conftest import realizations

import tvsysid as tv

RATE = 1000


@cache
def simulated(duration=150.0, perturbation="noise", profile="sine", snr_db=10.0, seed=1):
    """Recording of a simulated joint at 1 kHz."""
    return (
        tv.simulate.Joint(stiffness=tv.simulate.PROFILES[profile])
        .simulate(
            duration, perturbation=tv.simulate.PERTURBATIONS[perturbation], snr_db=snr_db, seed=seed
        )
        .recording
    )


@lru_cache(maxsize=32)
def cut(recording, period=2.0, rate=100.0):
    """Ensemble as it is usually prepared; recordings are compared by identity."""
    return tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(recording, rate), period)
    )


def changed(recording, angle=None, torque=None, **changes):
    given = {"angle": angle, "torque": torque}
    return attrs.evolve(
        recording, **{name: x for name, x in given.items() if x is not None}, channels={}, **changes
    )


def places(recording, count, length, seed=5):
    """Slices of so many seconds here and there in a record, never two in one place."""
    random = np.random.default_rng(seed)
    samples = round(length * recording.sampling_rate)
    slots = random.choice(len(recording) // samples, count, replace=False)
    return [slice(slot * samples, (slot + 1) * samples) for slot in slots]


# Faults of a record, before it is decimated and cut.


def clipped(recording, which, level=1.0):
    """A sensor whose range ends at so many standard deviations."""
    values = getattr(recording, which)
    centre, limit = values.mean(), level * values.std()
    return changed(recording, **{which: np.clip(values, centre - limit, centre + limit)})


def spiked(recording, which, count=12, height=12.0):
    """Single samples far off."""
    values = getattr(recording, which).copy()
    for place in places(recording, count, 1.0):
        # Three samples of the record: a spike that a filter leaves as one of the decimated record.
        middle = (place.start + place.stop) // 2
        values[middle - 1 : middle + 2] += height * values.std()
    return changed(recording, **{which: values})


def held(recording, which, count=8, length=0.6, share=1.0):
    """A signal that stays where it is for a while, or at a share of that."""
    values = getattr(recording, which).copy()
    for place in places(recording, count, length):
        values[place] = share * values[place.start]
    return changed(recording, **{which: values})


zero = partial(held, share=0.0)


def gapped(recording, kind="held", count=3, length=0.05):
    """Both signals held, zero or interpolated linearly, from 7 s on, 17 s, and so on."""
    samples = round(length * recording.sampling_rate)
    signals = np.stack([recording.angle, recording.torque])
    line = np.arange(1, samples + 1) / (samples + 1)
    for number in range(count):
        first = round((10 * number + 7) * recording.sampling_rate)
        before, after = signals[:, [first - 1]], signals[:, [first + samples]]
        gap = {"held": before, "zero": 0.0, "line": before + (after - before) * line}
        signals[:, first : first + samples] = gap[kind]
    return changed(recording, *signals)


def humming(recording, frequency=49.97, share=0.05):
    """Mains hum of a share of the angle's RMS in the angle."""
    turns = frequency * np.arange(len(recording)) / recording.sampling_rate
    hum = share * recording.angle.std() * np.sqrt(2) * np.sin(2 * np.pi * turns)
    return changed(recording, angle=recording.angle + hum)


def late(recording, seconds=0.03):
    """A torque recorded later than the angle."""
    samples = round(seconds * recording.sampling_rate)
    return changed(recording, torque=np.roll(recording.torque, samples))


def coarse(recording, deviations=0.33):
    """An angle in steps of so many standard deviations."""
    step = deviations * recording.angle.std()
    return changed(recording, angle=np.round(recording.angle / step) * step)


def filtered(recording, order, cutoff, both_ways=False):
    """Both channels through one low-pass in Hz, causal or both ways in time: no fault."""
    taps = butter(order, cutoff, fs=recording.sampling_rate)
    through = filtfilt if both_ways else lfilter
    return changed(recording, through(*taps, recording.angle), through(*taps, recording.torque))


def drifting(recording, which, deviations=5.0):
    """A sensor whose offset moves by so many standard deviations from start to end."""
    values = getattr(recording, which)
    drift = np.linspace(0, deviations * values.std(), len(values))
    return changed(recording, **{which: values + drift})


def softening(recording, share=0.3):
    """A torque that falls from start to end, as that of a muscle that tires."""
    left = np.linspace(1.0, 1.0 - share, len(recording))
    return changed(recording, torque=recording.torque * left)


@cache
def giving_way(
    duration=150.0,
    perturbation="noise",
    actuator=100.0,
    snr_db=5.0,
    seed=1,
    stiffness=100.0,
    noise_bandwidth=40.0,
):
    """A joint on a soft actuator, which noise in the torque moves."""
    system = tv.simulate.CompliantActuator(
        tv.simulate.Constant(stiffness) if isinstance(stiffness, float) else stiffness,
        actuator_stiffness=actuator,
        noise_bandwidth=noise_bandwidth,
    )
    kind = tv.simulate.PERTURBATIONS[perturbation]
    return system.simulate(duration, perturbation=kind, snr_db=snr_db, seed=seed).recording


@cache
def reflexive(gain=5.0, seed=1):
    """A virtual participant with a stretch reflex, prepared."""
    traits = attrs.evolve(tv.simulate.Traits.of(seed), reflex_gain=gain)
    return tv.preprocess.prepare_experiment(
        tv.simulate.Participant(seed, traits).simulate().recording
    ).ensemble


# Faults of an ensemble.


def shifted(recording, period=2.0, share=0.2, seconds=0.3):
    """Some realizations cut too early or too late."""
    ensemble = realizations(recording, period, 1.0)
    random, count = np.random.default_rng(3), len(ensemble)
    moves = np.where(random.random(count) < share, random.choice([-1, 1], count), 0)
    moves = np.round(moves * seconds * ensemble.sampling_rate).astype(int)
    rows = np.arange(count)[:, None]
    place = (rows, 50 + np.arange(ensemble.samples + 100) + moves[:, None])
    signals = {
        name: getattr(ensemble, name)[place] for name in ("angle", "torque", "recorded_angle")
    }
    return tv.preprocess.subtract_mean(attrs.evolve(ensemble, **signals, context=50))


def mixed(ensemble, share=0.15, factor=1.6):
    """Some realizations in which the same angle is answered by more torque."""
    every = max(2, round(1 / share))
    factors = np.where(np.arange(len(ensemble)) % every == 1, factor, 1.0)
    return attrs.evolve(ensemble, torque=ensemble.torque * factors[:, None])


def halved(ensemble, differently, seed=6):
    """A random half of the realizations with another torque, as a function of the ensemble says."""
    half = np.random.default_rng(seed).random(len(ensemble)) < 0.5
    torque = np.where(half[:, None], differently(ensemble), ensemble.torque)
    return tv.preprocess.subtract_mean(attrs.evolve(ensemble, torque=torque))


def thrice(ensemble, count=10):
    """The same few realizations three times each."""
    return ensemble.select(np.repeat(np.arange(count), 3))


def repeated(recording, period=2.0, noise=2e-5, seed=4):
    """Repeat one realization's perturbation, with a little noise of the angle's sensor."""
    random = np.random.default_rng(seed)
    ensemble = realizations(recording, period)
    sizes = {"angle": noise, "torque": 0.3 * ensemble.torque.std()}
    signals = {
        name: getattr(ensemble, name)[:1] + size * random.standard_normal(ensemble.angle.shape)
        for name, size in sizes.items()
    }
    return attrs.evolve(ensemble, **signals)
