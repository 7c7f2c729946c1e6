"""How sure a coefficient that is free at every time is: from the realizations' own scatter, whatever its colour."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import toeplitz

from tvsysid.methods.adaptive.moments import A, Signals, U, V, floored, without_angle
from tvsysid.numerics import Array
from tvsysid.numerics.moments import diagonal_moments

POOLED = 0.05  # s to either side over which the strength of the noise is pooled; also how far misfit is alike
TOGETHER = 0.5  # s of all realizations but one together over which it is pooled to either side at least
COLOUR = 0.25  # s over which the noise of the scores is correlated at most
LEAST_EIGENVALUE = 0.02  # of the noise's correlation matrix
TOLD = 1e-6  # determinant of velocity's and acceleration's correlations below which they cannot be told apart
EXACT = 1e-8  # share of the torque's power that is taken as noise at least
REGRESSORS = (U, V)  # that have a coefficient free at every time: stiffness, or viscosity


class Scores(NamedTuple):
    """Sums over realizations of scores ``x e`` and regressors x at a time and up to COLOUR later, both (time, lag).

    ``powers`` (time,) are sums of x² u², for the share of the noise that a free stiffness takes.
    """

    products: Array
    regressors: Array
    powers: Array


def scores(signals: Signals, coefficients: Array) -> tuple[Scores, Scores]:
    """Scores of angle and velocity with what ``coefficients`` (signal, time) leave of the torque."""
    times = coefficients.shape[1]
    lags = min(round(COLOUR * signals.rate), times - 1)
    sums = np.zeros((2, 2, times, lags + 1))
    powers = np.zeros((2, times))
    for block in signals.blocks():
        left = block[-1] - np.einsum("krt,kt->rt", block[:-1], coefficients)
        for place, which in enumerate(REGRESSORS):
            x = block[which]
            for row, values in enumerate((x * left, x)):
                sums[place, row] += diagonal_moments(values, values, lags) * len(x)
            powers[place] += np.einsum("rt,rt->t", x * x, block[U] ** 2)
    return Scores(sums[0, 0], sums[0, 1], powers[0]), Scores(sums[1, 0], sums[1, 1], powers[1])


class Scatter(NamedTuple):
    """Standard error (time,) of a coefficient free at every time, and its autocorrelation (lag,) over all lags.

    They were found from so many degrees of ``freedom``.
    """

    error: Array
    correlation: Array
    freedom: float

    def covariance(self) -> Array:
        """Of the coefficient, (time, time)."""
        return np.asarray(toeplitz(self.correlation) * np.outer(self.error, self.error))


def scatter(gram: Array, found: Scores, realizations: tuple[int, int], rate: float, periodic: bool) -> Scatter:
    """Sandwich of the scores of a regressor; ``realizations`` are how many there are, and are independent."""
    count, independent = realizations
    wide = max(POOLED, TOGETHER / max(independent - 1, 1))  # few realizations say little of the noise at a time
    reach, power = round(wide * rate), floored(found.regressors[:, 0])
    left = np.maximum(power - found.powers / floored(gram[:, U, U]), 1e-3 * power) * independent / count
    least = EXACT * float(gram[:, -1, -1].mean()) / count
    strength = pooled(found.products[:, 0], reach, periodic) / pooled(left, reach, periodic)
    score = np.sqrt(np.maximum(strength, least) * power)
    correlation = _correlation(found, score, power, independent)
    spread = score / power
    samples = min(2 * reach + 1, len(power)) / (1 + 2 * float(np.sum(correlation[1 : 2 * reach] ** 2)))
    return Scatter(spread, _definite(correlation, len(power)), max(1.0, (independent - 1) * samples))


def pooled(values: Array, reach: int, periodic: bool) -> Array:
    """Sums over so many samples to either side."""
    reach = min(reach, (len(values) - 1) // 2)
    if not reach:
        return values
    ends = (values[-reach:], values[:reach]) if periodic else (np.zeros(reach), np.zeros(reach))
    return np.convolve(np.concatenate([ends[0], values, ends[1]]), np.ones(2 * reach + 1), mode="valid")


def _correlation(found: Scores, score: Array, power: Array, independent: int) -> Array:
    """Autocorrelation of the scores (lag,), with what a coefficient free at every time took put back."""
    times, lags = found.products.shape
    out = np.ones(lags)
    variance = float(np.sum(found.products[:, 0] / score**2))
    for lag in range(1, lags):
        early, late = slice(times - lag), slice(lag, times)
        own = float(np.sum(found.products[early, lag] / (score[early] * score[late])))
        alike = float(np.mean(found.regressors[early, lag] ** 2 / (power[early] * power[late])))
        put_back = max(independent - 3, 0) / max(independent - 5 + 2 * alike, 1.0)
        out[lag] = own / max(variance, np.finfo(float).tiny) * put_back * (1 - (lag / lags) ** 2)
    return out


def _definite(correlation: Array, times: int) -> Array:
    """First row of the Toeplitz matrix of a correlation whose smallest eigenvalue is LEAST_EIGENVALUE or more."""
    row = np.zeros(times)
    row[: len(correlation)] = correlation[:times]
    # The smallest value of its spectrum bounds the eigenvalues from below.
    least = float(np.fft.rfft(np.concatenate([row, [0.0], row[:0:-1]])).real.min())
    if least < LEAST_EIGENVALUE:
        row = row / (1 + LEAST_EIGENVALUE - least)
        row[0] = 1.0
    return row


class Misfit(NamedTuple):
    """Variances by which viscosity and inertia seem to change from time to time beyond the noise."""

    viscosity: float
    inertia: float


def misfit(gram: Array, coefficients: Array, independent: int) -> Misfit:
    """Of what a joint of second order does not describe, in the same way in all realizations.

    At each time what the ``coefficients`` (signal, time) leave is regressed on velocity and acceleration; the
    answers vary more than by chance where there is misfit.
    """
    every = without_angle(gram)
    own = every[:, :2, :2]
    cross = every[:, [V - 1, A - 1], -1] - np.einsum("tij,jt->ti", every[:, [V - 1, A - 1], :-1], coefficients[1:])
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
    left = np.maximum(square[sure] - np.einsum("ti,ti->t", moved, cross[sure]), 0.0) / (independent - 3)
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
