"""Search for the settings of kernel-based regression that are most likely."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
import scipy

from tvsysid.methods.kbr.kernel import ENDLESS, VISIBLE, Kernel
from tvsysid.methods.kbr.likelihood import LENGTHS, Likelihood, Tried
from tvsysid.methods.kbr.record import Record, lagged
from tvsysid.methods.tuning.evidence import Evidence, edge_of
from tvsysid.signals import Array, Ensemble

HIGHEST = 2  # order of an impedance: inertia, viscosity and stiffness
DECAYS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # decays that are tried, in lengths of the record
LAGS = (0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.05)  # lags in s that are tried, until the likelihood falls
REFINED = 6  # further lags about the best of them
START = 1e3  # power of the torque that each coefficient makes, in noise variances, from which tuning sets out
LEEWAY = 100.0  # factor by which a decay may enlarge a prior variance
MOST = 2000  # coefficients beyond which a decay is not tried, and settings that were given are not compared
# Log marginal likelihood by which a decay must be worse for shorter ones not to be tried, and by which an order or a
# lag must be better than the one given.
CLEARLY = 5.0
_value = attrgetter("value")


@dataclass(frozen=True, eq=False)
class Search:
    """What settings are compared on.

    ``noise`` is about the variance that the settings given leave; ``share`` says how many independent numbers one
    number of the record is worth; a gamma counts in squares of the ``scale``.
    """

    ensemble: Ensemble
    period: float
    band: tuple[float, float]
    noise: float
    share: float
    scale: float

    def evidence(self, given: Tried, method: object) -> Evidence:
        """Evidence for all settings that are tried, first those given, which are a method's."""
        tried, chosen = self.from_settings(given)
        return Evidence(
            criterion="log marginal likelihood",
            unit="nat",
            better="higher",
            tried=(
                {name: getattr(method, name) for name in given.settings(self.scale)},
                *(each.settings(self.scale) for each in tried[1:]),
            ),
            values=np.array([each.value for each in tried]),
            standard_errors=np.full(len(tried), math.nan),
            chosen=chosen,
            axis="length_periodic (no unit)",
            positions=np.exp([each.theta[0] for each in tried]),
            lines=tuple(each.line for each in tried),
            edges=self._edges(tried, chosen) if chosen else (),
        )

    def _edges(self, tried: list[Tried], chosen: int) -> tuple[str, ...]:
        """Which of the settings chosen are the last that were tried; none means no decay, and no lag."""
        settings = [each.settings(self.scale) for each in tried]
        length, decay, lag = (settings[chosen][name] for name in ("length_periodic", "length_decay", "lag"))
        edges = edge_of("length_periodic", length, (float(f"{each:.4g}") for each in LENGTHS))
        if decay < ENDLESS:
            edges += edge_of("length_decay", decay, (each["length_decay"] for each in settings))
        return edges + (edge_of("lag", lag, LAGS) if lag >= LAGS[-1] else ())

    def from_settings(self, given: Tried) -> tuple[list[Tried], int]:
        """All that was tried, those given first, and which is the best.

        With the order and the lag given: l1 without decay, then shorter and shorter decays. Then, without decay, other
        orders, and other lags for each order.
        """
        record = self._record(given.lag)
        # No harmonic is shared by two lengths, but its variance: all lengths have one Gram matrix.
        kernel = record.kernel(self.period, LENGTHS[0])
        every = np.ones((HIGHEST + 1, kernel.columns), dtype=bool)
        everything = Likelihood.of(record, kernel, every, self.noise, given.lag, share=self.share)
        tried = [self._as_given(record, given), *self._lengths(record, everything.up_to(given.order))]
        endless = max(tried[1:], key=_value)
        tried += self._decays(record, tried[1:])
        own = int(np.nanargmax([each.value for each in tried]))

        other = list(self._orders(record, everything, endless))
        for each in (endless, *other):
            other += self._lags(each, max(endless, *other, key=_value))
        best = self._clearly_better(endless, other)
        if best is not endless and tried[own].decay < endless.decay:
            decayed = self._one_decay(self._record(best.lag), best, tried[own].decay)
            other += [] if decayed is None else [decayed]
        alike = [place for place, each in enumerate(other) if (each.order, each.lag) == (best.order, best.lag)]
        found = max(alike, key=lambda place: other[place].value, default=-1)
        chosen = own
        if best is not endless and other[found].value > tried[own].value + CLEARLY:
            chosen = len(tried) + found
        return tried + other, chosen

    def _clearly_better(self, endless: Tried, other: list[Tried]) -> Tried:
        """Best of other orders and lags, if it is clearly better than the order and lag given, or else these.

        A share of the numbers says too little of an order or a lag: noise that is not white is slow, and so is quiet
        where inertia shows. So they must be better by all the numbers, too.
        """
        whole, alike = (
            replace(self, share=1.0),
            {(each.order, each.lag > 0): each for each in sorted(other, key=_value)},
        )
        for each in sorted(alike.values(), key=_value, reverse=True):
            if each.value <= endless.value + CLEARLY:
                break
            if whole._at(each, each.lag).value > whole._at(endless, endless.lag).value:
                return each
        return endless

    def _record(self, lag: float) -> Record:
        return Record.of(lagged(self.ensemble, lag), self.band, HIGHEST)

    def _likelihood(
        self, record: Record, kernel: Kernel, variances: Array, lag: float, decay: float
    ) -> Likelihood | None:
        """Of the features that may be seen with these prior variances; None if there are too many."""
        kept = kernel.visible(variances * record.powers, VISIBLE * self.noise)
        if int(kept.sum()) > MOST:
            return None
        return Likelihood.of(record, kernel, kept, self.noise, lag, decay, self.share)

    def _loose(self, record: Record) -> Array:
        """Of each coefficient so much that the torque it makes is a thousand times the noise."""
        noise = math.log(self.noise)
        return np.array([0.0, *(math.log(START) + noise - np.log(record.powers)), noise])

    def _as_given(self, record: Record, given: Tried) -> Tried:
        own = record.up_to(given.order)
        kernel = record.kernel(self.period, math.exp(given.theta[0]), given.decay)
        likelihood = self._likelihood(own, kernel, given.variances, given.lag, given.decay)
        if likelihood is None:
            return given
        theta = given.theta.copy()
        theta[4], value = likelihood.best_noise(theta)
        return likelihood.tried(theta, value, given.line)

    def _lengths(self, record: Record, strict: Likelihood) -> Iterator[Tried]:
        """Best settings for each l1, and those for any."""
        starts, found = [self._loose(record)], []
        for length in LENGTHS:
            found.append(max((strict.climb(theta, "no decay", length) for theta in starts), key=_value))
            starts[1:] = [found[-1].theta]
        yield from found
        yield strict.climb(max(found, key=_value).theta, "no decay")

    def _decays(self, record: Record, strict: list[Tried]) -> Iterator[Tried]:
        """Best settings for shorter and shorter decays, as long as there is something to gain."""
        best = max(strict, key=_value)
        for share in DECAYS:
            decay = float(share * (record.stop - record.start))
            found = self._one_decay(record, best, decay) if decay >= 2 * self.period else None
            if found is None:
                break
            yield found
            if found.value < best.value - CLEARLY:
                break
            best = max(best, found, key=_value)

    def _one_decay(self, record: Record, best: Tried, decay: float) -> Tried | None:
        """Best settings for a decay; none if that takes too many coefficients."""
        own = record.up_to(best.order)
        kernel = record.kernel(self.period, math.exp(best.theta[0]), decay)
        likelihood = self._likelihood(own, kernel, LEEWAY * best.variances, best.lag, decay)
        if likelihood is None:
            return None
        return likelihood.climb(best.theta, f"decay {decay:.3g} s", leeway=math.log(LEEWAY))

    def _orders(self, record: Record, likelihood: Likelihood, best: Tried) -> Iterator[Tried]:
        """Best settings for each other order."""
        loose = self._loose(record)
        for order in range(HIGHEST + 1):
            if order != best.order:
                own, theta = likelihood.up_to(order), best.theta.copy()
                theta[1 + best.order + 1 : 4] = loose[1 + best.order + 1 : 4]
                theta[4], _ = own.best_noise(theta)
                yield own.climb(theta, f"order {order}")

    def _about(self, best: Tried, lag: float) -> Likelihood:
        """Likelihood without decay, about the best settings, for another lag."""
        record = self._record(lag).up_to(best.order)
        kernel = record.kernel(self.period, math.exp(best.theta[0]))
        loose = np.exp(self._loose(record)[1:-1])
        kept = kernel.visible(np.maximum(LEEWAY * best.variances, loose) * record.powers, VISIBLE * self.noise)
        return Likelihood.of(record, kernel, kept, self.noise, lag, share=self.share)

    def _lags(self, best: Tried, rival: Tried) -> Iterator[Tried]:
        """Other lags, each twice the one before, with the best settings; and the best settings for the best of them.

        The likelihood has one peak: where the shortest lag is worse than none, longer ones are so too. Next to the
        peak, one of these lags has gained at least eight ninths of what the best of all gains; so the peak is
        looked for only where it may come up to a rival.
        """
        tried = [self._at(best, 0.0) if best.lag else best]
        yield from tried[: 1 if best.lag else 0]
        for lag in LAGS:
            tried.append(self._at(best, lag))
            yield tried[-1]
            if tried[-1].value < tried[-2].value:
                break
        top = max(tried, key=_value)
        if top.value + (top.value - best.value) / 8 <= rival.value:
            return
        if top.lag:
            found: dict[float, Tried] = {}

            def loss(lag: float) -> float:
                found[lag] = self._at(best, lag)
                return -found[lag].value

            scipy.optimize.minimize_scalar(
                loss, bounds=(top.lag / 2, 2 * top.lag), method="bounded", options={"maxiter": REFINED}
            )
            yield from found.values()
            top = max(top, *found.values(), key=_value)
        yield self._about(best, top.lag).climb(top.theta, f"lag {1e3 * top.lag:.3g} ms" if top.lag else "no lag")

    def _at(self, best: Tried, lag: float) -> Tried:
        """Best settings but for a lag, with the noise that suits them."""
        likelihood = self._about(best, lag)
        theta = best.theta.copy()
        theta[4], value = likelihood.best_noise(theta)
        return likelihood.tried(theta, value, "other lags")
