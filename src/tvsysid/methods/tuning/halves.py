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
from tvsysid.methods.tuning.evidence import Evidence, edge_of
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

DEALS = 6  # how often the realizations are dealt into halves
# standard deviations over deals by which settings must be better than those given to be chosen
BEYOND = 1.0
FEWEST = 8  # realizations below which halves say nothing
KNOWN = 0.5  # share of the times that the settings given know which others must know too
DETERMINED = 4  # samples for each lag from which on the reference is determined


class Halves:
    """Estimates of stiffness from halves of an ensemble, and how good settings are by them.

    The reference has lags of ``max_lag`` seconds to either side; ``seed`` is of the deals.
    """

    def __init__(self, ensemble: Ensemble, max_lag: float, seed: int) -> None:
        if len(ensemble) < FEWEST:
            raise InputError(
                f"tuned: settings are chosen by halves of the realizations, and {len(ensemble)} "
                "are too few; give at "
                f"least {FEWEST}"
            )
        random = np.random.default_rng(seed)
        hands = [random.permutation(len(ensemble)) % 2 for _ in range(DEALS)]
        self.halves = [(ensemble.select(hand == 0), ensemble.select(hand == 1)) for hand in hands]
        self.references = self._of_halves(lambda half: reference_stiffness(half, max_lag))

    def estimates(self, method: Method) -> Array:
        """Stiffness from each half, shape (deal, half, time); raises what the method does."""
        return self._of_halves(lambda half: method.fit(half).stiffness)

    def errors(self, stiffness: Array) -> Array:
        """Estimated mean square error in (N·m/rad)², shape (deal, method).

        ``stiffness`` (method, deal, half, time) holds all methods that are to be compared: the
        error is a mean over the times that all of them know.
        """
        known = np.isfinite(stiffness).all(axis=(0, 1, 2)) & np.isfinite(self.references).all(
            axis=(0, 1)
        )
        off = stiffness[..., known] - self.references[..., known]
        apart = stiffness[:, :, 0, known] - stiffness[:, :, 1, known]
        return np.asarray(
            np.mean(off[:, :, 0] * off[:, :, 1], axis=-1) + np.mean(apart**2, axis=-1) / 4
        ).T

    def _of_halves(self, estimate: Callable[[Ensemble], Array]) -> Array:
        return np.array([[estimate(half) for half in pair] for pair in self.halves])


def reference_stiffness(ensemble: Ensemble, max_lag: float) -> Array:
    """Stiffness as :class:`ShortDataSegments` gives it, over the shortest window that determines it; shape (time,)."""
    lags = fitting_lags("tuned", max_lag, ensemble)
    samples = DETERMINED * (2 * lags + 1) / len(ensemble)
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
    """Settings chosen one after another, each the best of its grid, or left alone if none is clearly better.

    ``grids`` are values to be tried by name, in the order of choice; the last is what the
    evidence is drawn against.
    """
    halves = Halves(ensemble, max_lag, seed)
    tried: list[Mapping[str, Any]] = [{name: getattr(method, name) for name in grids}]
    estimates, chosen = [halves.estimates(method)], 0
    enough = KNOWN * _known(estimates[0])
    for name, grid in grids.items():
        settings = tried[chosen]
        for value in grid:
            if value == settings[name]:
                continue
            try:
                found = halves.estimates(with_settings(method, **{**settings, name: value}))
            except InputError:  # it does not fit the ensemble
                continue
            if _known(found) >= enough:
                tried.append({**settings, name: value})
                estimates.append(found)
        errors = halves.errors(np.array(estimates))
        gains = errors[:, chosen, None] - errors
        best = int(np.argmax(gains.mean(axis=0)))
        if gains[:, best].mean() > BEYOND * gains[:, best].std(ddof=1):
            chosen = best
    axis = list(grids)[-1]
    others = [name for name in grids if name != axis]
    return Evidence(
        criterion="cross-validated mean square error of stiffness (two halves)",
        unit="(N·m/rad)²",
        better="lower",
        tried=tuple(tried),
        values=errors.mean(axis=0),
        standard_errors=(errors - errors[:, :1]).std(axis=0, ddof=1),
        chosen=chosen,
        axis=f"{axis} (s)",
        positions=np.array([settings[axis] for settings in tried]),
        lines=tuple(
            ", ".join(f"{name} {settings[name]:g} s" for name in others) for settings in tried
        ),
        edges=tuple(
            edge
            for name in grids
            for edge in edge_of(name, tried[chosen][name], (each[name] for each in tried))
        ),
    )


def _known(estimates: Array) -> int:
    """Number of times that estimates know in all halves."""
    return int(np.isfinite(estimates).all(axis=(0, 1)).sum())
