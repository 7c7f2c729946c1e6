r"""Which settings give the least error of stiffness, judged by halves of the realizations.

The mean square error of an estimate of stiffness, K, is its squared bias and its variance.
Realizations are dealt at random into halves A and B, and from each half K is estimated, as well as
a reference R that averages over hardly any time and so has little bias, if much noise:

.. math:: S = \overline{(K_A - R_A)(K_B - R_B)} + \tfrac14 \overline{(K_A - K_B)^2}

(means over time). The halves' noise is independent, so that the first term is the squared
difference of the biases; the second is the variance of an estimate from all realizations, as a half
has twice that. Several deals are averaged.

Leaving out realizations and predicting their torque is no substitute: it asks for the impulse
response as a whole, whose variance goes with the number of lags, and so chooses windows that are
far too wide for stiffness. See docs/tuning.md, with figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.base import Method, fitting_lags, missing_edge, padded
from tvsysid.methods.shared.correlations import solve_windows
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

DEALS = 6  # how often the realizations are dealt into halves
MIN_GAIN = 1.0  # standard deviations over deals by which other settings must be better
MIN_REALIZATIONS = 8
MIN_KNOWN = 0.5  # share of the times known with the settings given
SAMPLES_PER_LAG = 4  # from which on the reference is determined


Estimator = Callable[[Ensemble], Array]


def deal(ensemble: Ensemble, seed: int) -> list[tuple[Ensemble, Ensemble]]:
    """Return pairs of halves into which the realizations are dealt at random."""
    if len(ensemble) < MIN_REALIZATIONS:
        raise InputError(
            f"tuned: settings are chosen by halves of the realizations, and {len(ensemble)} "
            f"are too few; give at least {MIN_REALIZATIONS}"
        )
    random = np.random.default_rng(seed)
    hands = [random.permutation(len(ensemble)) % 2 for _ in range(DEALS)]
    return [(ensemble.select(hand == 0), ensemble.select(hand == 1)) for hand in hands]


def of_halves(pairs: list[tuple[Ensemble, Ensemble]], estimate: Estimator) -> Array:
    """Return the estimate of each half, shape (deal, half, time)."""
    return np.array([[estimate(half) for half in pair] for pair in pairs])


def mean_square_errors(stiffness: Array, references: Array) -> Array:
    """Return the mean square error in (N·m/rad)², shape (deal, method).

    It is a mean over the times at which all methods know ``stiffness``, whose shape is (method,
    deal, half, time). The ``references`` have the shape (deal, half, time).
    """
    known = np.isfinite(stiffness).all(axis=(0, 1, 2)) & np.isfinite(references).all(axis=(0, 1))
    first, second = np.moveaxis(stiffness[..., known], 2, 0)
    bias = (first - references[:, 0, known]) * (second - references[:, 1, known])
    return np.asarray(np.mean(bias + (first - second) ** 2 / 4, axis=-1)).T


def reference_stiffness(ensemble: Ensemble, max_lag: float) -> Array:
    """Return stiffness (time,) by :class:`ShortDataSegments` with the shortest window possible."""
    lags = fitting_lags("tuned", max_lag, ensemble)
    samples = SAMPLES_PER_LAG * (2 * lags + 1) / len(ensemble)
    half = min(math.ceil(max(0.0, (samples - 1) / 2)), (ensemble.samples - 1) // 2)
    solution = solve_windows(ensemble, lags, half)
    return padded(solution.weights.sum(axis=1), missing_edge(lags, ensemble))


def evidence_by_halves(
    method: Method,
    ensemble: Ensemble,
    seed: int,
    grids: Mapping[str, Sequence[float]],
    max_lag: float,
) -> Evidence:
    """Choose settings one after another, each the best of its grid if that is clearly better.

    Parameters
    ----------
    method, ensemble, seed
        As for :meth:`tvsysid.methods.Method.tuned`.
    grids
        Values to try by setting, in the order of choice. The last setting is the figure's axis.
    max_lag
        Lags of the reference to either side in s.
    """
    pairs = deal(ensemble, seed)
    references = of_halves(pairs, lambda half: reference_stiffness(half, max_lag))

    def stiffness_by(settings: Mapping[str, Any]) -> Array:
        chosen = with_settings(method, **settings)
        return of_halves(pairs, lambda half: chosen.fit(half).stiffness)

    tried: list[dict[str, Any]] = [{name: getattr(method, name) for name in grids}]
    estimates, chosen = [stiffness_by(tried[0])], 0
    for name, grid in grids.items():
        for settings in ({**tried[chosen], name: value} for value in grid):
            if settings == tried[chosen]:
                continue
            try:
                estimate = stiffness_by(settings)
            except InputError:  # the settings do not fit the ensemble
                continue
            if _known_times(estimate) >= MIN_KNOWN * _known_times(estimates[0]):
                tried.append(settings)
                estimates.append(estimate)
        errors = mean_square_errors(np.array(estimates), references)
        gains = errors[:, chosen, None] - errors
        best = int(np.argmax(gains.mean(axis=0)))
        if gains[:, best].mean() > MIN_GAIN * gains[:, best].std(ddof=1):
            chosen = best
    *others, axis = grids
    return Evidence(
        criterion="cross-validated mean square error of stiffness (two halves)",
        unit="(N·m/rad)²",
        better="lower",
        tried=tuple(tried),
        values=errors.mean(axis=0),
        chosen=chosen,
        axis=f"{axis} (s)",
        positions=np.array([settings[axis] for settings in tried]),
        lines=tuple(", ".join(f"{each} {one[each]:g} s" for each in others) for one in tried),
    )


def _known_times(estimates: Array) -> int:
    """Return the number of times that estimates know in all halves."""
    return int(np.isfinite(estimates).all(axis=(0, 1)).sum())
