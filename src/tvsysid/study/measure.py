"""Identify an ensemble, compare the model with the truth, and merge such scores."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid import metrics
from tvsysid.errors import DataQualityWarning, InputError, describe_error, one_line
from tvsysid.methods import Method
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import OVER_TIME, Model
from tvsysid.numerics.bands import mean_known
from tvsysid.signals import Array, Ensemble

Scores = dict[str, tuple[tuple[str, ...], NDArray[Any]]]
"""Dimensions and values by name, as ``xarray.Dataset`` takes them. A variable with the name of its
dimension holds labels."""
SKIPPED = "skipped: "  # beginning of the warning of a method that cannot identify the data
STATISTICS = ("mean", "sd", "lowest")  # of the VAFs of realizations
AXES = ("scenario", "trial", "method_key"), ("recording", "bootstrap", "analysis")
"""Dimensions along which cases, draws and methods lie, of simulations and of experiments."""


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

    def scores(self) -> list[Scores]:
        """Return the quantities as scores."""
        return [at(over("time", truth=own), quantity=name) for name, own in self.quantities.items()]


def measure(method: Method, ensemble: Ensemble, truth: Truth) -> Scores:
    """Identify an ensemble, and compare the model with the truth.

    If the method fails, ``failure`` says why, and the numbers are NaN.
    """
    parts: list[Scores] = []
    warning, failure, seconds, started = "", "", np.nan, time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            if reason := reason_to_skip(method, ensemble):
                warning = f"{SKIPPED}{reason}"
            else:
                model = method.identify(ensemble)
                seconds = time.perf_counter() - started
                doubts = [each for each in caught if issubclass(each.category, DataQualityWarning)]
                parts += [*_scores_of(model, ensemble, truth)]
                warning = "; ".join(dict.fromkeys(one_line(str(each.message)) for each in doubts))
        except (Exception, SystemExit) as error:  # another author's method may raise anything
            seconds, failure = time.perf_counter() - started, describe_error(error)
    return merge([*parts, over(seconds=seconds, warnings=warning, failure=failure)])


def _scores_of(model: Model, ensemble: Ensemble, truth: Truth) -> Iterator[Scores]:
    """Yield what a model estimates, how well it predicts, and whether its bands hold the truth.

    Raise an InputError if a model has no stiffness, or nothing where it has no such estimate.
    """
    main = model.estimates.get("stiffness")
    needed = model.estimates.values() if main is None else [main]
    if not any(np.isfinite(each.values).any() for each in needed):
        raise InputError(f"it found {'nothing' if main is None else 'no stiffness'} at any time")
    torques = model.pathways(ensemble)
    pair = truth.torque, np.asarray(sum(torques.values()))
    bandpassed = metrics.bandpassed_vaf(*pair, ensemble.sampling_rate)
    yield {
        **over("statistic", vaf=_statistics(metrics.vaf(*pair))),
        **over("statistic", bandpassed_vaf=_statistics(bandpassed)),
        **over("time", time_varying_vaf=metrics.time_varying_vaf(*pair)),
        **over(parameters=model.diagnostics.parameters),
    }
    for name, estimate in model.estimates.items():
        error, values = estimate.standard_error, estimate.values
        if estimate.axes in OVER_TIME:
            own = over("time", estimate=model.over_time(name)) | over(unit=one_line(estimate.unit))
            if truth.quantities:
                deviation = lower = upper = np.full(ensemble.samples, np.nan)
                if error is not None and estimate.axes == ("time",):
                    deviation, (lower, upper) = error.values, error.limits(values, 0.95)
                known = truth.quantities.get(name, np.nan)
                held = (lower <= known) & (known <= upper)
                own |= over(
                    "time",
                    standard_error=np.where(np.isfinite(deviation), deviation, np.nan),
                    covered=np.where(np.isfinite(lower + upper + known), held, np.nan),
                )
            yield at(own, quantity=name)
        elif len(estimate.axes) == 1:
            curves = over(
                "scheduling",
                scheduled_estimate=values,
                scheduled_standard_error=np.nan * values if error is None else error.values,
                scheduling_variable=model.coordinates[estimate.axes[0]],
            )
            yield at(curves, scheduled=name)
    for name, torque in torques.items() if len(torques) > 1 else ():
        true = truth.pathways.get(name)
        shares = np.array([np.nan]) if true is None else metrics.vaf(true, torque)
        sizes = over("time", pathway_torque=np.sqrt(mean_known(np.square(torque))))
        yield at(sizes | over("statistic", pathway_vaf=_statistics(shares)), pathway=name)


def _statistics(values: Array) -> Array:
    """Return the ``STATISTICS`` of the known values."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.full(len(STATISTICS), np.nan)
    return np.array([known.mean(), known.std(), known.min()])


def over(*dims: str, **values: ArrayLike) -> Scores:
    """Return arrays of the same dimensions, or single numbers and texts, as scores."""
    return {name: (dims, np.asarray(each)) for name, each in values.items()}


def at(scores: Scores, **place: object) -> Scores:
    """Return scores along further dimensions, at one label of each."""
    further = (np.newaxis,) * len(place)
    placed: Scores = {
        name: (dims, values) if dims == (name,) else ((*place, *dims), values[further])
        for name, (dims, values) in scores.items()
    }
    return placed | {dim: ((dim,), np.array([label])) for dim, label in place.items()}


def merge(
    parts: Iterable[Scores], labels: Mapping[str, Iterable[Any]] = MappingProxyType({})
) -> Scores:
    """Return scores in common arrays. What no part has is NaN, or an empty text.

    Parameters
    ----------
    parts
        Scores. Their labels say where their values go; a dimension without labels is counted from
        0. Where parts overlap, the last one counts.
    labels
        Labels of dimensions, in their order, to which the parts add others.

    Examples
    --------
    >>> merge([at(over(vaf=80.0), trial=2), at(over(vaf=90.0, failure="x"), trial=1)])
    {'trial': (('trial',), array([2, 1])), 'vaf': (('trial',), array([80., 90.])),
    'failure': (('trial',), array(['', 'x'], dtype='<U1'))}
    """
    labelled = [(part, _labels_of(part)) for part in parts]
    places = {dim: {label: n for n, label in enumerate(given)} for dim, given in labels.items()}
    for _, own in labelled:
        for dim, given in own.items():
            known = places.setdefault(dim, {})
            for label in given:
                known.setdefault(label, len(known))
    whole: Scores = {dim: ((dim,), np.array([*known])) for dim, known in places.items()}
    for part, own in labelled:
        index = {dim: [places[dim][label] for label in given] for dim, given in own.items()}
        for name, (dims, values) in part.items():
            if name in places:
                continue
            if name not in whole:
                fill = "" if values.dtype.kind in "UO" else np.nan
                shape = [len(places[dim]) for dim in dims]
                whole[name] = dims, np.full(shape, fill, dtype=object if fill == "" else float)
            whole[name][1][np.ix_(*(index[dim] for dim in dims))] = values
    return {
        name: (dims, values.astype(str) if values.dtype == object else values)
        for name, (dims, values) in whole.items()
    }


def _labels_of(part: Scores) -> dict[str, Any]:
    """Return the labels of each dimension."""
    sizes = {
        dim: size
        for dims, values in part.values()
        for dim, size in zip(dims, values.shape, strict=True)
    }
    return {
        dim: part[dim][1].tolist() if dim in part else range(size) for dim, size in sizes.items()
    }
