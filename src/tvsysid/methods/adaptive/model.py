"""Model of adaptive regression: impedance over time with bands, and a table of its changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import attrs
import numpy as np
from scipy.special import ndtr

from tvsysid.dataset_layout import Labelled
from tvsysid.methods.adaptive.averaging import Hypothesis, Mixture, ModelAverage
from tvsysid.methods.adaptive.search import NEARBY_SAMPLES
from tvsysid.methods.cascade.cascade import JointCascadeModel
from tvsysid.models import Model, StandardError
from tvsysid.numerics import Array
from tvsysid.signals import Ensemble

MIN_SWITCH_PROBABILITY = 0.05  # of a switch that is listed
CERTAIN = 0.995  # probability of a switch from which on the probability is not mentioned
BISECTIONS = 26  # that find a quantile
MIN_MARGIN = 1e-3  # least half width of a band, as a share of the usual one


class Switch(NamedTuple):
    """A sudden change of a ``quantity``, at a ``time`` in s.

    The switch lies between ``earliest`` and ``latest`` with a probability of 95 %. Its ``size``, in
    the quantity's unit, has a standard error. ``probability`` is that of the switch itself.
    """

    quantity: str
    time: float
    earliest: float
    latest: float
    size: float
    size_error: float
    probability: float


@attrs.frozen(eq=False)
class MixtureError(StandardError):
    """Random error of an estimate that is a mixture of possible values.

    Near an undecided switch, the band spans both levels. The band is never negative if none of the
    means of the ``mixture`` is. All times have the same degrees of freedom.
    """

    mixture: Mixture = attrs.field(kw_only=True)

    def band_around(self, values: Array, level: float, simultaneous: bool) -> tuple[Array, Array]:
        """Return the limits of a band: quantiles of the mixture, with Student's t for each part."""
        multiple = float(self.multiple(level, simultaneous)[0])
        inside = MIN_MARGIN * multiple * self.values
        lower = np.minimum(self._quantile(-multiple), values - inside)
        if np.nanmin(self.mixture.means) >= 0:
            lower = np.maximum(lower, 0.0)
        return lower, np.maximum(self._quantile(multiple), values + inside)

    def _quantile(self, multiple: float) -> Array:
        """Return the quantile (time,) at the probability that Student's t is below ``multiple``."""
        weights, means, variances = self.mixture
        freedom = float(self.freedom[0])
        spreads = np.sqrt(variances)
        share = ndtr(_as_normal(multiple, freedom))
        parts = means + spreads * multiple
        low = parts.min(axis=1)
        high = parts.max(axis=1)
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            apart = (middle[:, None] - means) / spreads
            below = ndtr(_as_normal(apart, freedom)) @ weights
            low = np.where(below < share, middle, low)
            high = np.where(below < share, high, middle)
        return (low + high) / 2


def _as_normal(multiple: Array | float, freedom: float) -> Array:
    """Return the normal deviate with the probability of Student's t, to 0.2 % (Wallace 1959)."""
    root = np.sqrt(freedom * np.log1p(multiple**2 / freedom))
    return np.copysign(root * (8 * freedom + 1) / (8 * freedom + 3), multiple)


@attrs.frozen(eq=False, repr=False, kw_only=True)
class AdaptiveModel(Model):
    r"""Second-order impedance whose stiffness and viscosity change smoothly, suddenly, or not.

    .. math:: y(t) = k(t)\,\theta + b(t)\,\dot\theta + I\,\ddot\theta

    ``switches`` are those of a probability of 5 % and more. If a reflex is detected, ``reflex`` is
    the model with its pathway and the intrinsic response, which includes stiffness and viscosity.
    ``hypotheses`` are the models that were averaged, by quantity, the most probable first.
    """

    switches: tuple[Switch, ...]
    reflex: JointCascadeModel | None
    hypotheses: Mapping[str, Sequence[Hypothesis]]

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        if self.reflex is None:
            return super()._pathways(ensemble)
        found = self.reflex.pathways(ensemble)
        change = self.stiffness - self.reflex.stiffness
        found["intrinsic"] = found["intrinsic"] + change * ensemble.derivatives()[0]
        return found

    def _further_variables(self) -> tuple[Labelled, Labelled]:
        columns = zip(Switch._fields, zip(*self.switches, strict=True), strict=False)
        return {f"switch_{name}": (("switch",), list(column)) for name, column in columns}, {}


def switches_of(quantity: str, posterior: ModelAverage, missing: int, rate: float) -> list[Switch]:
    """Return the switches that are likely enough to be listed, in the order of time.

    The probability of a switch is that of all models with a switch nearby. The best of these models
    gives its time and size.
    """
    rows = list[Switch]()
    mixed = posterior.models[: len(posterior.weights)]
    estimate = mixed[0].smooth.estimate
    for rank, (model, curve) in enumerate(zip(mixed, posterior.curves, strict=True)):
        for index, position in enumerate(model.positions):
            distances = (estimate.axis.offset(each.positions, position) for each in mixed)
            has_one = np.array([(np.abs(each) < NEARBY_SAMPLES).any() for each in distances])
            probability = min(float(posterior.weights @ has_one), 1.0)  # rounding may exceed it
            is_listed = has_one[:rank].any()  # by a more probable model
            if is_listed or probability < MIN_SWITCH_PROBABILITY:
                continue
            window, probabilities = model.possible_positions[index]
            late = estimate.axis.offset(window, position)
            ends = np.quantile(late, [0.025, 0.975], weights=probabilities, method="inverted_cdf")
            time = (position + missing) / rate
            earliest, latest = time + np.clip(ends, [-np.inf, 0.0], [0.0, np.inf]) / rate
            size = estimate.size * curve.sizes[0, index]
            size_error = estimate.size * np.sqrt(curve.covariance[0, index, index])
            numbers = map(float, (time, earliest, latest, size, size_error, probability))
            rows.append(Switch(quantity, *numbers))
    return sorted(rows, key=attrgetter("time"))


def describe_changes(model: AdaptiveModel) -> list[str]:
    """Describe how stiffness changes: switches in the order of time, smooth changes, a reflex.

    The band of a switch's size is that of 95 %.
    """
    lines, where = [], ""
    for each in model.switches:
        if each.quantity == "stiffness":
            kind = "possible switch"
            share = f", probability {100 * each.probability:.0f} %"
            if each.probability > 0.5:
                kind, where = "probable switch", " between switches"
            if each.probability >= CERTAIN:
                kind, share = "switch", ""
            size = f"{each.size:+.1f} ± {1.96 * each.size_error:.1f} N·m/rad"
            lines.append(f"{kind} at {each.time:.3f} s: {size}{share}")
    smooth = 100 * model.diagnostics.details["smooth_stiffness"]
    lines.append(
        f"probability that stiffness changes smoothly{where}: {smooth:.0f} %, is constant: "
        f"{100 - smooth:.0f} %"
    )
    lines.append(
        "no stretch reflex is detected"
        if model.reflex is None
        else "the torque of a stretch reflex is separated"
    )
    return lines
