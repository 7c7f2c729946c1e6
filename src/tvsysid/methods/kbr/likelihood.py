"""Marginal likelihood of a kernel's settings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel, log_harmonic_variances
from tvsysid.methods.kbr.record import Record
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Statistics, log_evidence, of_columns, of_share, unit_information, without_nuisance

LENGTHS = np.geomspace(0.002, 30.0, 12)  # periodic lengths of which a tuned one is the best
NOISES = 20  # steps of the noise variance at most, for settings that are given
FAR = 12.0  # from the log noise variance at the start: so much less is no noise, but data too few to show any
FAINT = 1e-7  # share of the noise below which a feature's part of the torque does not count in the likelihood


class Tried(NamedTuple):
    """Settings that were tried, and their log marginal likelihood.

    ``theta`` holds the logs of l1, three prior variances and the noise variance; one beyond the ``order`` says nothing.
    ``line`` is what they differ in from those given.
    """

    order: int
    lag: float
    decay: float
    theta: Array
    value: float
    line: str

    @property
    def variances(self) -> Array:
        """Prior variances of the coefficients that the model has."""
        return np.asarray(np.exp(self.theta[1 : 2 + self.order]))

    def settings(self, scale: float) -> dict[str, Any]:
        """As arguments of the method, to four digits; gammas count in squares of the scale."""
        length, decay, lag, *gammas = (
            float(f"{number:.4g}")
            for number in (math.exp(self.theta[0]), self.decay, self.lag, *(np.exp(self.theta[1:4]) / scale**2))
        )
        of_kernel = {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}
        return of_kernel | {"order": self.order, "lag": lag}


@dataclass(frozen=True, eq=False)
class Likelihood:
    r"""Log marginal likelihood as a function of the logs of l1, three prior variances and the noise variance.

    For one order, lag and decay (in s), and so that others can be compared with them:

    .. math:: \log p + \log \pi(\hat b) - \tfrac12 (M + 1 + L) \log N

    The first is the restricted likelihood of :func:`tvsysid.numerics.gaussian.log_evidence`; the second makes it that
    under a unit-information prior on the constants (:func:`tvsysid.numerics.gaussian.unit_information`); the third is
    the price of what is fitted by its maximum and is not common to all models: M + 1 gammas, and a lag (L = 1) unless
    it is 0. Within an order and lag the last two are constant.

    ``statistics`` are of N numbers, the external terms eliminated about the ``noise`` variance, of which also the prior
    of the constants is. ``coefficient`` and ``harmonic`` are those of each column; the ``fixed`` ones have no prior.
    """

    statistics: Statistics
    coefficient: NDArray[np.int64]
    harmonic: NDArray[np.int64]
    fixed: NDArray[np.bool_]
    noise: float
    lag: float
    decay: float

    @classmethod
    def of(
        cls,
        record: Record,
        kernel: Kernel,
        kept: NDArray[np.bool_],
        noise: float,
        lag: float = 0.0,
        decay: float = ENDLESS,
        share: float = 1.0,
    ) -> Likelihood:
        """With the external terms eliminated for about this noise variance; of a share of the numbers."""
        coefficient, column = np.nonzero(kept)
        harmonic = np.array(kernel.products)[column, 0]
        statistics = without_nuisance(record.statistics(kernel, kept), record.weak_prior, noise)
        return cls(of_share(statistics, share), coefficient, harmonic, column == 0, noise, lag, decay)

    def up_to(self, order: int) -> Likelihood:
        """Likelihood of the model without the higher derivatives."""
        mask = self.coefficient <= order
        return replace(
            self,
            statistics=of_columns(self.statistics, mask),
            coefficient=self.coefficient[mask],
            harmonic=self.harmonic[mask],
            fixed=self.fixed[mask],
        )

    @property
    def order(self) -> int:
        """Highest derivative of the angle."""
        return int(self.coefficient.max())

    @cached_property
    def _statistics_of(self) -> Callable[[bytes], Statistics]:
        """Statistics of some columns; the last are kept: they seldom change from one step of a search to the next."""
        statistics = self.statistics
        return lru_cache(maxsize=1)(lambda seen: of_columns(statistics, np.frombuffer(seen, dtype=bool)))

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Restricted log likelihood, and its derivatives."""
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), int(self.harmonic.max()))
        variances = np.where(self.fixed, 0.0, theta[1 + self.coefficient] + logs[self.harmonic])
        with np.errstate(divide="ignore"):
            strength = variances + np.log(np.diag(self.statistics.gram)) - theta[4]
        seen = self.fixed | (strength > math.log(FAINT))
        precision = np.where(self.fixed, 0.0, np.exp(-np.where(seen, variances, 0.0)))[seen]
        found = log_evidence(self._statistics_of(seen.tobytes()), precision, 1.0, math.exp(theta[4]))
        by_gamma = np.bincount(self.coefficient[seen], found.by_variances, minlength=3)
        by_length = float(found.by_variances @ slopes[self.harmonic[seen]])
        return found.value, np.array([by_length, *by_gamma, found.by_noise])

    def best_noise(self, theta: Array) -> tuple[float, float]:
        """Log of the noise variance that suits the other settings best, and the restricted log likelihood."""
        place = theta.copy()
        for _ in range(NOISES):
            value, slope = self(place)
            # The likelihood of a log variance curves like that of so many numbers.
            step = slope[4] / (0.5 * self.statistics.number)
            if abs(step) < 1e-4:
                break
            place[4] = np.clip(place[4] + step, theta[4] - FAR, theta[4] + FAR)
        return float(place[4]), value

    def climb(self, theta: Array, line: str, length: float | None = None, leeway: float = math.inf) -> Tried:
        """Highest likelihood near a start; at one l1, if that is given, and with gammas no larger than by a leeway."""
        lengths = np.log([LENGTHS[0], LENGTHS[-1]] if length is None else [length, length])
        start = np.concatenate([[np.clip(theta[0], *lengths)], theta[1:]])
        bounds = [tuple(lengths), *((gamma - 50, gamma + min(leeway, 15)) for gamma in theta[1:4])]
        bounds.append((theta[4] - FAR, theta[4] + FAR))

        # That of about white noise, so that where the search stops does not depend on the unit of the torque.
        usual = -0.5 * self.statistics.number * math.log(self.noise)

        def descent(place: Array) -> tuple[float, Array]:
            value, slope = self(place)
            return usual - value, -slope

        found = scipy.optimize.minimize(
            descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-9}
        )
        if found.x[4] <= theta[4] - FAR:
            raise InputError(
                "the settings of kbr cannot be found from the data: so few realizations are explained without any "
                "noise; give more realizations, or the settings"
            )
        return self.tried(found.x, usual - float(found.fun), line)

    def tried(self, theta: Array, value: float, line: str) -> Tried:
        """Settings with their restricted likelihood, made comparable with other orders' and lags'."""
        price = 0.5 * (self.order + 1 + (self.lag > 0)) * math.log(self.statistics.number)
        comparable = unit_information(of_columns(self.statistics, self.fixed), self.noise) - price
        return Tried(self.order, self.lag, self.decay, theta, value + comparable, line)
