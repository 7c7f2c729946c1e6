"""Warnings about the fit of a joint that follows a measured variable."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tvsysid.methods.scheduled.fit import FOLDS, Fit, with_rest
from tvsysid.models import Estimate
from tvsysid.signals import Array, Ensemble

# per cent of the torque's variance by which an order must predict better than the one given
CLEARLY = 0.5


POOR = 60.0  # per cent of the torque's variance held out below which the model is doubtful


RESTS = (
    2.0  # standard errors by which stiffness may change if the torque at rest follows the variable
)


MATTERS = 0.05  # share of the highest stiffness below which such a change is none


LOST = 5.0  # per cent by which folds held out may be worse than the fit itself


ORDINALS = ("first", "second", "third", "fourth", "fifth")


# share of the variable's range by which a fold must exceed that of the others for a warning
FAR = 0.05


ALONE = 0.02  # share of a fold's samples that the others' range may lack


def fit_warnings(fit: Fit, details: dict[str, float]) -> Iterator[str]:
    """Yield warnings about folds that were predicted badly, and about the order."""
    rows, (low, high), name = fit.rows, fit.structure.limits, fit.structure.variable
    for number, fold in enumerate(rows.folds):
        own, others = rows.variable[fold], np.delete(rows.variable, fold)
        ends = (
            ("below", others.min() - own, others.min()),
            ("above", own - others.max(), others.max()),
        )
        for words, beyond, limit in ends:
            share = float(np.mean(beyond > 0))
            if share > ALONE and beyond.max() > FAR * (high - low):
                yield (
                    f"{name} is {words} {limit:.3g} in the {ORDINALS[number]} of {FOLDS} parts of "
                    f"the record only, for {100 * share:.0f} % of it: nothing else says how the "
                    "joint is there"
                )
    if details["vaf"] - details["vaf_folds"] > LOST:
        yield (
            f"of the torque {details['vaf']:.1f} % is explained, but only "
            f"{details['vaf_folds']:.1f} % of folds of consecutive time that were not fitted to: "
            "the order is too high for this record; use a lower one"
        )
    elif details["vaf_folds"] < POOR:
        yield (
            f"only {details['vaf_folds']:.1f} % of the torque is explained in folds that were not "
            "fitted to"
        )
    order, orders = fit.structure.orders[0], {each for each, _ in fit.tried}
    if len(orders) > 1 and order >= max(orders) - 1:
        yield (
            f"the orders tried end at {max(orders)}, and {order} predicts best: the joint may "
            f"change faster with {name} than polynomials follow, and the bands do not count that"
        )


def rest_warnings(fit: Fit, ensemble: Ensemble, grid: Array, stiffness: Estimate) -> Iterator[str]:
    """Yield a warning if stiffness depends on the order of the torque at rest.

    The torque at rest then follows the variable too little. Stiffness is compared on a ``grid`` of
    the variable.
    """
    degrees = max(
        fit.structure.degrees, fit.structure.reflex.degrees if fit.structure.reflex else 1
    )
    if fit.structure.rest >= degrees or stiffness.standard_error is None:
        return
    other = with_rest(fit, ensemble, degrees)
    weights = other.coefficients @ other.structure.readouts(ensemble.sampling_rate)["stiffness"]
    change = other.structure.polynomials(grid)[:, : len(weights)] @ weights - stiffness.values
    most = int(np.argmax(np.abs(change) / stiffness.standard_error.values))
    errors, gained = (
        abs(change[most]) / stiffness.standard_error.values[most],
        other.held_out.mean(),
    )
    matters = abs(change[most]) > MATTERS * stiffness.values.max()
    if errors > RESTS and matters and gained > fit.held_out.mean() - CLEARLY:
        side = "higher" if change[most] > 0 else "lower"
        yield (
            f"at {fit.structure.variable} {grid[most]:.3g}, stiffness would be "
            f"{abs(change[most]):.1f} N·m/rad {side} ({errors:.1f} standard errors) if the torque "
            f"at rest followed the variable, which predicts folds as well ({gained:.1f} against "
            f"{fit.held_out.mean():.1f} %): use rest_order={degrees - 1}, unless you know that the "
            "torque at rest is constant"
        )
