"""Colour and strength of the noise over time, and misfit, which is not noise."""

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
    """Return sums over realizations of products of the residual, shape (time, time).

    The residual is that of ``coefficients`` (signal, time).
    """
    total: Array | float = 0.0
    for block in signals.blocks():
        left = block[-1] - viscosity * block[V] - np.einsum("krt,kt->rt", block[:-1], coefficients)
        total = total + left.T @ left
    return np.asarray(total)


def reach_of(independent: int, rate: float) -> int:
    """Return the samples to either side over which the strength of the noise is pooled.

    With few realizations, the strength at a single time is uncertain.
    """
    return round(max(POOLED, TOGETHER / max(independent - 1, 1)) * rate)


def whitened(covariance: Array, independent: int, rate: float, periodic: bool) -> Array:
    """Return the filter (time, time) that makes the noise white with unit variance.

    It predicts the noise from the samples before, and divides the prediction error by its strength,
    pooled over time. The Bayesian information criterion gives the number of samples.
    """
    times, reach = len(covariance), reach_of(independent, rate)
    filters = predictors(covariance, min(round(COLOUR * rate), times // 4), independent)
    left = np.einsum("ti,ti->t", filters @ covariance, filters)
    strength = pooled(left, reach, periodic) / pooled(np.ones(times), reach, periodic)
    return np.asarray(filters / np.sqrt(strength)[:, None])


def predictors(covariance: Array, lags: int, independent: int) -> Array:
    """Return the noise less its prediction, shape (time, time).

    The rows of the first samples have orders from 0 up, until the chosen order is reached.
    """
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
    """Return sums over ``reach`` samples to either side."""
    reach = min(reach, (len(values) - 1) // 2)
    if not reach:
        return values
    ends = (values[-reach:], values[:reach]) if periodic else (np.zeros(reach), np.zeros(reach))
    return np.convolve(
        np.concatenate([ends[0], values, ends[1]]), np.ones(2 * reach + 1), mode="valid"
    )


class Misfit(NamedTuple):
    """Variances by which viscosity and inertia seem to change over time, beyond the noise."""

    viscosity: float
    inertia: float


def misfit(gram: Array, coefficients: Array, independent: int) -> Misfit:
    """Estimate the misfit that all realizations share: a response that is not of second order.

    At each time the residual of the ``coefficients`` (signal, time) is regressed on velocity and
    acceleration. The regression coefficients vary more than by chance where there is misfit.
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
    """Return the correlation of the misfit at two times, shape (time, time)."""
    return np.asarray(toeplitz(np.exp(-np.arange(times) / (rate * POOLED))))
