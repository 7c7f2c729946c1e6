"""Tables of the switches, and of how smooth the rest is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tvsysid.methods.adaptive.averaging import Averaged
from tvsysid.methods.adaptive.mixture import Candidate, path
from tvsysid.methods.adaptive.model import Smoothness, Switch
from tvsysid.methods.adaptive.placing import CLOSE, distance
from tvsysid.numerics import Array

WORTH, NAMED = 0.01, 0.05  # probabilities from which on a smooth part, and a switch, is listed


def parameters(found: Averaged) -> float:
    """Return the best candidate's effective number of parameters; a switch time counts as one."""
    best = found.candidates[0]
    line = best.smooth.line
    factor = path(best).factor
    return float(np.einsum("tc,ts,sc->", factor, line.precision, factor, optimize=True)) + len(
        best.placed.positions
    )


def smoothness(quantity: str, found: Averaged, unit: float, rate: float) -> Iterator[Smoothness]:
    """Return the smooth parts that are likely, the most probable first."""
    line = found.candidates[0].smooth.line
    rows, probabilities = [], dict[tuple[str, float, float], float]()
    for each, share in zip(found.every, found.probabilities(), strict=True):
        key = each.roughness.kind, each.roughness.amplitude, each.roughness.length
        probabilities[key] = probabilities.get(key, 0.0) + float(share)
    for (kind, amplitude, length), probability in probabilities.items():
        rows.append(
            Smoothness(quantity, kind, amplitude * line.size * unit, length / rate, probability)
        )
    yield from sorted(
        (row for row in rows if row.probability >= WORTH), key=lambda row: -row.probability
    )


def switches(
    quantity: str, found: Averaged, unit: float, missing: int, rate: float
) -> Iterator[Switch]:
    """Return the switches that are likely enough to be listed, in the order of time."""
    line = found.candidates[0].smooth.line
    seen: list[tuple[float, Switch]] = []
    for candidate in found.candidates:
        positions = candidate.placed.positions
        if not len(positions):
            continue
        sizes, before = path(candidate).found, [other for other, _ in seen]
        for place, position in enumerate(positions):
            if any(distance(line, np.array([other]), position)[0] < CLOSE for other in before):
                continue
            weight = min(
                sum(share for _, share in _near(found, position)), 1.0
            )  # rounding may exceed it
            earliest, latest = _limits(candidate, place)
            error = float(np.sqrt(sizes.covariance[place, place]))
            size = line.size * unit
            first, early, late = (
                (float(value) + missing) / rate for value in (position, earliest, latest)
            )
            row = Switch(
                quantity, first, early, late, size * float(sizes.mean[place]), size * error, weight
            )
            seen.append((position, row))
    rows = [row for _, row in seen if row.probability >= NAMED]
    yield from sorted(rows, key=lambda row: row.time)


def _near(found: Averaged, position: float) -> Iterator[tuple[Candidate, float]]:
    """Return the candidates with a switch near a position, and their weights."""
    for candidate, weight in zip(found.candidates, found.weights, strict=True):
        positions = candidate.placed.positions
        line = candidate.smooth.line
        if len(positions) and distance(line, positions, position).min() < CLOSE:
            yield candidate, float(weight)


def _limits(candidate: Candidate, place: int) -> tuple[float, float]:
    """Return the positions between which a switch lies with a probability of 95 %."""
    window, share = candidate.placed.windows[place], candidate.placed.shares[place]
    times, mode = candidate.smooth.line.axis.times, candidate.placed.positions[place]
    offsets: Array = window - mode
    if candidate.smooth.line.axis.periodic:
        offsets = np.mod(offsets + times / 2, times) - times / 2
    order = np.argsort(offsets)
    total = np.cumsum(share[order])
    first, last = np.searchsorted(total, [0.025, 0.975])
    early, late = offsets[order][first], offsets[order][min(last, len(order) - 1)]
    return float(mode + min(early, 0.0)), float(mode + max(late, 0.0))
