"""Choose how fast stiffness, viscosity and inertia may change, by maximum marginal likelihood.

The kernel's l1 and l2 say how smooth and how periodic they are, gamma how far each may be from its
mean. :class:`Likelihood` gives the marginal likelihood of these settings and its derivatives, and
climbs to its maximum. :class:`Search` finds l1 and the gammas without decay, and then compares
shorter and shorter decays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel, log_harmonic_variances
from tvsysid.methods.kbr.record import Mask, Record, kernel_over
from tvsysid.methods.tuning import Evidence
from tvsysid.numerics.gaussian import Moments, solve
from tvsysid.signals import Array, Ensemble

LENGTHS = np.geomspace(0.002, 30.0, 12)  # candidates of l1, from which the search climbs
DECAYS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # candidates of l2, in lengths of the record
START = 1e3  # initial power of the torque that each coefficient makes, in noise variances
# largest rise of log prior variances, without decay and from one decay to the next
MAX_RISE, MAX_RISE_BY_DECAY = 15.0, math.log(100.0)
# coefficients above which a decay is not tried, and the given settings are not compared
MAX_COEFFICIENTS = 2000
# decrease of the log noise variance from the start at which the data are too few to show any noise
MAX_FALL = 12.0
# share of the noise below which a feature's part of the torque does not count in the likelihood
MIN_STRENGTH = 1e-7
# decrease of the log marginal likelihood from which on shorter decays are not tried
MAX_LOSS = 5.0
_value = attrgetter("value")


@attrs.frozen(eq=False)
class Candidate:
    """Settings, and their log marginal likelihood ``value``.

    ``theta`` holds the logs of l1, three prior variances and the complex noise's. ``line``
    describes the difference from the given settings.
    """

    decay: float
    theta: Array
    line: str
    value: float = math.nan

    def settings(self, scale: float) -> dict[str, Any]:
        """Return the settings as arguments of the method, rounded to four digits.

        Gammas are in units of the squared scale.
        """
        length, *gammas = np.exp(self.theta[:4]) / [1.0, *[scale**2] * 3]
        decay, length, *gammas = (float(f"{each:.4g}") for each in (self.decay, length, *gammas))
        return {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}


@attrs.frozen(eq=False)
class Likelihood:
    r"""Log marginal likelihood by the logs of l1, three prior variances and the noise variance.

    The constants have no prior, and are integrated out with unit density (restricted likelihood).
    The ``moments`` count the effective number of samples, and the external terms are integrated
    out. ``signal`` and ``harmonic`` are those of each column. ``flat`` columns are the constants.
    """

    moments: Moments
    signal: NDArray[np.int64]
    harmonic: NDArray[np.int64]
    flat: Mask

    @classmethod
    def of(cls, record: Record, visible: Mask, noise: float, share: float = 1.0) -> Likelihood:
        """Return the likelihood of the ``visible`` features for about this ``noise`` variance.

        ``share`` is the effective fraction of independent samples.
        """
        signal, column = np.nonzero(visible)
        moments = record.sums(visible).marginal(0.5 * noise).times(share)
        return cls(moments, signal, record.kernel.harmonic[column], column == 0)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the restricted log likelihood and its derivatives."""
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), int(self.harmonic.max()))
        variances = np.where(self.flat, 0.0, theta[1 + self.signal] + logs[self.harmonic])
        with np.errstate(divide="ignore"):
            strength = variances + np.log(np.diag(self.moments.gram)) - theta[4]
        counts = self.flat | (strength > math.log(MIN_STRENGTH))
        precision = np.where(self.flat[counts], 0.0, np.exp(-variances[counts]))
        found = solve(self.moments.take(counts), 2 * precision, 0.5 * math.exp(theta[4]))
        by_variances = found.by_variances
        by_gamma = np.bincount(self.signal[counts], by_variances, minlength=3)
        by_length = float(by_variances @ slopes[self.harmonic[counts]])
        return found.log_evidence, np.array([by_length, *by_gamma, found.by_noise])

    def climb(self, start: Candidate, lengths: tuple[float, float], rise: float) -> Candidate:
        """Climb to the highest likelihood near a start, with l1 between two ``lengths``.

        ``rise`` is the largest rise of log prior variances; 0 keeps them constant.
        """
        low, high = start.theta - MAX_FALL, start.theta + MAX_FALL
        low[1:4], high[1:4] = start.theta[1:4] - (50.0 if rise else 0.0), start.theta[1:4] + rise
        low[0], high[0] = np.log(lengths)
        # Subtracting a likelihood keeps the stopping rule independent of the torque's unit.
        usual = -0.5 * self.moments.number * start.theta[4]

        def descent(theta: Array) -> tuple[float, Array]:
            value, slope = self(theta)
            return usual - value, -slope

        found = scipy.optimize.minimize(
            descent,
            np.clip(start.theta, low, high),
            jac=True,
            method="L-BFGS-B",
            bounds=scipy.optimize.Bounds(low, high),
            options={"ftol": 1e-9},
        )
        if found.x[4] <= low[4]:
            raise InputError(
                "the settings of kbr cannot be found from the data: so few realizations are "
                "explained without any noise; give more realizations, or the settings"
            )
        return attrs.evolve(start, theta=found.x, value=usual - float(found.fun))


@attrs.frozen(eq=False)
class Search:
    """Data and noise level by which settings are compared.

    ``noise`` is about the residual variance of the given settings. ``share`` is the effective
    fraction of independent samples.
    """

    ensemble: Ensemble
    band: tuple[float, float]
    noise: float
    share: float

    def candidates(self, given: Candidate) -> list[Candidate]:
        """Return all settings that were tried: those given, each l1 without decay, and decays."""
        # Lengths differ only in the variances of the harmonics: they share one Gram matrix.
        kernel = kernel_over(self.ensemble, LENGTHS[0], ENDLESS)
        record = Record.of([self.ensemble], kernel, self.band)
        every = np.ones((3, kernel.columns), dtype=bool)
        strict = Likelihood.of(record, every, self.noise, self.share)
        # Each coefficient makes a torque 1000 times the noise.
        loose = np.log([1.0, *(START * self.noise / record.powers[:3]), self.noise])
        start = Candidate(ENDLESS, loose, "no decay")
        found = [strict.climb(start, (length, length), MAX_RISE) for length in LENGTHS]
        found.append(strict.climb(max(found, key=_value), (LENGTHS[0], LENGTHS[-1]), MAX_RISE))
        kept = math.exp(given.theta[0])
        as_given = self._climb(given, (kept, kept), 0.0) or given
        return [as_given, *found, *self._decays(max(found, key=_value), kernel)]

    def _decays(self, best: Candidate, kernel: Kernel) -> Iterator[Candidate]:
        """Yield the best settings for shorter and shorter decays, while the likelihood may rise."""
        for decay in np.array(DECAYS) * kernel.span:
            trial = attrs.evolve(best, decay=float(decay), line=f"decay {decay:.3g} s")
            found = self._climb(trial, (LENGTHS[0], LENGTHS[-1]), MAX_RISE_BY_DECAY)
            if found is None:
                return
            yield found
            if decay < 4 * kernel.period or found.value < best.value - MAX_LOSS:
                return
            best = max(best, found, key=_value)

    def _climb(
        self, start: Candidate, lengths: tuple[float, float], rise: float
    ) -> Candidate | None:
        """Return the best settings near a start with its decay; None if they are too many."""
        try:
            kernel = kernel_over(self.ensemble, math.exp(start.theta[0]), start.decay)
            record = Record.of([self.ensemble], kernel, self.band)
            visible = record.visible(np.exp(start.theta[1:4] + rise), self.noise)
            if visible.sum() > MAX_COEFFICIENTS:
                return None
            likelihood = Likelihood.of(record, visible, self.noise, self.share)
            return likelihood.climb(start, lengths, rise)
        except InputError:
            return None


def evidence_of(tried: Sequence[Candidate], method: object, scale: float) -> Evidence:
    """Return the evidence for settings that were tried; the first are those of the ``method``.

    ``scale`` is the unit of gamma.
    """
    settings = [each.settings(scale) for each in tried]
    values = np.array([each.value for each in tried])
    chosen = int(np.nanargmax(values))
    settings[0] = {name: getattr(method, name) for name in settings[0]}
    return Evidence(
        criterion="log marginal likelihood",
        tried=tuple(settings),
        values=values,
        chosen=chosen,
        axis="length_periodic (no unit)",
        positions=np.exp([each.theta[0] for each in tried]),
        lines=tuple(each.line for each in tried),
    )
