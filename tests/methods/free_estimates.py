"""Estimates of a stiffness that is free at each time, with correlated errors and switches."""

import numpy as np

from tvsysid.methods.adaptive import evidence, prior


def estimate_of(random, periodic, times=40, switches=(12.3, 27.8)):
    axis = prior.Axis(times, periodic)
    factor = 0.1 * np.eye(times) + 0.03 * np.tri(times, k=1)
    steps = axis.steps(np.array(switches), recorded=True)
    values = 5 + steps @ [2.0, -3.0][: len(switches)] + factor @ random.normal(size=times)
    covariance = factor @ factor.T / 25
    return evidence.FreeEstimate(axis, values / 5, np.linalg.inv(factor / 5), 5.0), covariance
