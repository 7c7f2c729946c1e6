"""Predict realizations that a method was not fitted to."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DataQualityWarning, describe_error
from tvsysid.methods import Method, centered_channels
from tvsysid.metrics import vaf
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress, no_progress
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least


def held_out_vaf(
    ensemble: Ensemble,
    methods: Mapping[str, Method],
    models: Mapping[str, Model],
    folds: int,
    progress: Progress = no_progress,
) -> dict[str, Array]:
    """Return the VAF of each realization by label. See :meth:`tvsysid.Comparison.held_out_vaf`."""
    at_least(2).check("held_out_vaf", "folds", folds)
    found = {label: np.full(len(ensemble), np.nan) for label in models}
    if len(ensemble) < (3 if ensemble.mean_subtracted else 2):
        return found  # one realization less its mean is nothing
    parts = np.array_split(np.concatenate(ensemble.runs), min(folds, len(ensemble)))
    jobs = [(label, part) for part in parts for label in models]
    failed: dict[str, str] = {}
    with single_thread():
        for number, (label, part) in enumerate(jobs):
            progress(number, len(jobs))
            try:
                found[label][part] = _vaf_of(ensemble, part, methods[label], models[label])
            except Exception as error:  # a user's method may raise anything; the others go on
                failed.setdefault(label, describe_error(error))
    for label, reason in failed.items():
        text = f"{label}: no held-out VAF where a fold of the realizations cannot be left out"
        warnings.warn(f"{text}: {reason}", DataQualityWarning, stacklevel=3)
    return found


def _vaf_of(ensemble: Ensemble, left: NDArray[np.int64], method: Method, model: Model) -> Array:
    """Identify all realizations but those ``left`` out, and return the VAF of the latter."""
    kept = np.setdiff1d(np.arange(len(ensemble)), left)

    def deviation(values: Array) -> Array:
        return values - values[kept].mean(axis=0) if ensemble.mean_subtracted else values

    torque = deviation(ensemble.torque)
    unseen = np.array(torque)
    unseen[left] = 0.0  # a method that predicts cannot look at it
    channels = dict(ensemble.channels)
    for name in centered_channels([method]):
        channels[name] = deviation(channels[name])
    angle = deviation(ensemble.angle)
    ensemble = attrs.evolve(ensemble, angle=angle, torque=unseen, channels=channels)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # the fit to all has warned
        predicted = method.refit(ensemble.select(kept), model).predict(ensemble)
    if ensemble.mean_subtracted:
        predicted = predicted - mean_known(predicted[kept])
    return vaf(torque[left, ensemble.core], predicted[left])
