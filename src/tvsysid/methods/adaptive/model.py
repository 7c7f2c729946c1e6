"""Model of adaptive regression: impedance over time with bands, and a table of its changes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import attrs
import numpy as np
from scipy.special import ndtr

from tvsysid.dataset_layout import Labelled
from tvsysid.methods.adaptive.posterior import Hypothesis, Mixture, Posterior
from tvsysid.methods.adaptive.search import CLOSE
from tvsysid.methods.cascade.result import JointCascadeModel
from tvsysid.models import Model, StandardError
from tvsysid.numerics import Array
from tvsysid.signals import Ensemble

BISECTIONS = 26
INSIDE = 1e-3  # share of the usual half width by which a band goes beyond its estimate at least


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


class Smoothness(NamedTuple):
    """A smooth part of a ``quantity``.

    It has a ``kind``, a standard deviation in the quantity's unit, a length in s, and a
    probability.
    """

    quantity: str
    kind: str
    amplitude: float
    length: float
    probability: float


@attrs.frozen(eq=False)
class MixtureError(StandardError):
    """Random error of an estimate that is a mixture of possible values.

    Near an undecided switch, the band spans both levels. The ``mixture`` is over the times that are
    known. A band is not negative where none of the mixture's means is.
    """

    mixture: Mixture | None = None

    def limits(
        self, values: Array, level: float, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        """Return the limits of a band: quantiles of the mixture, with Student's t for each part."""
        assert self.mixture is not None
        known = np.isfinite(self.values)
        freedom, multiple = self.freedom[known], self.multiple(level, simultaneous)
        lower, upper = np.full(values.shape, np.nan), np.full(values.shape, np.nan)
        inside = INSIDE * multiple * self.values[known]
        lower[known] = np.minimum(self._quantile(-multiple, freedom), values[known] - inside)
        upper[known] = np.maximum(self._quantile(multiple, freedom), values[known] + inside)
        return (np.maximum(lower, 0.0) if self.mixture.means.min() >= 0 else lower), upper

    def _quantile(self, multiple: Array, freedom: Array) -> Array:
        """Return the quantile (time,) with the probability of Student's t below ``multiple``."""
        assert self.mixture is not None
        weights, means, variances = self.mixture
        spreads, wanted, many = np.sqrt(variances), _as_normal(multiple, freedom), freedom[:, None]
        each = means + spreads * multiple[:, None]
        each = np.where(weights > 0, each, each[:, :1])
        low, high, share = each.min(axis=1), each.max(axis=1), ndtr(wanted)
        for _ in range(BISECTIONS if weights.shape[1] > 1 else 0):
            middle = (low + high) / 2
            inside = ndtr(_as_normal((middle[:, None] - means) / spreads, many))
            below = np.einsum("tc,tc->t", weights, inside)
            low, high = np.where(below < share, middle, low), np.where(below < share, high, middle)
        return np.asarray((low + high) / 2)


def _as_normal(multiple: Array, freedom: Array) -> Array:
    """Return the normal deviate with the probability of Student's t, to 0.2 % (Wallace 1959)."""
    shrunk = (
        np.sqrt(freedom * np.log1p(multiple**2 / freedom)) * (8 * freedom + 1) / (8 * freedom + 3)
    )
    return np.asarray(np.copysign(shrunk, multiple))


@attrs.frozen(eq=False, repr=False, kw_only=True)
class AdaptiveModel(Model):
    r"""Second-order impedance whose stiffness and viscosity change smoothly, suddenly, or not.

    .. math:: y(t) = k(t)\,\theta + b(t)\,\dot\theta + I\,\ddot\theta

    ``switches`` (of a probability of 5 % and more) and ``smoothness`` are tables of what was found.
    Where a reflex is shown, the model ``reflex`` has its pathway, and the intrinsic response of
    which stiffness and viscosity are a part. ``hypotheses`` are the models that were averaged, by
    quantity, the most probable first. :meth:`plot` shows all of these.
    """

    switches: tuple[Switch, ...] = ()
    smoothness: tuple[Smoothness, ...] = ()
    reflex: JointCascadeModel | None = None
    hypotheses: Mapping[str, Sequence[Hypothesis]] = attrs.field(factory=dict)

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        if self.reflex is None:
            return super()._pathways(ensemble)
        found, (angle, velocity) = self.reflex.pathways(ensemble), ensemble.derivatives(1)
        found["intrinsic"] = (
            found["intrinsic"]
            + (self.stiffness - self.reflex.stiffness) * angle
            + (self.viscosity - self.reflex.viscosity) * velocity
        )
        return found

    def _identified(self) -> tuple[Labelled, Labelled]:
        return {**_columns("switch", self.switches), **_columns("smoothness", self.smoothness)}, {}


def _columns(axis: str, rows: tuple[NamedTuple, ...]) -> Labelled:
    """Return a table by columns, over an axis of its own."""
    if not rows:
        return {}
    return {
        f"{axis}_{name}": ((axis,), [getattr(row, name) for row in rows])
        for name in rows[0]._fields
    }


MIN_PROBABILITY, MIN_SWITCH_PROBABILITY = 0.01, 0.05  # of what is listed
CERTAIN = 0.995  # probability of a switch that is not mentioned


def smoothness_of(quantity: str, posterior: Posterior, rate: float) -> Iterator[Smoothness]:
    """Return the smooth parts that are likely, the most probable first."""
    size = posterior.candidates[0].smooth.estimate.size
    probabilities: dict[tuple[str, float, float], float] = {}
    for each, probability in zip(posterior.candidates, posterior.probabilities, strict=True):
        key = each.smooth.prior[:3]
        probabilities[key] = probabilities.get(key, 0.0) + float(probability)
    for key in sorted(probabilities, key=lambda each: -probabilities[each]):
        if probabilities[key] >= MIN_PROBABILITY:
            kind, amplitude, length = key
            yield Smoothness(quantity, kind, amplitude * size, length / rate, probabilities[key])


def switches_of(quantity: str, posterior: Posterior, missing: int, rate: float) -> list[Switch]:
    """Return the switches that are likely enough to be listed, in the order of time.

    Those of a candidate are left out where a better candidate has one nearby.
    """
    estimate = posterior.candidates[0].smooth.estimate
    axis, scale, weights = estimate.axis, estimate.size, posterior.weights

    def has_near(positions: Array, position: float) -> bool:
        return bool((np.abs(axis.offset(positions, position)) < CLOSE).any())

    rows, listed = list[Switch](), np.zeros(0)
    for candidate, own in zip(posterior.candidates, posterior.over_time, strict=False):
        before, switches = listed, candidate.switches
        for place, position in enumerate(switches.positions.tolist()):
            if has_near(before, position):
                continue
            listed = np.append(listed, position)
            near = [
                has_near(each.switches.positions, position)
                for each in posterior.candidates[: len(weights)]
            ]
            offsets = axis.offset(switches.windows[place], position)
            order = np.argsort(offsets)
            total = np.cumsum(switches.probabilities[place][order])
            ends = np.minimum(np.searchsorted(total, [0.025, 0.975]), len(order) - 1)
            early, late = (offsets[order][ends] / rate).tolist()
            time = (position + missing) / rate
            row = Switch(
                quantity,
                time,
                earliest=time + min(early, 0.0),
                latest=time + max(late, 0.0),
                size=scale * float(own.sizes[0, place]),
                size_error=scale * math.sqrt(own.covariance[0, place, place]),
                probability=min(float(weights @ near), 1.0),  # rounding may exceed it
            )
            if row.probability >= MIN_SWITCH_PROBABILITY:
                rows.append(row)
    return sorted(rows, key=lambda row: row.time)


def changes(model: AdaptiveModel) -> list[str]:
    """Describe how stiffness changes: its switches in the order of time, smooth changes, a reflex.

    The band of a switch's size is that of 95 %.
    """
    lines, where = [], ""
    for each in model.switches:
        if each.quantity != "stiffness":
            continue
        sure, share = each.probability >= CERTAIN, f", probability {100 * each.probability:.0f} %"
        kind = (
            "switch" if sure else "probable switch" if each.probability > 0.5 else "possible switch"
        )
        lines.append(
            f"{kind} at {each.time:.3f} s: {each.size:+.1f} ± {1.96 * each.size_error:.1f} "
            f"N·m/rad{'' if sure else share}"
        )
        where = " between switches" if each.probability > 0.5 else where
    constant = sum(
        row.probability
        for row in model.smoothness
        if (row.quantity, row.kind) == ("stiffness", "none")
    )
    lines.append(f"smooth change{where}: probability {100 * max(0.0, 1 - constant):.0f} %")
    if model.reflex is not None:
        lines.append("the torque of a stretch reflex is separated")
    return lines
