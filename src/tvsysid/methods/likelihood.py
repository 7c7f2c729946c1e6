"""Marginal likelihood of a kernel's settings."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tvsysid.methods.kernel import ENDLESS, Kernel
from tvsysid.methods.record import Run, statistics_of, weak_prior
from tvsysid.numerics.gaussian import Statistics, log_evidence, of_columns, without_nuisance
from tvsysid.numerics.kernels import log_harmonic_variances

Array = NDArray[np.float64]

LENGTHS = np.geomspace(0.002, 30.0, 12)
"""Periodic lengths of which a tuned one is the best."""
NOISES = 20
"""Steps of the noise variance at most, for settings that are given."""
FAINT = 1e-7
"""Share of the noise below which a feature's part of the torque does not count in the likelihood."""


class Tried(NamedTuple):
    """A decay, the logs of l1, three gammas and the noise variance, and their log marginal likelihood."""

    decay: float
    theta: Array
    value: float

    def settings(self) -> dict[str, Any]:
        """As arguments of the method, to four digits."""
        length, decay, *gammas = (
            float(f"{number:.4g}") for number in (*np.exp(self.theta[:1]), self.decay, *np.exp(self.theta[1:4]))
        )
        return {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}


class Likelihood(NamedTuple):
    """Log marginal likelihood as a function of the logs of l1, three gammas and the noise variance.

    ``coefficient`` and ``harmonic`` of each column, and which are ``fixed``, that is without prior.
    """

    statistics: Statistics
    coefficient: NDArray[np.int64]
    harmonic: NDArray[np.int64]
    fixed: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        stacks: list[Run],
        kernel: Kernel,
        kept: NDArray[np.bool_],
        band: tuple[float, float],
        rate: float,
        noise: float,
    ) -> Likelihood:
        """With the external terms eliminated for about this noise variance."""
        coefficient, column = np.nonzero(kept)
        harmonic = np.array([harmonic for harmonic, _, _ in kernel.products])[column]
        statistics = without_nuisance(statistics_of(stacks, kernel, kept, band, rate), weak_prior(stacks), noise)
        return cls(statistics, coefficient, harmonic, column == 0)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Log marginal likelihood, and its derivatives."""
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), int(self.harmonic.max()))
        variances = np.where(self.fixed, 0.0, theta[1 + self.coefficient] + logs[self.harmonic])
        with np.errstate(divide="ignore"):
            strength = variances + np.log(np.diag(self.statistics.gram)) - theta[4]
        seen = self.fixed | (strength > math.log(FAINT))
        precision = np.where(self.fixed, 0.0, np.exp(-np.where(seen, variances, 0.0)))[seen]
        found = log_evidence(of_columns(self.statistics, seen), precision, 1.0, math.exp(theta[4]))
        by_gamma = np.bincount(self.coefficient[seen], found.by_variances, minlength=3)
        by_length = float(found.by_variances @ slopes[self.harmonic[seen]])
        return found.value, np.array([by_length, *by_gamma, found.by_noise])

    def best_noise(self, theta: Array) -> tuple[float, float]:
        """Log of the noise variance that suits the other settings best, and the log marginal likelihood."""
        place = theta.copy()
        for _ in range(NOISES):
            value, slope = self(place)
            # The likelihood of a log variance curves like that of so many numbers.
            step = slope[4] / (0.5 * self.statistics.number)
            if abs(step) < 1e-4:
                break
            place[4] += step
        return float(place[4]), value

    def climb(
        self, theta: Array, length: float | None = None, decay: float = ENDLESS, leeway: float = math.inf
    ) -> Tried:
        """Highest likelihood near a start; at one l1, if that is given, and with gammas no larger than by a leeway."""
        lengths = np.log([LENGTHS[0], LENGTHS[-1]] if length is None else [length, length])
        start = np.concatenate([[np.clip(theta[0], *lengths)], theta[1:]])
        bounds = [tuple(lengths), *((gamma - 50, gamma + min(leeway, 15)) for gamma in theta[1:4]), (None, None)]

        def descent(place: Array) -> tuple[float, Array]:
            value, slope = self(place)
            return -value, -slope

        found = minimize(descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-9})
        return Tried(decay, found.x, -float(found.fun))
