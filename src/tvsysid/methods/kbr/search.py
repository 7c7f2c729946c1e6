"""Choose how fast stiffness, viscosity and inertia may change, for ``tuned``.

The kernel's l1 and l2 say how smooth and how periodic they are, gamma how far each may be from its
mean. :class:`Likelihood` gives the marginal likelihood of these settings and its derivatives, and
climbs to its maximum. :func:`tried_settings` finds l1 and the gammas without decay, and then
compares shorter and shorter decays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import Any, Self

import attrs
import numpy as np
import scipy

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel, log_harmonic_variances
from tvsysid.methods.kbr.record import moments_of, runs_of
from tvsysid.methods.tuning import Evidence
from tvsysid.numerics.gaussian import Moments, solve
from tvsysid.signals import Array, Ensemble

LENGTHS = np.geomspace(0.002, 30.0, 12)  # candidates of l1, from which the search climbs
WHOLE_RANGE = (LENGTHS[0], LENGTHS[-1])
DECAYS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # candidates of l2, in lengths of the record
INITIAL_SNR = 1e3  # power of the torque from each quantity, divided by the noise variance
MAX_DROP, MAX_RISE = 50.0, 15.0  # largest change of log gammas in a climb
# number of weights above which a decay is not tried, and the given settings are not compared
MAX_WEIGHTS = 2000
# A log noise variance that falls by this much from its start shows that the data are too few.
MAX_FALL = 12.0
# share of the noise below which a feature's part of the torque does not count in the likelihood
MIN_STRENGTH = 1e-7
# decrease of the log marginal likelihood from which on shorter decays are not tried
MAX_LOSS = 5.0
_value = attrgetter("value")


@attrs.frozen(eq=False)
class Settings:
    """Settings of the method, and their log marginal likelihood ``value``.

    ``theta`` holds the logs of l1, of three gammas in SI units and of the complex noise's variance.
    ``line`` is the name of their line in a figure.
    """

    decay: float
    theta: Array
    line: str
    value: float = math.nan

    def arguments(self, scale: float) -> dict[str, Any]:
        """Return the arguments of the method, rounded to four digits.

        Gammas are in units of the squared scale.
        """
        length, *gammas = np.exp(self.theta[:4]) / [1.0, *[scale**2] * 3]
        decay, length, *gammas = (float(f"{each:.4g}") for each in (self.decay, length, *gammas))
        return {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}


@attrs.frozen(eq=False)
class Likelihood:
    r"""Log marginal likelihood of ``theta``, see :class:`Settings`.

    The constants have no prior, and are integrated out with unit density (restricted likelihood).
    The ``moments`` of all ``kernel`` features are scaled to the effective number of samples.
    """

    moments: Moments
    kernel: Kernel

    @classmethod
    def of(
        cls, ensemble: Ensemble, kernel: Kernel, band: tuple[float, float], share: float
    ) -> Self:
        """Return the likelihood of the features of a kernel.

        ``share`` is the effective fraction of independent samples.
        """
        runs = runs_of([ensemble], kernel, band)
        return cls(moments_of(runs, kernel).times(share), kernel)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the restricted log likelihood and its derivatives."""
        signal = np.repeat(np.arange(3), self.kernel.column_count)
        harmonic = np.tile(self.kernel.harmonic, 3)
        flat = np.tile(self.kernel.precision == 0, 3)
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), self.kernel.highest)
        log_variances = np.where(flat, 0.0, theta[1 + signal] + logs[harmonic])
        with np.errstate(divide="ignore"):
            log_strength = log_variances + np.log(np.diag(self.moments.gram)) - theta[4]
        counts = flat | (log_strength > math.log(MIN_STRENGTH))
        precision = np.where(flat[counts], 0.0, np.exp(-log_variances[counts]))
        # The prior covariance is K / 2. A real or imaginary part has half the noise variance.
        found = solve(self.moments.take(counts), 2 * precision, 0.5 * math.exp(theta[4]))
        by_gamma = np.bincount(signal[counts], found.variance_gradient, minlength=3)
        by_length = float(found.variance_gradient @ slopes[harmonic[counts]])
        return found.log_evidence, np.array([by_length, *by_gamma, found.noise_gradient])

    def climb(self, start: Settings, lengths: tuple[float, float]) -> Settings:
        """Climb to the highest likelihood near a start, with l1 between two ``lengths``."""
        low, high = start.theta - MAX_FALL, start.theta + MAX_FALL
        low[1:4], high[1:4] = start.theta[1:4] - MAX_DROP, start.theta[1:4] + MAX_RISE
        low[0], high[0] = np.log(lengths)
        # Without this constant, the stopping rule would depend on the unit of torque.
        constant = -0.5 * self.moments.number * start.theta[4]

        def descent(theta: Array) -> tuple[float, Array]:
            value, slope = self(theta)
            return constant - value, -slope

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
                "the settings of kbr cannot be found from the data: with so few realizations, the "
                "model explains the torque without any noise; give more realizations, or the "
                "settings"
            )
        return attrs.evolve(start, theta=found.x, value=constant - float(found.fun))


def tried_settings(
    decay: float, given: Array, ensemble: Ensemble, band: tuple[float, float], share: float
) -> list[Settings]:
    """Return all settings that are tried: those given, each l1 without decay, and decays.

    ``given`` are l1, three gammas in SI units and the complex noise's variance, estimated without
    decay. The given settings count with this noise variance. All others have their own best
    one: some nats in their favour if the given ``decay`` is short. ``share`` is the effective
    fraction of independent samples.
    """

    def likelihood_of(settings: Settings) -> Likelihood | None:
        """Return the likelihood of the features for settings; None if they are too many."""
        kernel = Kernel.of(ensemble, math.exp(settings.theta[0]), settings.decay)
        if 3 * kernel.column_count > MAX_WEIGHTS:
            return None
        return Likelihood.of(ensemble, kernel, band, share)

    # Lengths differ only in the variances of the harmonics: they share one Gram matrix.
    kernel = Kernel.of(ensemble, LENGTHS[0], ENDLESS)
    periodic = Likelihood.of(ensemble, kernel, band, share)
    powers = periodic.moments.gram.diagonal()[:: kernel.column_count] / periodic.moments.number
    noise = given[4]
    start = Settings(ENDLESS, np.log([1.0, *(INITIAL_SNR * noise / powers), noise]), "no decay")
    tried = [periodic.climb(start, (length, length)) for length in LENGTHS]
    best = periodic.climb(max(tried, key=_value), WHOLE_RANGE)
    first = Settings(decay, np.log(given), "as given")
    if likelihood := likelihood_of(first):
        first = attrs.evolve(first, value=likelihood(first.theta)[0])
    tried = [first, *tried, best]
    # Shorter and shorter decays, until one is less than four periods or clearly less likely
    for length in np.multiply(DECAYS, kernel.span):
        start = attrs.evolve(best, decay=float(length), line=f"decay {length:.3g} s")
        likelihood = likelihood_of(start)
        if likelihood is None:
            break
        tried.append(likelihood.climb(start, WHOLE_RANGE))
        if length < 4 * kernel.period or tried[-1].value < best.value - MAX_LOSS:
            break
        best = max(best, tried[-1], key=_value)
    return tried


def evidence_of(tried: Sequence[Settings], method: object, scale: float) -> Evidence:
    """Return the evidence for settings that were tried; the first are those of the ``method``.

    ``scale`` is the unit of gamma.
    """
    settings = [each.arguments(scale) for each in tried]
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
