"""Recommend a method for an ensemble: measure its properties, and apply the rules."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import (
    METHODS,
    BasisIRF,
    KernelRegression,
    ScheduledImpedance,
    Tuned,
    from_text,
    key_of,
    parse,
)
from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.methods.base import Method, reason_to_skip
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import Diagnosis, diagnose, find_reference
from tvsysid.quality.fit import lowered
from tvsysid.recommendation.rules import (
    MAX_FEW_HARMONICS,
    SLOW_NOISE,
    STRONG_NOISE,
    Measured,
    holds,
    rule_of,
)
from tvsysid.signals import Ensemble

BANDS_HZ = (0.0, 5.0), (8.0, 25.0)  # whose noise is compared
MIN_SWITCH_PROBABILITY = 0.95
FAULTS = ("reflex", "feedback", "loop-bias", "wrong-period", "scattered-realizations")
MEASURES = ("angle RMS", "bandwidth of the angle", "signal-to-noise ratio", "mean stiffness")
FAULTS_OF_RULES = ("reflex", "loop-bias", "feedback")
POSSIBLE_LOOP = (
    "the torque's noise is slow or strong. If the actuator is compliant, this noise moves the "
    "angle, and stiffness is underestimated. To check, record the actuator's command and name it "
    "as the reference"
)


@attrs.frozen(eq=False, repr=False)
class Recommendation:
    """Recommended method for an ensemble, and the reasons.

    Parameters
    ----------
    suited
        Methods as the command line takes them, as in ``"kbr:weighting=residual,tuned=true"``, the
        best first. Empty where no method is right.
    why
        Reason for the first, in a sentence.
    measured
        Value and unit of properties of the data by name. NaN if a fault is not found or the data do
        not determine a property.
    diagnosis
        Diagnosis of the ensemble. None for a single realization.
    unnamed_references
        A sentence for each channel that moves the angle and was not named as the reference.
    """

    suited: tuple[str, ...]
    why: str
    measured: Measured
    diagnosis: Diagnosis | None = None
    unnamed_references: tuple[str, ...] = ()

    @property
    def method(self) -> Method | None:
        """The method, ready to use: ``recommend(ensemble).method.identify(ensemble)``.

        None where no method is right.
        """
        return parse(self.suited[0]) if self.suited else None

    def select(self, methods: Mapping[str, Method], tuned: Container[str] = ()) -> list[str]:
        """Return the labels of the ``methods`` that suit, the best first.

        ``tuned`` are the labels of methods whose settings were chosen from the data.
        """
        return [
            label
            for text in self.suited
            for label, method in methods.items()
            if METHODS[key_of(text)] is type(method)
            and from_text(text, "method", {key_of(text): method})
            in (method, *[Tuned(method)] * (label in tuned))
        ]

    @property
    def sentence(self) -> str:
        """Method and reason."""
        return f"{self.suited[0] if self.suited else 'no method is right'}: {self.why}"

    @property
    def possible_loop(self) -> bool:
        """Whether a compliant actuator may bias the stiffness, and no reference can show it."""
        loud = any(holds(each, self.measured) for each in (SLOW_NOISE, STRONG_NOISE))
        return loud and "reference" not in self.measured

    @property
    def caveats(self) -> tuple[str, ...]:
        """Sentences about other findings, a possible closed loop, and unnamed references."""
        if self.diagnosis is None:
            single = "a single realization, or one too short, cannot be diagnosed"
            return (single, *self.unnamed_references)
        others = [each for each in self.diagnosis.findings if each.name not in FAULTS_OF_RULES]
        return (
            *(f"{each.fault.title.lower()}: {each.fault.effect}" for each in others),
            *[POSSIBLE_LOOP] * self.possible_loop,
            *self.diagnosis.remarks,
            *self.unnamed_references,
        )

    def __repr__(self) -> str:
        known = {name: each for name, each in self.measured.items() if not math.isnan(each[0])}
        measured = [f"{name} {value:.4g} {unit}".rstrip() for name, (value, unit) in known.items()]
        caveats = [f"caveat: {each}" for each in self.caveats]
        lines = [f"Recommendation: {self.sentence}", f"measured: {', '.join(measured)}"]
        return "\n".join([*lines, *caveats])


def recommend(
    ensemble: Ensemble,
    reference: str | None = None,
    scheduling: str | None = None,
    *,
    model: Model | None = None,
    diagnosis: Diagnosis | None = None,
) -> Recommendation:
    """Recommend a method for an ensemble by measured properties of the data.

    The first rule that holds decides. The page docs/which-method.md has the rules as a table, and
    how often they are right.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    reference
        Channel with the disturbance that was applied, or the actuator's command, if the angle may
        not be imposed.
    scheduling
        Channel with a variable that the joint follows and that differs between realizations.
    model
        Model of this ensemble by ``adaptive``, if there is one. Otherwise it is identified here.
    diagnosis
        Diagnosis of this ensemble with the same reference, if there is one.

    Raises
    ------
    InputError
        If it is no ensemble, or there is no such channel.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(
    ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> found = tv.recommend(tv.preprocess.subtract_mean(ensemble))
    >>> print(found.sentence)
    adaptive: stiffness switches; adaptive locates the switches, other methods smear them
    >>> found.method
    AdaptiveRegression(emg=None)
    """
    if not isinstance(ensemble, Ensemble):
        raise InputError(
            f"recommend: expected an Ensemble, got {type(ensemble).__name__}; cut a Recording first"
        )
    for name in filter(None, (reference, scheduling)):
        ensemble.signal(name)  # raises if there is no such channel
    with single_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        with suppress(InputError):  # a single realization, or too short
            diagnosis = diagnosis or diagnose(ensemble, reference)
        measured = measure(ensemble, diagnosis, reference, scheduling, model)
    rule = rule_of(measured)
    values: dict[str, Any] = {name: value for name, (value, _) in measured.items()}
    values |= {"reference": reference, "scheduling": scheduling}
    typed = (text.format(**values) for text in rule.methods)
    suited = tuple(text for text in typed if not reason_to_skip(parse(text), ensemble))
    others = ensemble.channels.keys() - {reference, scheduling} if diagnosis else ()
    return Recommendation(
        suited,
        rule.why.format(**values),
        measured,
        diagnosis,
        tuple(find_unnamed_references(ensemble, others)),
    )


def find_unnamed_references(ensemble: Ensemble, channels: Iterable[str]) -> Iterator[str]:
    """Yield a sentence for each of these channels that moves the angle as a reference does."""
    for name in channels:
        found = find_reference(ensemble, name)
        if found.found:
            yield (
                f"Channel {name!r} moves the angle, and was not named as the reference: "
                f"{found.what}."
            )


def measure(
    ensemble: Ensemble,
    diagnosis: Diagnosis | None,
    reference: str | None,
    scheduling: str | None,
    model: Model | None,
) -> dict[str, tuple[float, str]]:
    """Return value and unit of each property that the rules ask for or that explains them."""
    measured = {"realizations": (float(len(ensemble)), ""), "duration": (ensemble.duration, "s")}
    if scheduling is not None:
        gain = _or_nan(_reflex_held_out, ensemble, scheduling)
        measured |= {"scheduling variable": (1.0, ""), "reflex held out": (gain, "%")}
    if reference is not None:
        measured["reference"] = (1.0, "")
    if diagnosis is None:
        return measured
    low_rate, measures = lowered(ensemble), diagnosis.measures
    information = len(ensemble) * 10 ** (measures["signal-to-noise ratio"][0] / 10)
    found = {
        each.name: abs(each.value)
        for each in diagnosis.checks
        if each.found or (each.name == "loop-bias" and each.beyond)
    }
    measured |= {
        **{name: measures[name] for name in MEASURES},
        "information": (information, "realizations at 0 dB"),
        **{name.replace("-", " "): (found.get(name, math.nan), "%") for name in FAULTS},
        "slow noise": (_slow_noise(diagnosis), "dB"),
        "noise bias": (_or_nan(_noise_bias, low_rate), "%"),
    }
    if "reflex" in found or scheduling is not None:
        return measured
    with suppress(InputError):
        model = model or AdaptiveRegression().identify(low_rate)
    if isinstance(model, AdaptiveModel):
        changes = (each for each in model.switches if each.quantity == "stiffness")
        switches = sum(each.probability > MIN_SWITCH_PROBABILITY for each in changes)
        constant = round(100 * model.diagnostics.details["constant_stiffness"], 1)
        measured |= {"switches": (float(switches), ""), "constant": (constant, "%")}
    measured["evidence of few harmonics"] = (_or_nan(_few_harmonics, low_rate), "nat")
    return measured


def _or_nan(function: Callable[..., float], *arguments: object) -> float:
    """Return the value of a function, or NaN if a method cannot identify the data."""
    try:
        return function(*arguments)
    except InputError:
        return math.nan


def _slow_noise(diagnosis: Diagnosis) -> float:
    """Return the ratio in dB of the noise's mean power density below 5 Hz to that at 8 to 25 Hz."""
    frequency, power = diagnosis.curves.frequency, diagnosis.curves.residual_power
    bands = ((frequency > start) & (frequency <= stop) for start, stop in BANDS_HZ)
    low, high = (float(power[band].mean()) for band in bands)
    return 10 * math.log10(low / high) if low > 0 and high > 0 else math.nan


def _reflex_held_out(ensemble: Ensemble, scheduling: str) -> float:
    """Return by how many percentage points a reflex pathway raises the VAF of held-out folds."""
    without, with_reflex = (
        ScheduledImpedance(scheduling, reflex=reflex).identify(ensemble) for reflex in (False, True)
    )
    folds = [each.diagnostics.details["vaf_folds"] for each in (without, with_reflex)]
    return folds[1] - folds[0]


def _noise_bias(ensemble: Ensemble) -> float:
    """Return by how many % the stiffness rises if noisy frequencies have less weight.

    It rises in a closed loop, where noise lowers the stiffness at its frequencies. Noise that does
    not move the angle leaves it as it is.
    """
    plain, weighted = (
        mean_of(KernelRegression(weighting=weighting).identify(ensemble).stiffness)
        for weighting in ("white", "residual")
    )
    return 100 * (weighted - plain) / max(abs(weighted), abs(plain), math.ulp(0.0))


def _few_harmonics(ensemble: Ensemble) -> float:
    """Return by how much the log evidence of few harmonics exceeds that of other functions.

    The evidence is that of ``birf``. Few harmonics are compared with more harmonics, if these have
    more evidence, and otherwise with the best of splines and Haar functions.
    """
    evidence = BasisIRF().tuned(ensemble).evidence
    harmonics = [getattr(each["basis"], "harmonics", math.inf) for each in evidence.tried]
    groups = np.digitize(harmonics, [MAX_FEW_HARMONICS + 0.5, math.inf])
    few, more, other = (evidence.values[groups == group].max() for group in range(3))
    return float(few - (more if more > few else other))
