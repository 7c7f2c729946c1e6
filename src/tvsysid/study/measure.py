"""Identify an ensemble, compare the model with the truth, and stack such scores."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.errors import DataQualityWarning, InputError, describe_error, one_line
from tvsysid.methods import Method
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import OVER_TIME, Model
from tvsysid.numerics.bands import mean_known
from tvsysid.signals import Array, Ensemble

Scores = dict[str, NDArray[Any]]
"""Numbers and texts by name. A name may have a label: ``"estimate/stiffness"``."""
Rows = dict[tuple[int, ...], Scores]
"""Scores by their place in larger arrays."""
TRUTH = "truth"  # name of the true values, of which each draw has its own
SKIPPED = "skipped: "  # beginning of the warning of a method that cannot identify the data
BANDS = ("standard_error", "covered")
STATISTICS = ("mean", "sd", "lowest")  # of the VAFs of realizations


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


def measure(method: Method, ensemble: Ensemble, truth: Truth) -> Scores:
    """Identify an ensemble, and compare the model with the truth.

    If the method fails, ``failure`` says why, and the numbers are NaN.
    """
    nothing, statistics = np.full(ensemble.samples, np.nan), np.full(len(STATISTICS), np.nan)
    scores: dict[str, Any] = {
        "estimate/stiffness": nothing,
        "time_varying_vaf": nothing,
        "vaf": statistics,
        "bandpassed_vaf": statistics,
        "parameters": np.nan,
        "seconds": np.nan,
        "warnings": "",
        "failure": "",
        **{f"{of}/{name}": nothing for name in truth.quantities for of in BANDS},
    }
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            if reason := reason_to_skip(method, ensemble):
                scores["warnings"] = one_line(f"{SKIPPED}{reason}")
            else:
                model = method.identify(ensemble)
                scores["seconds"] = time.perf_counter() - started
                texts = [one_line(str(each.message)) for each in caught if _is_of_data(each)]
                scores |= _scores_of(model, ensemble, truth)
                scores["warnings"] = "; ".join(dict.fromkeys(texts))
        except (Exception, SystemExit) as error:  # another author's method may raise anything
            scores["seconds"] = time.perf_counter() - started
            scores["failure"] = describe_error(error)
    return {name: np.asarray(values) for name, values in scores.items()}


def _is_of_data(warning: warnings.WarningMessage) -> bool:
    return issubclass(warning.category, DataQualityWarning)


def _scores_of(model: Model, ensemble: Ensemble, truth: Truth) -> dict[str, Any]:
    """Return what a model estimates, how well it predicts, and whether its bands hold the truth."""
    torques = model.pathways(ensemble)
    predicted, rate = np.asarray(sum(torques.values())), ensemble.sampling_rate
    scores: dict[str, Any] = {
        "parameters": model.diagnostics.parameters,
        "time_varying_vaf": metrics.time_varying_vaf(truth.torque, predicted),
        "vaf": _statistics(metrics.vaf(truth.torque, predicted)),
        "bandpassed_vaf": _statistics(metrics.bandpassed_vaf(truth.torque, predicted, rate)),
    }
    for name, estimate in model.estimates.items():
        error = None
        if estimate.axes in OVER_TIME:
            scores |= {
                f"unit/{name}": one_line(estimate.unit),
                f"estimate/{name}": model.over_time(name),
            }
            if truth.quantities and estimate.axes == ("time",):
                error = estimate.standard_error
            if error is not None:
                lower, upper = error.limits(estimate.values, 0.95)
                known = truth.quantities.get(name, np.nan)
                held = (lower <= known) & (known <= upper)
                scores |= {
                    f"standard_error/{name}": _or_nan(error.values, error.values),
                    f"covered/{name}": _or_nan(held, lower + upper + known),
                }
        elif len(estimate.axes) == 1:
            error = estimate.standard_error
            scores |= {
                f"scheduled_estimate/{name}": estimate.values,
                f"scheduled_standard_error/{name}": np.nan * estimate.values
                if error is None
                else error.values,
                f"scheduling_variable/{name}": model.coordinates[estimate.axes[0]],
            }
    _check_found(model)
    for name, torque in torques.items() if len(torques) > 1 else ():
        true = truth.pathways.get(name)
        shares = np.zeros(0) if true is None else metrics.vaf(true, torque)
        scores |= {
            f"pathway_torque/{name}": np.sqrt(mean_known(np.square(torque))),
            f"pathway_vaf/{name}": _statistics(shares),
        }
    return scores


def _or_nan(values: NDArray[Any], known: Array) -> Array:
    """Return values, NaN where ``known`` is not finite."""
    return np.where(np.isfinite(known), values, np.nan)


def _check_found(model: Model) -> None:
    """Raise if a model has no stiffness, or nothing at all where it has no such estimate."""
    main = model.estimates.get("stiffness")
    estimates = model.estimates.values() if main is None else [main]
    if not any(np.isfinite(each.values).any() for each in estimates):
        what = "nothing" if main is None else "no stiffness"
        raise InputError(f"it found {what} at any time")


def _statistics(values: Array) -> Array:
    """Return the ``STATISTICS`` of the known values."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.full(len(STATISTICS), np.nan)
    return np.array([known.mean(), known.std(), known.min()])


def stack(rows: Sequence[Scores]) -> Scores:
    """Stack scores along a new first axis. What is missing or shorter is NaN, or an empty text.

    Examples
    --------
    >>> stack([{"vaf": np.array(80.0)}, {"vaf": np.array(90.0), "failure": np.array("")}, {}])
    {'vaf': array([80., 90., nan]), 'failure': array(['', '', ''], dtype='<U1')}
    """
    return place({(number,): row for number, row in enumerate(rows)}, (len(rows),))


def place(rows: Rows, shape: tuple[int, ...]) -> Scores:
    """Return arrays that hold each row of scores at its index, and further axes after ``shape``."""
    placed: Scores = {}
    for name in dict.fromkeys(name for row in rows.values() for name in row):
        found = {index: row[name] for index, row in rows.items() if name in row}
        is_text = any(values.dtype.kind in "UO" for values in found.values())
        further = np.max([values.shape for values in found.values()], axis=0).astype(int)
        fill, kind = ("", object) if is_text else (np.nan, float)
        whole: NDArray[Any] = np.full((*shape, *further), fill, dtype=kind)
        for index, values in found.items():
            corner: tuple[int | slice, ...] = (*index, *(slice(each) for each in values.shape))
            whole[corner] = values
        placed[name] = whole.astype(str) if is_text else whole
    return placed
