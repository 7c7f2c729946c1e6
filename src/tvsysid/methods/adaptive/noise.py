"""What colour the noise has and how loud it is over time; and what is misfit, not noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import solve_triangular, toeplitz

from tvsysid.methods.adaptive.moments import A, Signals, V, without_angle
from tvsysid.numerics import Array

# s to either side over which the strength of the noise is pooled; also how far misfit is alike
POOLED = 0.05
TOGETHER = (
    0.5  # s of all realizations but one together over which it is pooled to either side at least
)
COLOUR = 0.25  # s from which the noise is predicted at most
FLOOR = (
    0.01  # share of the noise's variance that is taken as white at least: the rest may be misfit
)
# determinant of velocity's and acceleration's correlations below which they cannot be told apart
TOLD = 1e-6
EXACT = 1e-8  # share of the torque's power that is taken as noise at least


def residual_products(signals: Signals, coefficients: Array, viscosity: Array) -> Array:
    """Sums over realizations (time, time) of products of what ``coefficients`` (signal, time) leave of the torque."""
    total: Array | float = 0.0
    for block in signals.blocks():
        left = block[-1] - viscosity * block[V] - np.einsum("krt,kt->rt", block[:-1], coefficients)
        total = total + left.T @ left
    return np.asarray(total)


def reach_of(independent: int, rate: float) -> int:
    """Samples to either side over which the strength of the noise is pooled: few realizations say little of a time."""
    return round(max(POOLED, TOGETHER / max(independent - 1, 1)) * rate)


def whitened(covariance: Array, independent: int, rate: float, periodic: bool) -> Array:
    """Filter (time, time) that makes the noise white and of unit variance, from its covariance.

    It predicts the noise from the samples before, as many as the Bayesian information criterion
    says, and divides what it does not predict by its strength, pooled over time.
    """
    times, reach = len(covariance), reach_of(independent, rate)
    filters = predictors(covariance, min(round(COLOUR * rate), times // 4), independent)
    left = np.einsum("ti,ti->t", filters @ covariance, filters)
    strength = pooled(left, reach, periodic) / pooled(np.ones(times), reach, periodic)
    return np.asarray(filters / np.sqrt(strength)[:, None])


def predictors(covariance: Array, lags: int, independent: int) -> Array:
    """Noise less its prediction, (time, time): of each order from 0 at first, of the order chosen from there on."""
    times, (row, column) = len(covariance), covariance.strides
    shape = times - lags, lags + 1, lags + 1
    order = np.append(
        np.arange(lags)[::-1], lags
    )  # the sample before, the one before that ...; last what follows
    near = as_strided(covariance, shape, (row + column, row, column), writeable=False).sum(axis=0)[
        np.ix_(order, order)
    ]
    factor = np.linalg.cholesky(near)
    left = near[-1, -1] - np.append(0.0, np.cumsum(factor[-1, :-1] ** 2))
    samples = independent * shape[0]
    chosen = int(np.argmin(samples * np.log(left) + np.arange(lags + 1) * np.log(samples)))
    out = np.zeros((times, times))
    for time in range(times):
        if time <= chosen:
            weights = solve_triangular(factor[:time, :time], factor[-1, :time], lower=True, trans=1)
            taps = np.append(-weights[::-1], 1.0) * np.sqrt(left[chosen] / left[time])
        out[time, max(time - chosen, 0) : time + 1] = taps
    return out


def pooled(values: Array, reach: int, periodic: bool) -> Array:
    """Sums over so many samples to either side."""
    reach = min(reach, (len(values) - 1) // 2)
    if not reach:
        return values
    ends = (values[-reach:], values[:reach]) if periodic else (np.zeros(reach), np.zeros(reach))
    return np.convolve(
        np.concatenate([ends[0], values, ends[1]]), np.ones(2 * reach + 1), mode="valid"
    )


class Misfit(NamedTuple):
    """Variances by which viscosity and inertia seem to change from time to time beyond the noise."""

    viscosity: float
    inertia: float


def misfit(gram: Array, coefficients: Array, independent: int) -> Misfit:
    """Of what a joint of second order does not describe, in the same way in all realizations.

    At each time what the ``coefficients`` (signal, time) leave is regressed on velocity and
    acceleration; the answers vary more than by chance where there is misfit.
    """
    every = without_angle(gram)
    own = every[:, :2, :2]
    cross = every[:, [V - 1, A - 1], -1] - np.einsum(
        "tij,jt->ti", every[:, [V - 1, A - 1], :-1], coefficients[1:]
    )
    square = (
        every[:, -1, -1]
        - 2 * np.einsum("ti,it->t", every[:, -1, :-1], coefficients[1:])
        + np.einsum("it,tij,jt->t", coefficients[1:], every[:, :-1, :-1], coefficients[1:])
    )
    power = np.einsum("tii->ti", gram[:, V : A + 1, V : A + 1])
    size = np.sqrt(np.maximum(power, 1e-9 * power.mean(axis=0) + np.finfo(float).tiny))
    scaled = own / (size[:, :, None] * size[:, None, :])
    sure = np.linalg.det(scaled) > TOLD
    if independent < 6 or sure.sum() < 20:
        return Misfit(0.0, 0.0)
    inverse = np.linalg.inv(scaled[sure]) / (size[sure][:, :, None] * size[sure][:, None, :])
    moved = np.einsum("tij,tj->ti", inverse, cross[sure])
    left = np.maximum(square[sure] - np.einsum("ti,ti->t", moved, cross[sure]), 0.0) / (
        independent - 3
    )
    out = []
    for place in range(2):
        share = inverse[:, place, place]
        chance = left * share * (independent - 3) / max(independent - 5, 1)
        excess, weight = moved[:, place] ** 2 - chance, 1 / share
        mean = float(np.sum(weight * excess) / np.sum(weight))
        seen = 5 * float(np.sum((weight * (excess - mean)) ** 2))
        error = np.sqrt(min(seen, 10 * float(np.sum((weight * chance) ** 2)))) / np.sum(weight)
        out.append(max(0.0, mean - 2 * float(error)))
    return Misfit(*out)


def alike(times: int, rate: float) -> Array:
    """How far misfit is the same at two times (time, time)."""
    return np.asarray(toeplitz(np.exp(-np.arange(times) / (rate * POOLED))))
