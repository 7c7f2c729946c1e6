"""Search for the most likely settings of kernel-based regression."""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import attrgetter
from typing import Any

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods.kbr.external import posterior_at
from tvsysid.methods.kbr.kernel import ENDLESS, VISIBLE, Kernel, log_harmonic_variances
from tvsysid.methods.kbr.record import Chosen, Record, lagged
from tvsysid.methods.tuning.evidence import Evidence, edge_of
from tvsysid.numerics.gaussian import Moments
from tvsysid.signals import Array, Ensemble

LENGTHS = np.geomspace(0.002, 30.0, 12)  # periodic lengths of which a tuned one is the best
DECAYS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # decays that are tried, in lengths of the record
LAGS = (
    0.001,
    0.002,
    0.004,
    0.008,
    0.016,
    0.032,
    0.05,
)  # lags in s that are tried, until the likelihood falls
REFINED = 6  # further lags about the best of them
# initial power of the torque that each coefficient makes, in noise variances
START = 1e3
LEEWAY = 100.0  # factor by which a decay may enlarge a prior variance
# coefficients above which a decay is not tried, and the given settings are not compared
MOST = 2000
NOISES = 20  # steps of the noise variance at most, for settings that are given
# decrease of the log noise variance from the start at which the data are too few to show any noise
FAR = 12.0
# share of the noise below which a feature's part of the torque does not count in the likelihood
FAINT = 1e-7
# If the log marginal likelihood of a decay is lower by this, shorter ones are not tried. An order
# or a lag must be better than the one given by this.
CLEARLY = 5.0
_value = attrgetter("value")


@attrs.frozen(eq=False)
class Tried:
    """Settings that were tried, and their log marginal likelihood.

    ``theta`` holds the logs of l1, three prior variances and the noise variance. Prior variances
    beyond the ``order`` have no effect. ``line`` describes the difference from the given settings.
    """

    order: int
    lag: float
    decay: float
    theta: Array
    value: float
    line: str

    @property
    def variances(self) -> Array:
        """Return the prior variances of the coefficients that the model has."""
        return np.asarray(np.exp(self.theta[1 : 2 + self.order]))

    def settings(self, scale: float) -> dict[str, Any]:
        """Return the settings as arguments of the method, rounded to four digits.

        Gammas are in units of the squared scale.
        """
        numbers = (
            math.exp(self.theta[0]),
            self.decay,
            self.lag,
            *(np.exp(self.theta[1:4]) / scale**2),
        )
        length, decay, lag, *gammas = (float(f"{number:.4g}") for number in numbers)
        of_kernel = {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}
        return of_kernel | {"order": self.order, "lag": lag}


@attrs.frozen(eq=False)
class Likelihood:
    r"""Log marginal likelihood by the logs of l1, three prior variances and the noise variance.

    For one order, lag and decay (in s), and so that others can be compared with them:

    .. math:: \log p + \log \pi(\hat b) - \tfrac12 (M + 1 + L) \log N

    The first is the restricted likelihood; the second makes it that under a unit-information prior
    on the constants (:func:`unit_information`); the third is a penalty for the settings
    that are fitted by maximum and not common to all models: M + 1 gammas, and a lag (L = 1) unless
    it is 0. Within an order and lag, the last two terms are constant.

    The ``moments`` are those of N samples. The external terms are integrated out for about the
    ``noise`` variance, which also scales the prior of the constants. ``coefficient`` and
    ``harmonic`` are those of each column. The ``fixed`` columns have no prior.
    """

    moments: Moments
    coefficient: NDArray[np.int64]
    harmonic: NDArray[np.int64]
    fixed: Chosen
    noise: float
    lag: float
    decay: float

    @classmethod
    def of(
        cls,
        record: Record,
        kernel: Kernel,
        kept: Chosen,
        noise: float,
        lag: float = 0.0,
        decay: float = ENDLESS,
        share: float = 1.0,
    ) -> Likelihood:
        """Return the likelihood without the external terms, for about this ``noise`` variance.

        ``share`` is the effective fraction of independent samples.
        """
        coefficient, column = np.nonzero(kept)
        moments = record.sums(kernel, kept).marginal(noise).times(share)
        return cls(
            moments,
            coefficient,
            kernel.harmonic[column],
            column == 0,
            noise,
            lag,
            decay,
        )

    def up_to(self, order: int) -> Likelihood:
        """Return the likelihood of the model without the higher derivatives."""
        mask = self.coefficient <= order
        columns = {name: getattr(self, name)[mask] for name in ("coefficient", "harmonic", "fixed")}
        return attrs.evolve(self, moments=self.moments.take(mask), **columns)

    @property
    def order(self) -> int:
        """Return the highest derivative of the angle."""
        return int(self.coefficient.max())

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the restricted log likelihood and its derivatives."""
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), int(self.harmonic.max()))
        variances = np.where(self.fixed, 0.0, theta[1 + self.coefficient] + logs[self.harmonic])
        with np.errstate(divide="ignore"):
            strength = variances + np.log(np.diag(self.moments.gram)) - theta[4]
        seen = self.fixed | (strength > math.log(FAINT))
        precision = np.where(self.fixed, 0.0, np.exp(-np.where(seen, variances, 0.0)))[seen]
        found = posterior_at(self.moments.take(seen), precision, math.exp(theta[4]))
        by_gamma = np.bincount(self.coefficient[seen], found.by_variances, minlength=3)
        by_length = float(found.by_variances @ slopes[self.harmonic[seen]])
        return found.log_evidence, np.array([by_length, *by_gamma, found.by_noise])

    def at(self, theta: Array, line: str) -> Tried:
        """Return these settings with the noise variance that suits them best."""
        place = theta.copy()
        for _ in range(NOISES):
            value, slope = self(place)
            # The curvature of the likelihood in a log variance is half the number of samples.
            step = slope[4] / (0.5 * self.moments.number)
            if abs(step) < 1e-4:
                break
            place[4] = np.clip(place[4] + step, theta[4] - FAR, theta[4] + FAR)
        return self.tried(place, value, line)

    def climb(
        self, theta: Array, line: str, length: float | None = None, leeway: float = 15.0
    ) -> Tried:
        """Climb to the highest likelihood near a start.

        l1 stays at ``length`` if that is given. Log gammas rise by ``leeway`` at most.
        """
        lengths = np.log([LENGTHS[0], LENGTHS[-1]] if length is None else [length, length])
        low, high = (
            theta - np.array([0.0, 50.0, 50.0, 50.0, FAR]),
            theta + np.array([0.0, *(leeway,) * 3, FAR]),
        )
        low[0], high[0] = lengths
        # Likelihood of white noise: subtracting it keeps the stopping rule independent of the
        # torque's unit.
        usual = -0.5 * self.moments.number * math.log(self.noise)

        def descent(place: Array) -> tuple[float, Array]:
            value, slope = self(place)
            return usual - value, -slope

        bounds, options = scipy.optimize.Bounds(low, high), {"ftol": 1e-9}
        start = np.clip(theta, low, high)
        found = scipy.optimize.minimize(
            descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options
        )
        if found.x[4] <= low[4]:
            raise InputError(
                "the settings of kbr cannot be found from the data: so few realizations are "
                "explained without any "
                "noise; give more realizations, or the settings"
            )
        return self.tried(found.x, usual - float(found.fun), line)

    def tried(self, theta: Array, value: float, line: str) -> Tried:
        """Return settings and their likelihood, made comparable across orders and lags."""
        price = 0.5 * (self.order + 1 + (self.lag > 0)) * math.log(self.moments.number)
        comparable = unit_information(self.moments.take(self.fixed), self.noise) - price
        return Tried(self.order, self.lag, self.decay, theta, value + comparable, line)


def unit_information(moments: Moments, noise: float) -> float:
    r"""Return the log density of a unit-information prior of columns F at its mean.

    The mean is the estimate from the data.

    A restricted likelihood, in which the weights of F have unit density, is measured in their
    units, and cannot be compared with one of other columns. Under a prior that tells as much of b
    as one of the N numbers does under white noise of the variance :math:`\sigma_0^2`, one for all
    models that are compared, it can:

    .. math:: b \sim N\left(\hat b,\ N J^{-1}\right), \qquad J = \frac{2}{\sigma_0^2} F^T F, \qquad
              \log\pi(\hat b) = \tfrac12 \log|F^T F| - \tfrac f2 \log(\pi N \sigma_0^2)

    As it is nearly flat where the likelihood is not small, the likelihood under it is the
    restricted one times this density, to about f / (2 N) where columns with a prior cannot take
    the place of F. What it costs to fit a constant is then half log N, as in Schwarz's criterion
    (Kass & Wasserman 1995).
    """
    gram = np.tril(moments.gram) + np.tril(moments.gram, -1).T
    power = math.log(math.pi * moments.number * noise)
    return 0.5 * (float(np.linalg.slogdet(gram)[1]) - len(gram) * power)


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

    def evidence(self, given: Tried, method: object, scale: float) -> Evidence:
        """Return the evidence for all settings that were tried, those given first.

        The ``given`` settings are those of the ``method``. ``scale`` is the unit of gamma.
        """
        tried, chosen = self.from_settings(given)
        settings = [each.settings(scale) for each in tried]
        edges: tuple[str, ...] = ()
        if chosen:  # no decay and no lag are no edges
            length, decay, lag = (
                settings[chosen][name] for name in ("length_periodic", "length_decay", "lag")
            )
            edges += edge_of("length_periodic", length, (float(f"{each:.4g}") for each in LENGTHS))
            if decay < ENDLESS:
                edges += edge_of("length_decay", decay, (each["length_decay"] for each in settings))
            if lag >= LAGS[-1]:
                edges += edge_of("lag", lag, LAGS)
        settings[0] = {name: getattr(method, name) for name in settings[0]}
        return Evidence(
            criterion="log marginal likelihood",
            unit="nat",
            better="higher",
            tried=tuple(settings),
            values=np.array([each.value for each in tried]),
            standard_errors=np.full(len(tried), math.nan),
            chosen=chosen,
            axis="length_periodic (no unit)",
            positions=np.exp([each.theta[0] for each in tried]),
            lines=tuple(each.line for each in tried),
            edges=edges,
        )

    def from_settings(self, given: Tried) -> tuple[list[Tried], int]:
        """Return all settings that were tried, those given first, and the position of the best.

        With the order and the lag given, l1 is searched without decay, then with shorter and
        shorter decays. Then, without decay, other orders are tried, and other lags for each order.
        """
        record = self._record(given.lag)
        # Lengths differ only in the variances of the harmonics: they share one Gram matrix.
        kernel = record.kernel(self.period, LENGTHS[0])
        every = np.ones((3, kernel.columns), dtype=bool)
        everything = Likelihood.of(record, kernel, every, self.noise, given.lag, share=self.share)
        strict = self._lengths(record, everything.up_to(given.order))
        endless = max(strict, key=_value)
        tried = [
            self._as_given(given),
            *strict,
            *self._decays(endless, float(record.stop - record.start)),
        ]
        chosen = tried[int(np.nanargmax([each.value for each in tried]))]

        other = list(self._orders(record, everything, endless))
        for each in (endless, *other):
            other += self._lags(each, max(endless, *other, key=_value))
        best = self._clearly_better(endless, other)
        if best is not endless:
            if chosen.decay < endless.decay:
                other += self._decayed(best, chosen.decay)
            top = max(
                (each for each in other if (each.order, each.lag) == (best.order, best.lag)),
                key=_value,
            )
            chosen = top if top.value > chosen.value + CLEARLY else chosen
        tried += other
        return tried, tried.index(chosen)

    def _clearly_better(self, endless: Tried, other: list[Tried]) -> Tried:
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

    def _record(self, lag: float) -> Record:
        return Record.of(lagged(self.ensemble, lag), self.band)

    def _likelihood(
        self, about: Tried, variances: Array, lag: float, decay: float = ENDLESS, least: float = 0.0
    ) -> Likelihood:
        """Return the likelihood of the features that may exceed the noise.

        The prior ``variances`` (coefficient,) say how strong a feature may be; its power is
        ``least`` or more.
        """
        record = self._record(lag)
        kernel = record.kernel(self.period, math.exp(about.theta[0]), decay)
        kept = kernel.visible(
            np.maximum(variances * record.powers[: len(variances)], least), VISIBLE * self.noise
        )
        if kept.sum() > MOST:
            raise InputError(
                f"KernelRegression: more than {MOST} coefficients are too many to compare"
            )
        return Likelihood.of(record, kernel, kept, self.noise, lag, decay, self.share)

    def _loose(self, record: Record) -> Array:
        """Return a start at which each coefficient makes a torque 1000 times the noise."""
        noise = math.log(self.noise)
        return np.array([0.0, *(math.log(START) + noise - np.log(record.powers)), noise])

    def _as_given(self, given: Tried) -> Tried:
        try:
            return self._likelihood(given, given.variances, given.lag, given.decay).at(
                given.theta, given.line
            )
        except InputError:  # too many coefficients
            return given

    def _lengths(self, record: Record, strict: Likelihood) -> list[Tried]:
        """Return the best settings for each l1, then the best with l1 free."""
        starts, found = [self._loose(record)], []
        for length in LENGTHS:
            found.append(
                max((strict.climb(theta, "no decay", length) for theta in starts), key=_value)
            )
            starts[1:] = [found[-1].theta]
        return [*found, strict.climb(max(found, key=_value).theta, "no decay")]

    def _decays(self, best: Tried, length: float) -> Iterator[Tried]:
        """Yield the best settings for shorter and shorter decays, while the likelihood may rise."""
        for share in DECAYS:
            found = self._decayed(best, share * length) if share * length >= 2 * self.period else []
            yield from found
            if not found or found[0].value < best.value - CLEARLY:
                break
            best = max(best, *found, key=_value)

    def _decayed(self, best: Tried, decay: float) -> list[Tried]:
        """Return the best settings for a decay; none if it needs too many coefficients."""
        try:
            likelihood = self._likelihood(best, LEEWAY * best.variances, best.lag, decay)
        except InputError:
            return []
        return [likelihood.climb(best.theta, f"decay {decay:.3g} s", leeway=math.log(LEEWAY))]

    def _orders(self, record: Record, likelihood: Likelihood, best: Tried) -> Iterator[Tried]:
        """Yield the best settings for each other order."""
        theta, absent = best.theta.copy(), slice(2 + best.order, 4)
        theta[absent] = self._loose(record)[absent]
        for order in range(3):
            if order != best.order:
                own, line = likelihood.up_to(order), f"order {order}"
                yield own.climb(own.at(theta, line).theta, line)

    def _about(self, best: Tried, lag: float) -> Likelihood:
        """Return the likelihood without decay for another lag, near the best settings."""
        return self._likelihood(best, LEEWAY * best.variances, lag, least=START * self.noise)

    def _at(self, best: Tried, lag: float) -> Tried:
        """Return the best settings with another lag, and with the noise that suits them."""
        return self._about(best, lag).at(best.theta, "other lags")

    def _lags(self, best: Tried, rival: Tried) -> Iterator[Tried]:
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
        yield from tried if best.lag else tried[1:]
        top = max(tried, key=_value)
        if top.value + (top.value - best.value) / 8 <= rival.value:
            return
        if top.lag:
            found: list[Tried] = []

            def loss(lag: float) -> float:
                found.append(self._at(best, lag))
                return -found[-1].value

            bounds, options = (top.lag / 2, 2 * top.lag), {"maxiter": REFINED}
            scipy.optimize.minimize_scalar(loss, bounds=bounds, method="bounded", options=options)
            yield from found
            top = max(top, *found, key=_value)
        yield self._about(best, top.lag).climb(
            top.theta, f"lag {1e3 * top.lag:.3g} ms" if top.lag else "no lag"
        )
