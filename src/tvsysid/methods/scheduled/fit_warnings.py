"""Warnings about the fit of a joint that follows a measured variable."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import attrs
import numpy as np

from tvsysid.methods.scheduled.model import curves_of
from tvsysid.methods.scheduled.regression import FOLDS, Fit, Rows
from tvsysid.models import Estimate
from tvsysid.signals import Array, Ensemble

MAX_VAF_LOSS = 5.0  # points by which held-out folds may be explained worse than the fit itself
MIN_VAF = 60.0  # % of the held-out torque
MIN_BEYOND = 0.05  # distance of a fold's values from those of the others, relative to the range
MAX_ALONE = 0.02  # share of a fold's samples that may be beyond the values of the others
TIED_VAF = 0.5  # points by which another fit may predict worse and still be as good
MIN_ERRORS = 2.0  # standard errors of stiffness by which a difference is significant
MIN_CHANGE = 0.05  # difference of stiffness that matters, relative to the highest stiffness
ORDINALS = ("first", "second", "third", "fourth", "fifth")


def warnings_of_folds(rows: Rows) -> Iterator[str]:
    """Yield a warning for each fold that alone has some values of the variable."""
    name, (low, high) = rows.schedule.name, rows.schedule.limits
    for ordinal, fold in zip(ORDINALS, rows.folds, strict=True):
        own, others = rows.variable[fold], np.delete(rows.variable, fold)
        for words, limit, beyond in (
            ("below", others.min(), others.min() - own),
            ("above", others.max(), own - others.max()),
        ):
            share = float(np.mean(beyond > 0))
            if share > MAX_ALONE and beyond.max() > MIN_BEYOND * (high - low):
                yield (
                    f"{name} is {words} {limit:.3g} in the {ordinal} of {FOLDS} parts of "
                    f"the record only, for {100 * share:.0f} % of it: nothing else says how the "
                    "joint is there"
                )


def warnings_of_orders(
    name: str, details: Mapping[str, float], tried: Collection[int]
) -> Iterator[str]:
    """Yield warnings about an order that is too high or too low for the variable ``name``."""
    vaf, held_out, order = (details[each] for each in ("vaf", "vaf_folds", "order"))
    if vaf - held_out > MAX_VAF_LOSS:
        yield (
            f"of the torque {vaf:.1f} % is explained, but only {held_out:.1f} % of folds of "
            "consecutive time that were not fitted to: the order is too high for this record; use "
            "a lower one"
        )
    elif held_out < MIN_VAF:
        yield f"only {held_out:.1f} % of the torque is explained in folds that were not fitted to"
    if len(tried) > 1 and order >= max(tried) - 1:
        yield (
            f"the orders tried end at {max(tried)}, and {order:g} predicts best: the joint may "
            f"change faster with {name} than polynomials follow, and the bands do not count that"
        )


def warnings_of_rest(
    fit: Fit, stiffness: Estimate, grid: Array, ensemble: Ensemble
) -> Iterator[str]:
    """Yield a warning if ``stiffness`` on a grid of the variable needs another torque at rest.

    The torque at rest may follow the variable more than its polynomial does.
    """
    rest, *others = fit.rows.terms
    order, schedule = max(term.order for term in others), fit.rows.schedule
    error = stiffness.standard_error
    if rest.order >= order or error is None:
        return
    freed = (attrs.evolve(rest, order=order), *others)
    other = Fit.of(Rows.of(freed, schedule, ensemble))
    changed = curves_of(other, other.inverse, np.inf)["stiffness"]
    change = changed.at(grid, stiffness.axes).values - stiffness.values
    largest = int(np.argmax(np.abs(change) / error.values))
    size, errors = abs(change[largest]), abs(change[largest]) / error.values[largest]
    own_vaf, other_vaf = fit.held_out.mean(), other.held_out.mean()
    matters = errors > MIN_ERRORS and size > MIN_CHANGE * stiffness.values.max()
    if matters and other_vaf > own_vaf - TIED_VAF:
        side = "higher" if change[largest] > 0 else "lower"
        yield (
            f"at {schedule.name} {grid[largest]:.3g}, stiffness would be {size:.1f} N·m/rad {side} "
            f"({errors:.1f} standard errors) if the torque at rest followed the variable, which "
            f"predicts folds as well ({other_vaf:.1f} against {own_vaf:.1f} %): use "
            f"rest_order={order}, unless you know that the torque at rest is constant"
        )
