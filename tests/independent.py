"""Joints simulated by plain NumPy, independently of the package: imposed angles, and joints that ring freely."""

import numpy as np

import tvsysid as tv

RATE = 1000.0  # Hz


def noise(samples, low, high, random):
    """White noise of unit RMS between two frequencies in Hz; periodic, so that its derivatives are exact."""
    spectrum = np.fft.rfft(random.standard_normal(samples))
    frequencies = np.fft.rfftfreq(samples, 1 / RATE)
    spectrum[(frequencies < low) | (frequencies > high)] = 0
    values = np.fft.irfft(spectrum, samples)
    return values / values.std()


def motion(angle):
    """Angle, velocity and acceleration (3, time) of a periodic angle."""
    turns = 2j * np.pi * np.fft.rfftfreq(len(angle), 1 / RATE)
    return np.stack([np.fft.irfft(np.fft.rfft(angle) * turns**power, len(angle)) for power in range(3)])


def impulses(samples, interval, duration, random=None, jitter=0.0):
    """Half sines of 1 N·m, ``interval`` s apart, each shifted by up to ``jitter`` s."""
    torque, shape = np.zeros(samples), np.sin(np.pi * np.arange(1, round(duration * RATE)) / (duration * RATE))
    for start in np.arange(0.3, samples / RATE - interval, interval):
        first = round((start + (random.uniform(-jitter, jitter) if random is not None else 0.0)) * RATE)
        torque[first : first + len(shape)] += shape
    return torque


def ringing(torque, stiffness, viscosity, inertia):
    """Angle (time,) of a joint on which a torque acts: exact for what is held over each sample."""
    angle, state = np.empty(len(torque)), np.zeros(2)
    steps = {}
    held = (torque + np.append(torque[1:], 0.0)) / 2
    for place, (applied, k, b) in enumerate(zip(held, stiffness, viscosity, strict=True)):
        angle[place] = state[0]
        if (key := (round(k, 3), round(b, 5))) not in steps:
            slopes = np.array([[0, 1, 0], [-k / inertia, -b / inertia, 1 / inertia], [0, 0, 0]]) / RATE
            step, term = np.eye(3), np.eye(3)
            for power in range(1, 12):
                term = term @ slopes / power
                step = step + term
            steps[key] = step
        state = steps[key][:2, :2] @ state + steps[key][:2, 2] * applied
    return angle


def ensemble_of(angle, torque, period=2.0, context=0.5, subtract=True, **channels):
    """Realizations at 100 Hz."""
    recording = tv.Recording(angle, torque, RATE, channels=channels)
    cut = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period, context)
    return tv.preprocess.subtract_mean(cut) if subtract else cut


def with_noise(torque, snr_db, random, high=40.0):
    """A torque with noise up to ``high`` Hz, of so much less power."""
    return torque + torque.std() * 10 ** (-snr_db / 20) * noise(len(torque), 0.0, high, random)


def following(stiffness, random, duration=100.0, snr_db=15.0, viscosity=0.8, inertia=0.016):
    """Record, as one realization, of a joint whose stiffness is a function of a slow ``variable`` from 0 to 1."""
    samples = round(duration * RATE)
    variable = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(samples) / RATE / 10.0 + random.random()))
    angle, velocity, acceleration = motion(0.0087 * noise(samples, 0.0, 12.0, random))
    torque = stiffness(variable) * angle + viscosity * velocity + inertia * acceleration
    return ensemble_of(angle, with_noise(torque, snr_db, random, 15.0), None, subtract=False, variable=variable)
