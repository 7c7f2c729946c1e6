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
from tvsysid.methods.base import SkippedError
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_known
from tvsysid.signals import Array, Ensemble

Scores = dict[str, NDArray[Any]]
"""Numbers, texts and labels by name. Missing numbers are NaN, missing texts are empty."""
SKIPPED = "skipped: "  # beginning of the warning of a method that cannot identify the data
STATISTICS = ("mean", "sd", "lowest")  # of the VAFs of realizations
LABELS = {
    "known_quantity": ("truth",),
    "quantity": ("estimate", "standard_error", "covered"),
    "pathway": ("pathway_vaf", "pathway_torque"),
    "scheduled": ("scheduled_estimate", "scheduled_standard_error", "scheduling_variable"),
}
"""Variables over each labelled axis, which is their last but one."""
OVER_TIME = (("time",), ("realization", "time"))  # axes of estimates over time
LABEL_OF = {name: label for label, names in LABELS.items() for name in names}


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

    A failure of the method is kept as a text; the other scores are then missing. Warnings are
    lines of a text.
    """
    scores: dict[str, Any] = no_scores(ensemble.samples, bool(truth.quantities))
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            model = method.identify(ensemble)
            scores["seconds"] = time.perf_counter() - started
            _check_estimates(model)
            texts = [one_line(str(each.message)) for each in caught if _is_of_data(each)]
            scores |= _scores_of(model, ensemble, truth)
            scores["warnings"] = "\n".join(dict.fromkeys(texts))
        except SkippedError as error:
            scores["warnings"] = one_line(f"{SKIPPED}{error.reason}")
        except (Exception, SystemExit) as error:  # another author's method may raise anything
            scores["seconds"] = time.perf_counter() - started
            scores["failure"] = describe_error(error)
    return {name: np.asarray(values) for name, values in scores.items()}


def _is_of_data(warning: warnings.WarningMessage) -> bool:
    return issubclass(warning.category, DataQualityWarning)


def no_scores(samples: int, has_bands: bool = False) -> dict[str, Any]:
    """Return the scores of a method without a result."""
    nothing = np.zeros((0, samples))
    bands = {"standard_error": nothing, "covered": nothing} if has_bands else {}
    return bands | {
        "quantity": np.zeros(0, dtype=str),
        "unit": np.zeros(0, dtype=str),
        "estimate": nothing,
        "time_varying_vaf": np.full(samples, np.nan),
        "vaf": np.full(len(STATISTICS), np.nan),
        "bandpassed_vaf": np.full(len(STATISTICS), np.nan),
        "parameters": np.nan,
        "seconds": np.nan,
        "warnings": "",
        "failure": "",
    }


def _check_estimates(model: Model) -> None:
    """Raise if a model has no stiffness, or nothing at all where it has no such estimate."""
    main = [estimate for name, estimate in model.estimates.items() if name == "stiffness"]
    if not any(np.isfinite(each.values).any() for each in main or model.estimates.values()):
        raise InputError(
            "it found no stiffness at any time" if main else "it found nothing at any time"
        )


def _scores_of(model: Model, ensemble: Ensemble, truth: Truth) -> dict[str, Any]:
    """Return what a model estimates, how well it predicts, and whether its bands hold the truth."""
    torques = model.pathways(ensemble)
    predicted, rate = np.asarray(sum(torques.values())), ensemble.sampling_rate
    over_time = [name for name, each in model.estimates.items() if each.axes in OVER_TIME]
    units = [one_line(model.estimates[name].unit) for name in over_time]
    scores: dict[str, Any] = {
        "parameters": model.diagnostics.parameters,
        "time_varying_vaf": metrics.time_varying_vaf(truth.torque, predicted),
        "vaf": _statistics(metrics.vaf(truth.torque, predicted)),
        "bandpassed_vaf": _statistics(metrics.bandpassed_vaf(truth.torque, predicted, rate)),
        "quantity": np.array(over_time, dtype=str),
        "unit": np.array(units, dtype=str),
        "estimate": np.array([model.over_time(name) for name in over_time]),
    }
    if truth.quantities:
        bands = np.array([_band(model, name, truth) for name in over_time])
        scores["standard_error"], scores["covered"] = bands[:, 0], bands[:, 1]
    if len(torques) > 1:
        known = truth.pathways
        scores["pathway"] = np.array(list(torques))
        scores["pathway_torque"] = np.array(
            [np.sqrt(mean_known(np.square(torque))) for torque in torques.values()]
        )
        scores["pathway_vaf"] = np.array(
            [
                _statistics(metrics.vaf(known[name], torque) if name in known else np.zeros(0))
                for name, torque in torques.items()
            ]
        )
    return scores | _over_schedule(model)


def _statistics(values: Array) -> Array:
    """Return the ``STATISTICS`` of the known values."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.full(len(STATISTICS), np.nan)
    return np.array([known.mean(), known.std(), known.min()])


def _band(model: Model, name: str, truth: Truth) -> Array:
    """Return the standard error of a quantity, and whether its 95 % band holds the truth.

    Shape (2, time); 1 where the band holds it, 0 where not, NaN without a band or the truth.
    """
    estimate, unknown = model.estimates[name], np.full(len(model.time), np.nan)
    if estimate.axes != ("time",) or estimate.error is None:
        return np.array([unknown, unknown])
    true = truth.quantities.get(name, unknown)
    lower, upper = estimate.band()
    known = np.isfinite(lower) & np.isfinite(upper) & np.isfinite(true)
    covered = np.where(known, (lower <= true) & (true <= upper), np.nan)
    error = estimate.standard_error
    values = unknown if error is None else error.values
    return np.array([np.where(np.isfinite(values), values, np.nan), covered])


def _over_schedule(model: Model) -> dict[str, Any]:
    """Return estimates over a measured variable, their standard errors, and its values."""
    curves = {
        name: each
        for name, each in model.estimates.items()
        if len(each.axes) == 1 and each.axes != ("time",)
    }
    if not curves:
        return {}
    errors = [each.standard_error for each in curves.values()]
    values = [each.values for each in curves.values()]
    pairs = zip(errors, values, strict=True)
    return {
        "scheduled": np.array(list(curves)),
        "scheduled_estimate": _padded(values),
        "scheduled_standard_error": _padded(
            [np.full(len(each), np.nan) if error is None else error.values for error, each in pairs]
        ),
        "scheduling_variable": _padded(
            [model.coordinates[each.axes[0]] for each in curves.values()]
        ),
    }


def _padded(rows: Sequence[Array]) -> Array:
    """Return rows as a matrix, with NaN after the shorter ones."""
    matrix = np.full((len(rows), max(map(len, rows))), np.nan)
    for target, row in zip(matrix, rows, strict=True):
        target[: len(row)] = row
    return matrix


def stack(items: Sequence[Mapping[str, NDArray[Any]]]) -> Scores:
    """Stack scores along a new first axis. Labelled axes hold the labels of all items.

    Examples
    --------
    >>> one = {"pathway": np.array(["intrinsic"]), "pathway_torque": np.ones((1, 2))}
    >>> other = {"pathway": np.array(["reflex", "intrinsic"]), "pathway_torque": np.zeros((2, 2))}
    >>> stack([one, other])["pathway_torque"][:, :, 0]
    array([[ 1., nan],
           [ 0.,  0.]])
    """
    labels = {
        label: list(dict.fromkeys(name for item in items for name in _names(item, label)))
        for label in LABELS
        if any(label in item for item in items)
    }
    stacked: Scores = {label: np.array(names, dtype=str) for label, names in labels.items()}
    if "quantity" in labels:
        units = dict(
            pair
            for item in items
            for pair in zip(_names(item, "quantity"), _names(item, "unit"), strict=True)
        )
        stacked["unit"] = np.array([units[name] for name in labels["quantity"]], dtype=str)
    for name in dict.fromkeys(name for item in items for name in item):
        if name in stacked:
            continue
        label = LABEL_OF.get(name)
        shapes = [item[name].shape for item in items if name in item]
        shape = [max(lengths) for lengths in zip(*shapes, strict=True)]
        if label is not None:
            shape[-2] = len(labels[label])
        is_text = any(name in item and item[name].dtype.kind in "UO" for item in items)
        values: NDArray[Any] = np.full(
            (len(items), *shape), "" if is_text else np.nan, dtype=object if is_text else float
        )
        for place, item in enumerate(items):
            if name not in item:
                continue
            if label is None:
                values[(place, ...)] = item[name]
            else:
                places = [labels[label].index(each) for each in _names(item, label)]
                values[place][..., places, : item[name].shape[-1]] = item[name]
        stacked[name] = values
    return stacked


def _names(item: Mapping[str, NDArray[Any]], label: str) -> list[str]:
    names: list[str] = item[label].tolist() if label in item else []
    return names
