"""What is measured in an ensemble to say which method suits it."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import BasisIRF, KernelRegression, Method, ScheduledImpedance
from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Diagnosis
from tvsysid.quality.resampling import lowered
from tvsysid.recommendation.rules import FEW_HARMONICS
from tvsysid.signals import Ensemble

SLOW, WIDE = (0.0, 5.0), (8.0, 25.0)  # Hz: bands whose power density of the noise is compared
MEASURES = (
    "angle RMS",
    "bandwidth of the angle",
    "signal-to-noise ratio",
    "mean stiffness",
)  # of the diagnosis
SURE = 0.95  # probability from which on a switch counts


def measured_in(
    ensemble: Ensemble,
    diagnosis: Diagnosis | None,
    reference: str | None,
    scheduling: str | None,
    model: Model | None,
) -> dict[str, tuple[float, str]]:
    """Properties that the rules ask for, and those that explain them."""
    measured = {"realizations": (float(len(ensemble)), ""), "duration": (ensemble.duration, "s")}
    if scheduling is not None:
        measured["scheduling variable"] = (1.0, "")
        measured |= _held_out(ensemble, scheduling)
    if reference is not None:
        measured["reference"] = (1.0, "")
    if diagnosis is None:
        return measured
    measured |= {name: diagnosis.measures[name] for name in MEASURES}
    information = len(ensemble) * 10 ** (measured["signal-to-noise ratio"][0] / 10)
    measured["information"] = (information, "realizations at 0 dB")
    seen = {check.name: abs(check.value) for check in diagnosis.checks if check.found}
    seen |= {
        check.name: abs(check.value) for check in diagnosis.uncertain if check.name == "loop-bias"
    }
    for name in ("reflex", "feedback", "loop-bias", "wrong-period", "scattered-realizations"):
        measured[name.replace("-", " ")] = (seen.get(name, math.nan), "%")
    measured["slow noise"] = (_slowness(diagnosis), "dB")
    low = lowered(ensemble)
    measured["noise bias"] = (_noise_bias(low), "%")
    if math.isnan(measured["reflex"][0]) and scheduling is None:
        model = model if isinstance(model, AdaptiveModel) else _model(AdaptiveRegression(), low)
        if isinstance(model, AdaptiveModel):
            measured |= _speed(model)
        measured["evidence of few harmonics"] = (_few_harmonics(low), "nat")
        if model is not None and reference is not None and not math.isnan(measured["loop bias"][0]):
            measured["shape over level"] = (shape_over_level(low, reference, model), "")
    return measured


def _model(method: Method, ensemble: Ensemble) -> Model | None:
    """What a method identifies; None where it cannot."""
    if reason_to_skip(method, ensemble):
        return None
    try:
        return method.identify(ensemble)
    except InputError:
        return None


def _held_out(ensemble: Ensemble, scheduling: str) -> dict[str, tuple[float, str]]:
    """Return how much more a reflex pathway predicts of folds held out."""
    models = [
        _model(ScheduledImpedance(scheduling, reflex=each), ensemble) for each in (False, True)
    ]
    folds = [math.nan if each is None else each.diagnostics.details["vaf_folds"] for each in models]
    return {"reflex held out": (folds[1] - folds[0], "%")}


def _slowness(diagnosis: Diagnosis) -> float:
    """Power density in dB of the noise at low frequencies over that at higher ones."""
    frequency, power = diagnosis.curves.frequency, diagnosis.curves.residual_power
    low, high = (
        float(power[(frequency > start) & (frequency <= stop)].mean())
        for start, stop in (SLOW, WIDE)
    )
    return 10 * math.log10(low / high) if low > 0 and high > 0 else math.nan


def _noise_bias(ensemble: Ensemble) -> float:
    """By how much, in per cent, stiffness is lower than where frequencies count by how little noise they hold.

    Noise that does not move the angle leaves both alike; in a closed loop, stiffness is too low
    where there is noise.
    """
    models = [_model(KernelRegression(weighting=each), ensemble) for each in ("white", "residual")]
    plain, weighted = (math.nan if each is None else mean_of(each.stiffness) for each in models)
    return 100 * (weighted - plain) / max(abs(weighted), abs(plain), math.ulp(0.0))


def _speed(model: AdaptiveModel) -> dict[str, tuple[float, str]]:
    """By how much stiffness changes, how fast, how often it surely switches, and how probably it is constant."""
    switches = sum(
        each.quantity == "stiffness" and each.probability > SURE for each in model.switches
    )
    change = float(np.nanmax(model.stiffness) - np.nanmin(model.stiffness))
    fastest = float(np.nanmax(np.abs(np.gradient(model.stiffness, model.time))))
    return {
        "switches": (float(switches), ""),
        "stiffness changes by": (change, "N·m/rad"),
        "time of the fastest change": (change / fastest if fastest > 0 else math.nan, "s"),
        "constant": (round(100 * model.diagnostics.details["constant_stiffness"], 1), "%"),
    }


def _few_harmonics(ensemble: Ensemble) -> float:
    """Log evidence, by ``birf``, of stiffness as few harmonics of the period over that as splines or Haar functions.

    Where more harmonics have more evidence, over these.
    """
    try:
        found = BasisIRF().tuned(ensemble).evidence
    except InputError:
        return math.nan
    values, harmonics = (
        found.values,
        np.array([getattr(each["basis"], "harmonics", math.inf) for each in found.tried]),
    )
    few, other = values[harmonics <= FEW_HARMONICS].max(), values[np.isinf(harmonics)].max()
    more = values[np.isfinite(harmonics) & (harmonics > FEW_HARMONICS)].max()
    return float(few - (more if more > few else other))


def shape_over_level(ensemble: Ensemble, reference: str, model: Model) -> float:
    """How stiffness by a reference differs from that of a ``model`` without: in shape, over that on average."""
    try:
        found = BasisIRF(reference=reference).tuned(ensemble).method.identify(ensemble)
    except InputError:
        return math.nan
    differs = found.stiffness - np.interp(found.time, model.time, model.stiffness)
    level = mean_of(differs)
    return math.sqrt(mean_of((differs - level) ** 2)) / abs(level) if level else math.nan
