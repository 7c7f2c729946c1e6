"""Identify one ensemble by several methods."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress

import attrs

from tvsysid.comparison.comparison import NAMED_INPUTS, Comparison
from tvsysid.comparison.preparation import PreparedRecording
from tvsysid.errors import (
    DataQualityWarning,
    InputError,
    by_cause,
    describe_error,
    without_quality_warnings,
)
from tvsysid.methods import (
    Evidence,
    Method,
    Tuned,
    centered_channels,
    expand,
    label_of,
    parse,
)
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import Model
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress, no_progress
from tvsysid.signals import Array, Ensemble


def compare(
    data: Ensemble | PreparedRecording,
    methods: Iterable[str | Method] = (),
    *,
    tune: bool = False,
    progress: Progress = no_progress,
) -> Comparison:
    """Identify one ensemble by several methods, as ``tvsysid identify`` does.

    A method that cannot serve the ensemble is skipped. One that raises an error has failed, and
    the others finish.

    Parameters
    ----------
    data
        Realizations, mean subtracted, or the result of :func:`tvsysid.prepare`. With the latter,
        the diagnosis counts gaps and mains hum, and channels of the file that drive the angle but
        were not read are named: the answer is that of ``tvsysid identify``.
    methods
        Keys with settings if need be (``"sds:window=0.2"``), ``"module:Class"``, or methods.
        ``"published"`` is the five of van de Ruit et al. (2021), ``"all"`` every method. By
        default ``adaptive``, which is recommended, and others to check it: ``sds``, ``cascade`` and
        ``sdss`` where ``adaptive`` finds a reflex, ``cascade`` where it cannot identify the
        ensemble.
    tune
        Whether each method's settings are chosen from the data first.
    progress
        Function that is called before each method with the number of methods done and of all.

    Raises
    ------
    InputError
        For an unknown method, or if every method failed or was skipped; says why.

    Warns
    -----
    DataQualityWarning
        For warnings of the methods, once for each cause.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(
    ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> tv.compare(ensemble, ["sds", "birf"]).summary()[["method", "stiffness (N·m/rad)"]].round(1)
      method  stiffness (N·m/rad)
    0    sds                 ...
    1   birf                 ...
    """
    chosen: dict[str, Method] = {}
    for item in expand(methods):
        method, label = parse(item) if isinstance(item, str) else item, label_of(item)
        if chosen.setdefault(label, method) != method:
            raise InputError(
                f"compare: two methods have the name {label}. Make their settings fields of the "
                "class, so that the name holds them"
            )
    prepared = None
    if isinstance(data, PreparedRecording):
        prepared = data.center(centered_channels(chosen.values()))
        data = prepared.ensemble
    labels = list(chosen)
    models: dict[str, Model] = {}
    predicted: dict[str, Array] = {}
    evidence: dict[str, Evidence] = {}
    skipped: dict[str, str] = {}
    failed: dict[str, str] = {}
    with single_thread(), without_quality_warnings():
        for number, label in enumerate(labels or _usual(models)):
            progress(number, len(labels) or 3)
            chosen[label] = method = chosen.get(label) or parse(label)
            try:
                if reason := reason_to_skip(method, data):
                    skipped[label] = reason
                    continue
                if isinstance(method, Tuned) or (tune and method.can_be_tuned):
                    chosen[label], evidence[label] = method.tuned(data)
                model = chosen[label].identify(data)
                predicted[label] = model.predict(data)
                models[label] = model
            except Exception as error:  # a user's method may raise anything; the others go on
                failed[label] = describe_error(error)
    if not models:
        raise InputError("; ".join(map(": ".join, {**skipped, **failed}.items())))
    warned = ((label, text) for label in models for text in models[label].diagnostics.warnings)
    for text, names in by_cause(warned).items():
        warnings.warn(f"{', '.join(names)}: {text}", DataQualityWarning, stacklevel=2)
    found = Comparison(data, chosen, models, predicted, evidence, skipped, failed)
    if prepared is None:
        return found
    inputs, diagnosis = found.inputs, None
    with suppress(InputError):  # the data are too short
        diagnosis = prepared.diagnose(inputs.get("reference"))
    unnamed = () if inputs.keys() & NAMED_INPUTS else prepared.unnamed_references()
    return attrs.evolve(found, diagnosis=diagnosis, unnamed_references=tuple(unnamed))


def _usual(models: Mapping[str, Model]) -> Iterator[str]:
    """Yield ``adaptive`` and, when ``models`` has its model, the methods that check it."""
    yield "adaptive"
    if "adaptive" not in models:
        yield "cascade"
    elif "reflex_gain" in models["adaptive"].estimates:
        yield from ("cascade", "sdss")
    else:
        yield "sds"
