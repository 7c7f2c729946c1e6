"""Simulate joints by plain NumPy, independently of the package.

Their angles are imposed, or they are in a loop, or they ring freely.
"""

import numpy as np
from scipy.signal import cont2discrete, lfilter

import tvsysid as tv

RATE = 1000.0  # Hz
VISCOSITY, INERTIA = 1.2, 0.016  # of the joints whose angle is imposed or that are in a loop
COLOURS = {  # amplitude by frequency in Hz
    "white": lambda f: f < 200.0,
    "wide": lambda f: f < 20.0,
    "pink": lambda f: np.where(f < 200.0, np.maximum(f, 0.1) ** -0.5, 0.0),
    "first-order": lambda f: 1 / np.hypot(1, f / 2.0),
    "slow": lambda f: 1 / np.hypot(1, f / 0.5) ** 2,
}
WAVES = {  # stiffness in N·m/rad by time in s, over a period of 2 s
    "constant": lambda t: np.full(len(t), 100.0),
    "sine": lambda t: 90 + 30 * np.sin(np.pi * t),
    "triangle": lambda t: 130 - 50 * np.abs(t % 2 - 1),
    "ramp": lambda t: 80 + 25 * (t % 2),
    "stairs": lambda t: 60 + 30 * np.minimum(t % 2 // 0.437, 4),
}


def shaped(samples, amplitude, random):
    """Noise of unit RMS with an amplitude by frequency in Hz.

    Periodic, so that its derivatives are exact.
    """
    spectrum = np.fft.rfft(random.standard_normal(samples))
    values = np.fft.irfft(spectrum * amplitude(np.fft.rfftfreq(samples, 1 / RATE)), samples)
    return values / values.std()


def noise(samples, low, high, random):
    """White noise of unit RMS between two frequencies in Hz."""
    return shaped(samples, lambda f: (f >= low) & (f <= high), random)


def coloured(samples, colour, random):
    """Noise of unit RMS of one of the colours, without mean."""
    return shaped(samples, lambda f: COLOURS[colour](f) * (f > 0), random)


def motion(angle):
    """Angle, velocity and acceleration (3, time) of a periodic angle."""
    turns = 2j * np.pi * np.fft.rfftfreq(len(angle), 1 / RATE)
    return np.stack(
        [np.fft.irfft(np.fft.rfft(angle) * turns**power, len(angle)) for power in range(3)]
    )


def impulses(samples, random, jitter):
    """Half sines of 1 N·m and 20 ms, a second apart, each shifted by up to ``jitter`` s."""
    torque, shape = np.zeros(samples), np.sin(np.pi * np.arange(1, 20) / 20)
    for start in np.arange(0.3, samples / RATE - 1.0):
        first = round((start + random.uniform(-jitter, jitter)) * RATE)
        torque[first : first + len(shape)] += shape
    return torque


def ringing(torque, stiffness, viscosity, inertia):
    """Angle (time,) of a joint on which a torque acts: exact for what is held over each sample."""
    held = (torque + np.append(torque[1:], 0.0)) / 2
    (numerator,), denominator, _ = cont2discrete(([1.0], [inertia, viscosity, stiffness]), 1 / RATE)
    return lfilter(numerator, denominator, held)


def ensemble_of(angle, torque, period=2.0, context=0.5, subtract=True, **channels):
    """Realizations at 100 Hz."""
    recording = tv.Recording(angle, torque, RATE, channels=channels)
    cut = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period, context)
    return tv.preprocess.subtract_mean(cut) if subtract else cut


def with_noise(torque, snr_db, random, high=40.0):
    """A torque with noise up to ``high`` Hz, of so much less power."""
    return torque + torque.std() * 10 ** (-snr_db / 20) * noise(len(torque), 0.0, high, random)


def following(stiffness, random):
    """Return the record of a joint whose stiffness follows a slow ``variable`` from 0 to 1.

    It is one realization.
    """
    samples = 100_000
    variable = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(samples) / RATE / 10.0 + random.random()))
    angle, velocity, acceleration = motion(0.0087 * noise(samples, 0.0, 12.0, random))
    torque = stiffness(variable) * angle + 0.8 * velocity + INERTIA * acceleration
    return ensemble_of(
        angle, with_noise(torque, 15.0, random, 15.0), None, subtract=False, variable=variable
    )


def perturbed(samples, perturbation, random):
    """Return the angle in rad: noise up to 8 Hz, or a binary sequence through an actuator.

    The actuator is of second order.
    """
    if perturbation == "noise":
        return 0.02 * noise(samples, 0.0, 8.0, random)
    binary = np.repeat(random.choice([-1.0, 1.0], samples // 150 + 1), 150)[:samples]
    turns = 2j * np.pi * np.fft.rfftfreq(samples, 1 / RATE) / (2 * np.pi * 12.0)
    return 0.02 * np.fft.irfft(np.fft.rfft(binary) / (turns**2 + 1.6 * turns + 1), samples)


def imposed(wave, perturbation, colour, snr_db, seed, duration=80.0):
    """Return angle and torque (2, time) of a joint, and its true stiffness (time,), a wave."""
    random, samples = np.random.default_rng(seed), round(duration * RATE)
    stiffness = WAVES[wave](np.arange(samples) / RATE)
    position, velocity, acceleration = motion(perturbed(samples, perturbation, random))
    torque = stiffness * position + VISCOSITY * velocity + INERTIA * acceleration
    loud = torque.std() * 10 ** (-snr_db / 20)
    return np.stack([position, torque + loud * coloured(samples, colour, random)]), stiffness


def in_loop(load, colour, snr_db, seed):
    """Return angle, torque and command (3, time) of a joint that its own torque noise moves.

    The joint, of 100 N·m/rad, is behind a load in N·m/rad. The command is noise up to 8 Hz; the
    noise's power is so much less than that of the torque without it."""
    random, samples = np.random.default_rng(seed), 80_000
    turns = 2j * np.pi * np.fft.rfftfreq(samples, 1 / RATE)
    joint = 100.0 + VISCOSITY * turns + INERTIA * turns**2
    both = joint + load + 0.02 * load * turns + 0.01 * turns**2
    command = np.fft.rfft(0.04 * noise(samples, 0.0, 8.0, random))
    loud = np.fft.irfft(joint * load * command / both, samples).std() * 10 ** (-snr_db / 20)
    own = np.fft.rfft(loud * coloured(samples, colour, random))
    angle = (load * command - own) / both
    return np.stack([np.fft.irfft(each, samples) for each in (angle, joint * angle + own, command)])
