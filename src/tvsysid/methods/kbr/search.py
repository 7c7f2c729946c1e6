"""Choose how fast stiffness, viscosity and inertia may change, by maximum marginal likelihood.

The kernel's l1 and l2 say how smooth and how periodic they are, gamma how far each may be from its
mean. :class:`Likelihood` gives the marginal likelihood of these settings and its derivatives, and
climbs to its maximum. :class:`Search` finds l1 and the gammas without decay, compares other orders
and lags, and then shorter and shorter decays.
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
from tvsysid.methods.kbr.record import Mask, Record, lagged
from tvsysid.methods.tuning.evidence import Evidence, edge_of
from tvsysid.numerics.gaussian import Moments, solve
from tvsysid.signals import Array, Ensemble

LENGTHS = np.geomspace(0.002, 30.0, 12)  # periodic lengths of which a tuned one is the best
DECAYS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # decays that are tried, in lengths of the record
# lags in s that are tried, until the likelihood falls
LAGS = (0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.05)
MAX_REFINEMENTS = 6  # further lags about the best of them
START = 1e3  # initial power of the torque that each coefficient makes, in noise variances
LEEWAY = 100.0  # factor by which a decay may enlarge a prior variance
# coefficients above which a decay is not tried, and the given settings are not compared
MAX_COEFFICIENTS = 2000
MAX_STEPS = 20  # of the noise variance, for settings that are given
# decrease of the log noise variance from the start at which the data are too few to show any noise
MAX_FALL = 12.0
# share of the noise below which a feature's part of the torque does not count in the likelihood
FAINT = 1e-7
# If the log marginal likelihood of a decay is lower by this, shorter ones are not tried. An order
# or a lag must be better than the one given by this.
CLEARLY = 5.0
_value = attrgetter("value")


@attrs.frozen(eq=False)
class Candidate:
    """Settings, and their log marginal likelihood ``value``.

    ``theta`` holds the logs of l1, three prior variances and the complex noise's. Prior variances
    beyond the ``order`` have no effect. ``line`` describes the difference from the given settings.
    """

    order: int
    lag: float
    decay: float
    theta: Array
    line: str
    value: float = math.nan

    def settings(self, scale: float) -> dict[str, Any]:
        """Return the settings as arguments of the method, rounded to four digits.

        Gammas are in units of the squared scale.
        """
        numbers = [self.decay, self.lag, *(np.exp(self.theta[:4]) / [1.0, *[scale**2] * 3])]
        decay, lag, length, *gammas = (float(f"{number:.4g}") for number in numbers)
        of_kernel = {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}
        return of_kernel | {"order": self.order, "lag": lag}


@attrs.frozen(eq=False)
class Likelihood:
    r"""Log marginal likelihood by the logs of l1, three prior variances and the noise variance.

    It is made comparable across orders and lags:

    .. math:: \log p + \log \pi(\hat b) - \tfrac12 (M + 1 + L) \log N

    The first is the restricted likelihood; the second makes it that under a unit-information prior
    on the constants (:func:`unit_information`); the third is a penalty for the settings that are
    fitted by maximum and not common to all models: M + 1 gammas, and a lag (L = 1) unless it is 0.
    Within an order and lag, the last two terms are constant.

    The ``moments`` are those of N samples, with the external terms integrated out for about the
    ``noise`` variance, which also scales the prior of the constants. ``coefficient`` and
    ``harmonic`` are those of each column. The ``flat`` columns have no prior.
    """

    moments: Moments
    coefficient: NDArray[np.int64]
    harmonic: NDArray[np.int64]
    flat: Mask
    noise: float

    @classmethod
    def of(
        cls, record: Record, kernel: Kernel, visible: Mask, noise: float, share: float = 1.0
    ) -> Likelihood:
        """Return the likelihood of the ``visible`` features for about this ``noise`` variance.

        ``share`` is the effective fraction of independent samples.
        """
        coefficient, column = np.nonzero(visible)
        moments = record.sums(kernel, visible).marginal(0.5 * noise).times(share)
        return cls(moments, coefficient, kernel.harmonic[column], column == 0, noise)

    def up_to(self, order: int) -> Likelihood:
        """Return the likelihood of the model without the higher derivatives."""
        mask = self.coefficient <= order
        columns = self.coefficient[mask], self.harmonic[mask], self.flat[mask]
        return Likelihood(self.moments.take(mask), *columns, self.noise)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the restricted log likelihood and its derivatives."""
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), int(self.harmonic.max()))
        variances = np.where(self.flat, 0.0, theta[1 + self.coefficient] + logs[self.harmonic])
        with np.errstate(divide="ignore"):
            strength = variances + np.log(np.diag(self.moments.gram)) - theta[4]
        counts = self.flat | (strength > math.log(FAINT))
        precision = np.where(self.flat, 0.0, np.exp(-np.where(counts, variances, 0.0)))[counts]
        found = solve(self.moments.take(counts), 2 * precision, 0.5 * math.exp(theta[4]))
        by_variances = found.by_variances
        by_gamma = np.bincount(self.coefficient[counts], by_variances, minlength=3)
        by_length = float(by_variances @ slopes[self.harmonic[counts]])
        return found.log_evidence, np.array([by_length, *by_gamma, found.by_noise])

    def at(self, settings: Candidate) -> Candidate:
        """Return settings with the noise variance that suits them best."""
        start, theta = settings.theta[4], settings.theta.copy()
        for _ in range(MAX_STEPS):
            value, slope = self(theta)
            # The curvature of the likelihood in a log variance is half the number of samples.
            step = slope[4] / (0.5 * self.moments.number)
            if abs(step) < 1e-4:
                break
            theta[4] = np.clip(theta[4] + step, start - MAX_FALL, start + MAX_FALL)
        return self.compared(settings, theta, value)

    def climb(
        self, start: Candidate, length: float | None = None, leeway: float = 15.0
    ) -> Candidate:
        """Climb to the highest likelihood near a start.

        l1 stays at ``length`` if that is given. Log gammas rise by ``leeway`` at most.
        """
        low, high = start.theta + np.outer([-1, 1], [0.0, 50.0, 50.0, 50.0, MAX_FALL])
        high[1:4] = start.theta[1:4] + leeway
        low[0], high[0] = np.log([LENGTHS[0], LENGTHS[-1]] if length is None else [length, length])
        # Likelihood of white noise: subtracting it keeps the stopping rule independent of the
        # torque's unit.
        usual = -0.5 * self.moments.number * math.log(self.noise)

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
        return self.compared(start, found.x, usual - float(found.fun))

    def compared(self, settings: Candidate, theta: Array, value: float) -> Candidate:
        """Return settings at ``theta``, their likelihood comparable across orders and lags."""
        fitted = settings.order + 1 + (settings.lag > 0)
        value += unit_information(self.moments.take(self.flat), self.noise)
        value -= 0.5 * fitted * math.log(self.moments.number)
        return attrs.evolve(settings, theta=theta, value=value)


def unit_information(moments: Moments, noise: float) -> float:
    r"""Return the log density of a unit-information prior of columns F at the estimate b.

    A restricted likelihood, in which the weights of F have unit density, is measured in their
    units, and cannot be compared with one of other columns. Under a prior that tells as much of b
    as one of the N numbers does under white noise of the variance :math:`\sigma_0^2`, one for all
    models that are compared, it can:

    .. math:: b \sim N\left(\hat b,\ N J^{-1}\right), \qquad J = \frac{2}{\sigma_0^2} F^T F, \qquad
              \log\pi(\hat b) = \tfrac12 \log|F^T F| - \tfrac f2 \log(\pi N \sigma_0^2)

    It is nearly flat where the likelihood is not small. What it costs to fit a constant is half
    log N, as in Schwarz's criterion (Kass & Wasserman 1995).
    """
    log_determinant = solve(moments, np.zeros_like(moments.cross)).log_determinant
    count, number = len(moments.cross), moments.number
    return 0.5 * (log_determinant - count * math.log(math.pi * number * noise))


@attrs.frozen(eq=False)
class Search:
    """Data and noise level by which settings are compared.

    ``noise`` is about the residual variance of the given settings. ``share`` is the effective
    fraction of independent samples.
    """

    ensemble: Ensemble
    period: float
    band: tuple[float, float]
    noise: float
    share: float

    def candidates(self, given: Candidate) -> tuple[list[Candidate], int]:
        """Return all settings that were tried, those given first, and the position of the best.

        With the order and the lag given, l1 is searched without decay. Then other orders are tried,
        and other lags for each order; at last, shorter and shorter decays.
        """
        record = Record.of(lagged(self.ensemble, given.lag), self.band)
        # Lengths differ only in the variances of the harmonics: they share one Gram matrix.
        kernel = record.kernel(self.period, LENGTHS[0])
        every = np.ones((3, kernel.columns), dtype=bool)
        whole = Likelihood.of(record, kernel, every, self.noise, self.share)
        # Each coefficient makes a torque 1000 times the noise.
        noise = math.log(self.noise)
        theta = np.array([0.0, *(math.log(START) + noise - np.log(record.powers[:3])), noise])
        loose = attrs.evolve(given, decay=ENDLESS, theta=theta, line="no decay")

        try:
            as_given = self._likelihood(given).at(given)
        except InputError:  # too many coefficients
            as_given = given
        tried = [as_given, *_lengths(whole.up_to(given.order), loose)]
        endless = max(tried[1:], key=_value)
        other = list(_orders(whole, endless, loose))
        for each in (endless, *other):
            other += self._lags(each, max(endless, *other, key=_value))
        best = self._clearly_better(endless, other)
        decays = list(self._decays(best, record.stop - record.start))
        tried += [*other, *decays]
        compared = [as_given, best, *decays]
        chosen = compared[int(np.nanargmax([each.value for each in compared]))]
        return tried, tried.index(chosen)

    def _clearly_better(self, endless: Candidate, other: list[Candidate]) -> Candidate:
        """Return the best other order and lag if clearly better, or else the one given.

        Noise that is not white is slow, and so is quiet where inertia shows. A share of the samples
        then says too little about an order or a lag. Another order or lag must therefore also be
        better by all the samples.
        """
        whole = attrs.evolve(self, share=1.0)
        best_of_kind = {(each.order, each.lag > 0): each for each in sorted(other, key=_value)}
        for each in sorted(best_of_kind.values(), key=_value, reverse=True):
            if each.value <= endless.value + CLEARLY:
                break
            if whole._at(each, each.lag).value > whole._at(endless, endless.lag).value:
                return each
        return endless

    def _likelihood(self, about: Candidate, leeway: float = 1.0, least: float = 0.0) -> Likelihood:
        """Return the likelihood of the features that may exceed the noise.

        A feature's prior variance may be larger by ``leeway``; its power is ``least`` or more.
        """
        record = Record.of(lagged(self.ensemble, about.lag), self.band)
        kernel = record.kernel(self.period, math.exp(about.theta[0]), about.decay)
        powers = leeway * np.exp(about.theta[1:4]) * record.powers[:3]
        visible = kernel.visible(np.maximum(powers, least)[: about.order + 1], self.noise)
        if visible.sum() > MAX_COEFFICIENTS:
            raise InputError(
                f"KernelRegression: more than {MAX_COEFFICIENTS} coefficients are too many to "
                "compare"
            )
        return Likelihood.of(record, kernel, visible, self.noise, self.share)

    def _decays(self, best: Candidate, length: float) -> Iterator[Candidate]:
        """Yield the best settings for shorter and shorter decays, while the likelihood may rise."""
        for decay in np.array(DECAYS) * length:
            trial = attrs.evolve(best, decay=float(decay), line=f"decay {decay:.3g} s")
            try:
                found = self._likelihood(trial, LEEWAY).climb(trial, leeway=math.log(LEEWAY))
            except InputError:  # too many coefficients
                return
            yield found
            if decay < 4 * self.period or found.value < best.value - CLEARLY:
                return
            best = max(best, found, key=_value)

    def _at(self, best: Candidate, lag: float, climb: bool = False) -> Candidate:
        """Return the best settings with another lag, and with the noise that suits them.

        The decay is none. With ``climb``, all settings are those that suit the lag.
        """
        line = f"lag {1e3 * lag:.3g} ms" if lag else "no lag"
        trial = attrs.evolve(best, lag=lag, line=line if climb else "other lags")
        likelihood = self._likelihood(trial, LEEWAY, START * self.noise)
        return likelihood.climb(trial) if climb else likelihood.at(trial)

    def _lags(self, best: Candidate, rival: Candidate) -> Iterator[Candidate]:
        """Yield settings with other lags, each twice the one before, then the best of them.

        The likelihood has one peak. If the shortest lag is worse than none, longer ones are worse,
        too. Next to the peak, one of these lags has gained at least eight ninths of the highest
        possible gain. So the peak is searched for only where it may reach a rival.
        """
        tried = [self._at(best, 0.0) if best.lag else best]
        for lag in LAGS:
            tried.append(self._at(best, lag))
            if tried[-1].value < tried[-2].value:
                break
        top = max(tried, key=_value)
        if top.value + (top.value - best.value) / 8 > rival.value:
            if top.lag:

                def loss(lag: float) -> float:
                    tried.append(self._at(best, lag))
                    return -tried[-1].value

                bounds, options = (top.lag / 2, 2 * top.lag), {"maxiter": MAX_REFINEMENTS}
                scipy.optimize.minimize_scalar(
                    loss, bounds=bounds, method="bounded", options=options
                )
                top = max(tried, key=_value)
            tried.append(self._at(top, top.lag, climb=True))
        yield from tried if best.lag else tried[1:]


def _lengths(strict: Likelihood, loose: Candidate) -> list[Candidate]:
    """Return the best settings for each l1 without decay, then the best with l1 free."""
    starts, found = [loose], []
    for length in LENGTHS:
        climbed = (strict.climb(start, length) for start in starts)
        found.append(max(climbed, key=_value))
        starts = [loose, found[-1]]
    return [*found, strict.climb(max(found, key=_value))]


def _orders(whole: Likelihood, best: Candidate, loose: Candidate) -> Iterator[Candidate]:
    """Yield the best settings for each other order; what is added begins ``loose``."""
    theta, added = best.theta.copy(), slice(2 + best.order, 4)
    theta[added] = loose.theta[added]
    for order in {0, 1, 2} - {best.order}:
        own = whole.up_to(order)
        start = attrs.evolve(best, order=order, theta=theta, line=f"order {order}")
        yield own.climb(own.at(start))


def evidence_of(tried: Sequence[Candidate], chosen: int, method: object, scale: float) -> Evidence:
    """Return the evidence for settings that were tried; the first are those of the ``method``.

    ``scale`` is the unit of gamma.
    """
    settings = [each.settings(scale) for each in tried]
    best, edges = settings[chosen], []
    if chosen:
        edges.append(("length_periodic", [float(f"{each:.4g}") for each in LENGTHS]))
        if best["length_decay"] < ENDLESS:  # no decay is no edge, nor is no lag
            edges.append(("length_decay", [each["length_decay"] for each in settings]))
        if best["lag"] >= LAGS[-1]:
            edges.append(("lag", [*LAGS]))
    settings[0] = {name: getattr(method, name) for name in settings[0]}
    return Evidence(
        criterion="log marginal likelihood",
        unit="nat",
        better="higher",
        tried=tuple(settings),
        values=np.array([each.value for each in tried]),
        chosen=chosen,
        axis="length_periodic (no unit)",
        positions=np.exp([each.theta[0] for each in tried]),
        lines=tuple(each.line for each in tried),
        edges=tuple(text for name, grid in edges for text in edge_of(name, best[name], grid)),
    )
