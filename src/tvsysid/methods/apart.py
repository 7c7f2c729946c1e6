"""Identify by any method: the package's own in this process, somebody else's in one of its own, on a copy of the data.

What somebody else's method does to its process or to the data reaches no other method. What comes back is made of the
package's own classes, numbers and text alone, so that nobody's code runs here.
"""

from __future__ import annotations

import math
import pickle
import time
from contextlib import suppress
from dataclasses import fields
from typing import NamedTuple

import cloudpickle
import numpy as np

from tvsysid.errors import InputError, plain_text
from tvsysid.estimates import Estimate, StandardError
from tvsysid.methods.apply import AdoptedModel, Identifies, apply, checked_torques, digest
from tvsysid.methods.base import Method, SkippedError, reason_to_skip
from tvsysid.methods.forkserver import call
from tvsysid.methods.travel import plain
from tvsysid.methods.tuning.evidence import Evidence, Tuned
from tvsysid.models import Diagnostics, Model
from tvsysid.signals import Array, Ensemble


class Identified(NamedTuple):
    """A model, the evidence for the settings if they were chosen from the data, and the seconds that both took."""

    model: Model
    evidence: Evidence | None
    seconds: float


def checked_limit(seconds: float) -> float:
    """Time limit, if it is a positive number of seconds."""
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not 0 < seconds < math.inf:
        raise InputError(f"time_limit: expected a positive number of seconds, got {seconds!r}")
    return float(seconds)


def identify(
    method: bytes,
    ensemble: Ensemble,
    label: str = "",
    *,
    tune: bool = False,
    limit: float,
    keep: bool = False,
) -> Identified:
    """Identify by a pickled method, whoever wrote it; its settings chosen from the data first if it is to ``tune``.

    ``label`` is for messages. Somebody else's model predicts for the ensemble that it was identified from, and for
    others if it is to ``keep`` its own code.

    Raises
    ------
    SkippedError, MethodError
        If the method cannot serve the ensemble; if somebody else's fails, or takes longer than the limit in seconds
        (HungError). Errors of the package's own methods pass.
    """
    try:
        own = plain(method)
    except Exception:  # it holds somebody else's code, or is no pickle
        found: Identified = call(method, _identified_apart, ensemble, label, tune, keep, limit=limit)
        return found
    return _identified(own, ensemble, label, tune)


def _identified(method: Identifies, ensemble: Ensemble, label: str, tune: bool) -> Identified:
    label = label or type(method).__name__
    if reason := reason_to_skip(method, ensemble):
        raise SkippedError(reason)
    started = time.perf_counter()
    method, evidence = _tuned(method, ensemble) if tune else (method, None)
    model = apply(method, ensemble, label)
    return Identified(model, evidence, time.perf_counter() - started)


def predicted(method: bytes, kept: Ensemble, every: Ensemble, label: str, model: Model, *, limit: float) -> Array:
    """Torque of all realizations, (realization, time), by what a pickled method identifies from those ``kept``.

    The package's own methods start from the ``model`` that they identified from all realizations.
    """
    try:
        own = plain(method)
    except Exception:  # as in :func:`identify`
        found: Array = call(method, _predicted, kept, every, label, limit=limit)
    else:
        found = own.refit(kept, model).predict(every)
    return found


def _predicted(method: Identifies, kept: Ensemble, every: Ensemble, label: str) -> Array:
    return np.array(_identified(method, kept, label, tune=False).model.predict(every))


def _tuned(method: object, ensemble: Ensemble) -> tuple[Method, Evidence | None]:
    """Method with settings chosen from the data, and the evidence for them."""
    own = method.method if isinstance(method, Tuned) else method
    if not isinstance(own, Method):
        raise InputError(
            "its settings cannot be chosen from data; leave out tune (--tune), and write key:tuned=true for those "
            "methods whose settings can"
        )
    return own.tuned(ensemble) if fields(own) else (own, None)  # what has no settings has none to choose


def _identified_apart(method: Identifies, ensemble: Ensemble, label: str, tune: bool, keep: bool) -> Identified:
    """What the process of somebody else's method does; all of its own code has run when this returns."""
    before = digest(ensemble)
    found = _identified(method, ensemble, label, tune)
    model = found.model
    torques = checked_torques(model.pathways(ensemble), ensemble, str(model.method))
    try:
        plain(pickle.dumps(model))
    except Exception:
        model = _own_code_left_behind(model, torques, before, keep)
    with suppress(Exception):  # what is there now may be no data at all
        if digest(ensemble) == before:
            return found._replace(model=model)
    raise InputError("it changed the ensemble, which must stay as it is; work on a copy, as in ensemble.angle.copy()")


def _own_code_left_behind(model: Model, torques: dict[str, Array], of: str, keep: bool) -> AdoptedModel:
    """What a model of anybody's class estimates, and its torques of pathways for the ensemble of this digest."""
    content = None
    if keep:
        with suppress(Exception):  # then it predicts for this ensemble only
            content = cloudpickle.dumps(model.found if isinstance(model, AdoptedModel) else model)
    told = model.diagnostics
    return AdoptedModel(
        method=str(model.method),
        sampling_rate=float(model.sampling_rate),
        time=np.array(model.time),
        estimates={str(name): _worked_out(each) for name, each in model.estimates.items()},
        coordinates={str(name): np.array(values) for name, values in model.coordinates.items()},
        diagnostics=Diagnostics(float(told.parameters), warnings=tuple(map(plain_text, told.warnings))),
        found=content,
        torques=torques,
        of=of,
    )


def _worked_out(estimate: Estimate) -> Estimate:
    error = estimate.standard_error
    if error is not None:
        error = StandardError(np.array(error.values), np.array(error.freedom), float(error.arc), str(error.absent))
    return Estimate(np.array(estimate.values), str(estimate.unit), tuple(map(str, estimate.axes)), error)
