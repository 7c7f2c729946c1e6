"""Predict held-out realizations."""

from __future__ import annotations

import warnings
from itertools import product
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DataQualityWarning, describe_error, without_quality_warnings
from tvsysid.methods import centered_channels
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress
from tvsysid.signals import Array

if TYPE_CHECKING:
    from tvsysid.comparison.comparison import Comparison


def predict_held_out(found: Comparison, folds: int, progress: Progress) -> dict[str, Array]:
    """Return torques by label. See :meth:`tvsysid.Comparison.predict_held_out`."""
    ensemble, models = found.ensemble, found.models
    shape = 2, len(ensemble), ensemble.samples
    torques = {label: np.full(shape, np.nan) for label in models}
    if len(ensemble) < 2 + ensemble.mean_subtracted:
        return torques  # a single realization less its mean is zero
    parts = np.array_split(np.concatenate(ensemble.runs), min(folds, len(ensemble)))
    with single_thread():
        for number, (part, label) in enumerate(product(parts, models)):
            progress(number, len(parts) * len(models))
            try:
                torques[label][:, part] = _held_out(found, part, label)
            except Exception as error:  # a user's method may raise anything; the others go on
                text = "no held-out VAF where the method cannot be fitted without a fold"
                reason = f"{label}: {text}: {describe_error(error)}"
                warnings.warn(reason, DataQualityWarning, stacklevel=3)
    return torques


def _held_out(found: Comparison, held_out: NDArray[np.int64], label: str) -> Array:
    """Return measured torque of realizations, and that predicted by a fit to the others."""
    ensemble, method = found.ensemble, found.methods[label]
    kept = np.setdiff1d(np.arange(len(ensemble)), held_out)

    def deviation(values: Array) -> Array:
        return np.asarray(values - ensemble.mean_subtracted * mean_known(values[kept]))

    angle, torque = deviation(ensemble.angle), deviation(ensemble.torque)
    centered = {name: deviation(ensemble.signal(name)) for name in centered_channels([method])}
    measured = torque[held_out, ensemble.core]
    torque[held_out] = 0.0  # hide it from a method that reads the torque to predict it
    channels = {**ensemble.channels, **centered}
    given = attrs.evolve(ensemble, angle=angle, torque=torque, channels=channels)
    with without_quality_warnings():
        # The fit to all realizations has warned already.
        predicted = deviation(method.refit(given.select(kept), found.models[label]).predict(given))
    return np.stack([measured, predicted[held_out]])
