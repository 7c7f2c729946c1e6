"""Predict held-out realizations."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DataQualityWarning, describe_error
from tvsysid.methods import Method, centered_channels
from tvsysid.metrics import vaf
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least


def held_out_vaf(
    ensemble: Ensemble,
    methods: Mapping[str, Method],
    models: Mapping[str, Model],
    folds: int,
    jobs: int,
    progress: Progress,
) -> dict[str, Array]:
    """Return the VAF of each realization by label. See :meth:`tvsysid.Comparison.held_out_vaf`."""
    at_least(2).check("held_out_vaf", "folds", folds)
    vafs = {label: np.full(len(ensemble), np.nan) for label in models}
    if len(ensemble) < (3 if ensemble.mean_subtracted else 2):
        return vafs  # a single realization less its mean is zero
    parts = np.array_split(np.concatenate(ensemble.runs), min(folds, len(ensemble)))
    pairs = [(label, part) for part in parts for label in models]
    tasks = [Fold(ensemble, part, methods[label], models[label]) for label, part in pairs]
    failed: dict[str, str] = {}
    with single_thread():
        for number, result in enumerate(_results(tasks, jobs)):
            progress(number, len(pairs))
            label, part = pairs[number]
            if isinstance(result, str):
                failed.setdefault(label, result)
            else:
                vafs[label][part] = result
    for label, reason in failed.items():
        text = f"{label}: no held-out VAF where the method cannot be fitted without a fold"
        warnings.warn(f"{text}: {reason}", DataQualityWarning, stacklevel=3)
    return vafs


class Fold(NamedTuple):
    """Realizations to hold out, and a method with its model of all realizations."""

    ensemble: Ensemble
    held_out: NDArray[np.int64]
    method: Method
    model: Model

    def result(self) -> Array | str:
        """Return the VAF of the held-out realizations, or why there is none."""
        try:
            with warnings.catch_warnings():
                # The fit to all realizations has warned already.
                warnings.simplefilter("ignore", DataQualityWarning)
                return self._vaf()
        except Exception as error:  # a user's method may raise anything; the others go on
            return describe_error(error)

    def _vaf(self) -> Array:
        ensemble, held_out = self.ensemble, self.held_out
        kept = np.setdiff1d(np.arange(len(ensemble)), held_out)

        def deviation(values: Array) -> Array:
            return values - values[kept].mean(axis=0) if ensemble.mean_subtracted else values

        torque = deviation(ensemble.torque)
        blanked = np.array(torque)
        blanked[held_out] = 0.0  # hide it from a method that reads the torque to predict it
        names = centered_channels([self.method])
        channels = {name: deviation(ensemble.channels[name]) for name in names}
        given = attrs.evolve(
            ensemble,
            angle=deviation(ensemble.angle),
            torque=blanked,
            channels={**ensemble.channels, **channels},
        )
        predicted = self.method.refit(given.select(kept), self.model).predict(given)
        if ensemble.mean_subtracted:
            predicted = predicted - mean_known(predicted[kept])
        return vaf(torque[held_out, ensemble.core], predicted[held_out])


def _results(folds: Sequence[Fold], jobs: int) -> Iterator[Array | str]:
    """Compute the results, on Linux in forked workers. Other systems cannot fork safely."""
    if jobs == 1 or sys.platform != "linux":
        yield from map(Fold.result, folds)
        return
    workers = min(len(folds), len(os.sched_getaffinity(0)) if jobs < 1 else jobs)
    with ProcessPoolExecutor(workers, get_context("fork"), _start_worker, (folds,)) as pool:
        yield from pool.map(_result_of, range(len(folds)))


_inherited: list[Fold] = []  # folds that a worker inherits, without pickling


def _start_worker(folds: Sequence[Fold]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the parent, which ends its workers
    _inherited[:] = folds


def _result_of(number: int) -> Array | str:
    return _inherited[number].result()
