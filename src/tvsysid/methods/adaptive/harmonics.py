"""Smooth parts that are sums of few cosines and sines."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.methods.adaptive.evidence import Columns, Line
from tvsysid.methods.adaptive.prior import AMPLITUDES, LEVEL, Roughness

HARMONICS, MOST_WAVES = 12, 8  # that are tried, and cosines and sines of a sum at most
SHARE = 0.1  # prior weight of all sums; that of no smooth part is 0.5
FIRST, SECOND = 1 / 20, 2.0  # prior odds of a harmonic's cosine or sine, and then of the other one
STEP = 0.2  # standard deviation of the steps, in mean sizes


def few_harmonics(line: Line, steps: Columns) -> list[Roughness]:
    """Add the most evident cosine or sine to a constant and some steps, again and again.

    Return each sum on the way.

    Each cosine and sine has a standard deviation of its own, one of AMPLITUDES.
    """
    count, out = 1 + 2 * min(HARMONICS, line.axis.harmonics), list[Roughness]()
    features = steps.features[:count]
    gram = np.block(
        [[line.gram[:count, :count], features], [features.T, steps.seen.T @ steps.weighted]]
    )
    cross = np.append(line.cross[:count], steps.cross)
    variances, weights = np.square(AMPLITUDES)[:, None], np.zeros(len(line.cross))
    log_prior = math.log(SHARE) - (count - 1) / 2 * math.log1p(FIRST * (2 + SECOND))
    always = [(0, LEVEL**2), *((place, STEP**2) for place in range(count, len(cross)))]
    for turn in range(len(always) + min(MOST_WAVES, count - 1)):
        if turn < len(always):
            place, variance = always[turn]
        else:
            known = weights[1:count] > 0
            odds = np.log(
                np.where(known.reshape(-1, 2)[:, ::-1].ravel(), SECOND, FIRST) / len(AMPLITUDES)
            )
            left = 1 + variances * np.diag(gram)[1:count]
            gain = odds + 0.5 * (variances * cross[1:count] ** 2 / left - np.log(left))
            gain[:, known] = -np.inf
            size, place = divmod(int(np.argmax(gain)), count - 1)
            log_prior, place, variance = (
                log_prior + odds[place],
                place + 1,
                float(variances[size, 0]),
            )
        if place < count:
            weights[place] = variance
        share = variance / (1 + variance * gram[place, place]) * gram[place]
        gram, cross = gram - np.outer(share, gram[place]), cross - share * cross[place]
        if turn >= len(always):
            top = (int(np.flatnonzero(weights)[-1]) + 1) // 2
            amplitude = math.sqrt(weights[1:].sum() / 2)
            out.append(
                Roughness(
                    "few harmonics", amplitude, line.axis.period / top, log_prior, weights.copy()
                )
            )
    return out
