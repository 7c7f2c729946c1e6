"""A perturbation that is the same in all realizations: lines on multiples of 1/period, which the mean takes away."""

from __future__ import annotations

import numpy as np

from tvsysid.signals import Array, Ensemble

SLOWEST, FASTEST = (
    5.0,
    45.0,
)  # Hz between which a perturbation moves the angle, but hardly a behaviour
MOST = 0.5  # share of the angle's power there that lines must hold
STANDS_OUT = 10.0  # times the power of what all realizations share two harmonics to either side
SURE = 2.0  # standard errors from zero


def repeated_lines(ensemble: Ensemble) -> tuple[Array, float]:
    r"""Lines in Hz that move all realizations alike, if nothing else moves them, and their share of the angle's power.

    None where the rest answers as the lines do: the energy that the joint takes,
    :math:`\sum_k f_k\, \mathrm{Im}\, Y(k)\, U^*(k)`, then has one sign in both. Noise of the torque gives it back.
    """
    core, rate = ensemble.core, ensemble.sampling_rate
    angle, torque = (np.fft.rfft(each[:, core]) for each in (ensemble.angle, ensemble.torque))
    frequency = np.fft.rfftfreq(ensemble.samples, 1 / rate)
    shared = angle.mean(axis=0), torque.mean(axis=0)
    power = np.abs(shared[0]) ** 2
    beside = np.pad(power, 2)
    highest = np.max([beside[shift : shift + len(power)] for shift in (0, 1, 3, 4)], axis=0)
    band = (frequency >= SLOWEST) & (frequency <= FASTEST)
    every = np.mean(np.abs(angle) ** 2, axis=0)
    lines = band & (power > STANDS_OUT * highest) & (power > MOST * every)
    share = float(power[lines].sum()) / max(float(every[band].sum()), np.finfo(float).tiny)
    if share <= MOST:
        return np.zeros(0), share
    energy = (frequency * (shared[1] * shared[0].conj()).imag)[lines].sum()
    left = (frequency * ((torque - shared[1]) * (angle - shared[0]).conj()).imag)[:, band].sum(
        axis=1
    )
    answers = np.sign(energy) * left.mean() > SURE * left.std() / np.sqrt(len(left))
    return (np.zeros(0) if answers else frequency[lines]), share
