"""Compute what checks share: deviations from the mean over realizations, and a fit to them."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.interpolation import between
from tvsysid.quality.checks import Finding, NotApplicable, judge
from tvsysid.quality.fit import SecondOrderFit
from tvsysid.quality.resampling import known_region, lowered
from tvsysid.quality.statistics import innovations
from tvsysid.signals import Array, Ensemble

SIGNAL_PAST_S = 0.12  # from which signals are predicted
MIN_EXPLAINED = 0.1  # share of the torque without which the joint has no impedance to speak of
NO_RESPONSE = "the torque does not respond to the angle"
NOT_IDENTIFIABLE = "stiffness, viscosity and inertia are not separately identifiable"


@attrs.frozen(eq=False)
class FittedEnsemble:
    """Ensemble for checks: as it was given, and at some 100 Hz with a second-order fit."""

    given: Ensemble
    ensemble: Ensemble
    _findings: dict[str, Finding] = attrs.field(factory=dict, init=False)

    @classmethod
    def of(cls, ensemble: Ensemble) -> FittedEnsemble:
        """Lower the ensemble's rate to some 100 Hz."""
        return cls(ensemble, lowered(ensemble))

    def __len__(self) -> int:
        return len(self.ensemble)

    def finding(self, name: str, *further: object) -> Finding:
        """Check for a fault, once. ``further`` are further arguments of the check."""
        if name not in self._findings:
            self._findings[name] = judge(name, self, *further)
        return self._findings[name]

    def require(self, realizations: int = MIN_TESTED_REALIZATIONS, response: bool = True) -> None:
        """Raise NotApplicable for too few realizations, or a torque that ignores the angle."""
        if len(self) < realizations:
            raise NotApplicable(f"it takes {realizations} realizations")
        if response and self.fit.explained < MIN_EXPLAINED:
            raise NotApplicable(NO_RESPONSE)

    @property
    def rate(self) -> float:
        """Sampling rate in Hz."""
        return self.ensemble.sampling_rate

    def signal(self, which: str) -> Array:
        """Return the deviation of angle, torque or a channel from its mean over realizations.

        Its shape is (realization, time), context included.
        """
        values = self.ensemble.signal(which)
        return np.asarray(values - values.mean(axis=0))

    def core(self, which: str) -> Array:
        """Return the same deviation without context."""
        return self.signal(which)[:, self.ensemble.core]

    @cached_property
    def angle(self) -> Array:
        """Deviation of the angle in rad."""
        return self.signal("angle")

    @cached_property
    def torque(self) -> Array:
        """Deviation of the torque in N·m."""
        return self.signal("torque")

    @property
    def region(self) -> slice:
        """Samples that are fitted: those with known derivatives, context counted."""
        return known_region(self.ensemble.samples, self.ensemble.context)

    @cached_property
    def fit(self) -> SecondOrderFit:
        """Second-order fit with stiffness and viscosity in bins."""
        shown = slice(self.region.start - HALF_WIDTH, self.region.stop - HALF_WIDTH)
        motion = differentiate(self.angle, self.rate)[:, :, shown]
        return SecondOrderFit(motion, self.torque[:, self.region], self.rate)

    @property
    def time(self) -> Array:
        """Time of the fitted samples within a realization in s."""
        samples = np.arange(self.region.start, self.region.stop)
        return (samples - self.ensemble.context) / self.rate

    @property
    def white_region(self) -> slice:
        """Samples of the ensemble, context counted, that are left after whitening."""
        return slice(self.region.start + self.fit.whitening, self.region.stop)

    def unpredicted(self, signal: Array) -> Array:
        """Return what its past does not predict of a signal, at the whitened samples."""
        region = self.white_region
        order = min(max(2, round(SIGNAL_PAST_S * self.rate)), region.start)
        return innovations(signal, order)[:, region.start - order : region.stop - order]

    @property
    def order(self) -> NDArray[np.int64]:
        """Realizations in the order of recording."""
        return np.concatenate(self.ensemble.runs)

    @property
    def halves(self) -> list[NDArray[np.int64]]:
        """Realizations of the first and of the second half of the experiment."""
        return np.split(self.order, [len(self) // 2])

    def changed(self, **signals: Any) -> FittedEnsemble:
        """Return the ensemble with other signals."""
        return FittedEnsemble(self.given, attrs.evolve(self.ensemble, **signals))

    def advance(self, samples: float) -> FittedEnsemble:
        """Return the ensemble with its torque so many samples earlier."""
        return self.changed(torque=later(self.ensemble.torque, samples)) if samples else self


def later(values: Array, samples: float) -> Array:
    """Return the values of a signal (realization, time) so many samples later.

    The last one is repeated.
    """
    whole, last = round(samples), values.shape[1] - 1
    return between(values, samples - whole)[:, np.clip(np.arange(last + 1) + whole, 0, last)]
