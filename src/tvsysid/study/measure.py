"""Identify an ensemble, and compare the model with the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.errors import InputError, describe_error, one_line, without_quality_warnings
from tvsysid.methods import Method
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import OVER_TIME, Model
from tvsysid.numerics.bands import mean_known
from tvsysid.signals import Array, Ensemble
from tvsysid.simulate import Simulation

Scores = dict[str, NDArray[Any]]
"""Arrays by the name of their variable. The array of one quantity or pathway has axis and label in
its name, too: ``"estimate quantity stiffness"``."""
SKIPPED = "skipped: "  # beginning of the warning of a method that cannot identify the data


@attrs.frozen
class Truth:
    """Torque that a model should predict, and what is known of the joint.

    Parameters
    ----------
    torque
        Noiseless torque, or the recorded one, in N·m, shape (realization, time).
    quantities
        Quantities of the joint, each of shape (time,). Bands are compared with them.
    pathways
        Noiseless torque of each pathway, shape (realization, time).
    """

    torque: Array
    quantities: Mapping[str, Array] = attrs.field(factory=dict)
    pathways: Mapping[str, Array] = attrs.field(factory=dict)


def mean_quantities(simulation: Simulation, ensemble: Ensemble) -> dict[str, Array]:
    """Return the means over realizations of a simulated joint's quantities, each (time,)."""
    # The first is subtracted, so that the mean of equal values is exact.
    return {
        name: each[0] + (each - each[0]).mean(axis=0)
        for name, each in simulation.truth_of(ensemble).items()
    }


def measure(method: Method, ensemble: Ensemble, truth: Truth) -> Scores:
    """Identify an ensemble, and compare the model with the truth.

    If the method fails, ``failure`` says why, and there are no numbers.
    """
    warned = failure = ""
    scores = {f"truth quantity {name}": each for name, each in truth.quantities.items()}
    with without_quality_warnings():
        try:
            if reason := reason_to_skip(method, ensemble):
                warned = SKIPPED + reason
            else:
                model = method.identify(ensemble)
                scores |= _scores_of(model, ensemble, truth)
                texts = (f"{method.key}: {each}" for each in model.diagnostics.warnings)
                warned = "; ".join(map(one_line, texts))
        except (Exception, SystemExit) as error:  # another author's method may raise anything
            failure = describe_error(error)
    return scores | {"warnings": np.array(warned), "failure": np.array(failure)}


def _scores_of(model: Model, ensemble: Ensemble, truth: Truth) -> Scores:
    """Return what a model estimates, how well it predicts, and whether its bands hold the truth.

    Raise an InputError if a model has no stiffness at any time.
    """
    if not np.isfinite(model.stiffness).any():
        raise InputError("it found no stiffness at any time")
    torques = model.pathways(ensemble)
    pair = truth.torque, np.asarray(sum(torques.values()))
    scores: Scores = {
        "vaf": mean_known(metrics.vaf(*pair)),
        "bandpassed_vaf": mean_known(metrics.bandpassed_vaf(*pair, ensemble.sampling_rate)),
        "time_varying_vaf": metrics.time_varying_vaf(*pair),
        "seconds": np.array(model.diagnostics.seconds),
    }
    for name, estimate in model.estimates.items():
        if estimate.axes in OVER_TIME:
            scores[f"estimate quantity {name}"] = model.over_time(name)
            scores[f"unit quantity {name}"] = np.array(one_line(estimate.unit))
        if name in truth.quantities and estimate.axes == ("time",):
            true, (lower, upper) = truth.quantities[name], estimate.band(0.95)
            held = (lower <= true) & (true <= upper)
            has_band = np.isfinite(lower + upper + true)
            scores[f"covered quantity {name}"] = np.where(has_band, held, np.nan)
    several = [name for name in torques if name in truth.pathways]
    for name in several if len(several) > 1 else ():
        vaf = mean_known(metrics.vaf(truth.pathways[name], torques[name]))
        scores[f"pathway_vaf pathway {name}"] = vaf
    return scores


def stack(parts: Sequence[Scores], *shape: int) -> Scores:
    """Return scores along new first axes, by default one. What a part lacks is NaN, or empty text.

    Examples
    --------
    >>> stack([{"vaf": np.array(80.0)}, {"failure": np.array("too few")}])
    {'vaf': array([80., nan]), 'failure': array(['', 'too few'], dtype='<U7')}
    """
    stacked = {}
    for name, example in {name: each for part in parts for name, each in part.items()}.items():
        is_text = example.dtype.kind == "U"
        nothing = np.full(example.shape, "" if is_text else np.nan)
        values = np.stack([part.get(name, nothing) for part in parts])
        stacked[name] = values.reshape(*shape or values.shape[:1], *example.shape)
    return stacked
