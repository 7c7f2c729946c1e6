"""Choose the stiffness to report, and judge how far it can be trusted.

The command line, pages, notebooks, sheet and explorer show this answer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Literal, TypeAlias

import attrs
import numpy as np

from tvsysid.errors import without_quality_warnings
from tvsysid.methods.adaptive.model import AdaptiveModel, describe_changes
from tvsysid.methods.base import Method
from tvsysid.models import Model
from tvsysid.numerics.bands import half_width, mean_of
from tvsysid.quality import Diagnosis, Finding
from tvsysid.recommendation.method import (
    MIN_FEEDBACK_PERCENT,
    MIN_INFORMATION,
    RECORD_REFERENCE,
    Recommendation,
)
from tvsysid.signals import Array, Ensemble

CRITICAL_VALUE = 1.96  # standard deviations within which 95 % of methods would lie
MIN_STIFFNESS = 1.0  # N·m/rad, of any joint
MAX_DELAY_MS = 4.0  # a shorter delay hardly changes the stiffness
MAX_SPREAD = 0.25  # of the mean stiffness; at most 0.1 in 50 sound simulated joints
MAX_REASONS = 3
UNPREDICTED = (
    "The model predicts none of the torque of held-out realizations. Check the channels (--angle, "
    "--torque), or record more."
)
POSSIBLE_LOOP = (
    "Movement after the torque predicts {:.1f} % of it. This is too little for a fault, but if the "
    f"actuator is compliant, noise moves the joint and stiffness is too low. {RECORD_REFERENCE}, "
    "and name it (--channel)."
)
WIDE_SPREAD = (
    "Methods differ by ± {:.1f} N·m/rad, over a quarter of the stiffness: they do not all describe "
    "this joint. State this difference beside the band, and see which methods agree (--method all)."
)
Trust: TypeAlias = Literal["good", "doubtful", "none"]


@attrs.frozen(eq=False, repr=False)
class Answer:
    """Stiffness to report, how far it can be trusted, and why not further.

    Parameters
    ----------
    label, model
        Label of the method whose stiffness is stated, and its model: a recommended one, or
        ``adaptive``, or the one that predicts held-out realizations best.
    is_recommended
        Whether the data recommend this method. ``adaptive`` always counts as recommended.
    trust
        ``"good"``, ``"doubtful"``, or ``"none"`` if no stiffness is stated.
    reasons
        At most three sentences, the worst first: what is wrong, and the option that mends it.
    vaf
        Mean VAF of held-out realizations in %, by label. NaN if unknown.
    spread
        How far methods differ, in N·m/rad at each time, shape (time,). See :func:`model_spread`.
    """

    label: str
    model: Model
    is_recommended: bool
    trust: Trust
    reasons: tuple[str, ...]
    vaf: Mapping[str, float]
    spread: Array

    @property
    def is_stated(self) -> bool:
        """Whether a stiffness is stated."""
        return self.trust != "none"

    @property
    def stiffness(self) -> Array:
        """Stiffness in N·m/rad, shape (time,); NaN if none is stated."""
        return self.model.stiffness if self.is_stated else np.full(len(self.model.time), np.nan)

    @property
    def half_band(self) -> float:
        """Half width of the stiffness's 95 % band, mean over time. NaN without one."""
        return mean_of(half_width(self.model.band("stiffness")))

    @property
    def difference(self) -> float:
        """Mean of the ``spread`` over time in N·m/rad. NaN if unknown."""
        return mean_of(self.spread)

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """Sentences that state the stiffness, or say why none is stated."""
        if not self.is_stated:
            first, *others = self.reasons
            return (f"no stiffness is stated. {first}", *others)
        role = "recommended" if self.is_recommended else ""
        role = "doubtful" if self.trust == "doubtful" else role
        prefix = f"{role} ({self.label})" if role else self.label
        lines, known = [], self.stiffness[np.isfinite(self.stiffness)]
        scheduled = self.model.estimates.get("scheduled_stiffness")
        if scheduled is not None:
            (variable,), band = scheduled.axes, half_width(scheduled.band())
            at = self.model.coordinates[variable]
            values = (
                f"{scheduled.values[each]:.1f} ± {band[each]:.1f} at {at[each]:.3g}"
                for each in (0, len(at) // 2, -1)
            )
            over = f"stiffness over {variable}: {', '.join(values)} (N·m/rad, ± 95 % band)"
            lines, prefix = [f"{prefix}: {over}"], "over time"
        if known.size:
            name = "" if lines else "stiffness "
            text = f"{known.mean():.1f} N·m/rad"
            if known.min() < known.max():
                text = (
                    f"{known.min():.1f} to {known.max():.1f} N·m/rad, {known.mean():.1f} on average"
                )
            lines.append(f"{prefix}: {name}{text}, {self._band_text()}")
        elif not lines:
            lines = [f"{self.label} estimates no stiffness over time"]
        return (*lines, *self.reasons)

    @property
    def changes(self) -> tuple[str, ...]:
        """Sentences on switches and a reflex, if the model is one of ``adaptive``."""
        if not (self.is_stated and isinstance(self.model, AdaptiveModel)):
            return ()
        return tuple(describe_changes(self.model))

    def _band_text(self) -> str:
        """Return the band and the spread of methods in words."""
        band, spread = self.half_band, self.difference
        error = self.model.estimates["stiffness"].standard_error
        why = f" ({error.absent})" if error and error.absent else ""
        noise = f"95 % band ± {band:.1f}" if math.isfinite(band) else f"without a band{why}"
        return f"{noise}; methods differ by ± {spread:.1f}" if math.isfinite(spread) else noise

    def __repr__(self) -> str:
        return "\n".join(self.lines)


def answer(
    ensemble: Ensemble,
    methods: Mapping[str, Method],
    models: Mapping[str, Model],
    recommendation: Recommendation,
    held_out_vaf: Mapping[str, Array],
) -> Answer:
    """Choose the method to report, and judge how far its stiffness can be trusted.

    Parameters
    ----------
    ensemble
        Ensemble that was identified.
    methods, models
        Methods, and models of those that succeeded, by label.
    recommendation
        Recommended methods, with measures and diagnosis of the data.
    held_out_vaf
        VAF of held-out realizations in %, by label, each of shape (realization,).
    """
    suited = recommendation.select({label: methods[label] for label in models})
    adaptive = [label for label, each in models.items() if isinstance(each, AdaptiveModel)]
    vafs = {
        name: _known_vaf(each, held_out_vaf.get(name, np.array([])))
        for name, each in models.items()
    }
    means = {name: mean_of(each) for name, each in vafs.items()}
    best = max(means, key=lambda name: np.nan_to_num(means[name], nan=-np.inf))
    label = [*suited, *adaptive, best][0]
    method, model = methods[label], models[label]
    typical = float(np.median(vafs[label]))
    spread = model_spread(ensemble, methods, models, label, means)
    trust, reasons = judge_trust(
        model, method, recommendation, label in suited, typical, mean_of(spread)
    )
    return Answer(label, model, label in [*suited, *adaptive], trust, reasons, means, spread)


def _known_vaf(model: Model, held_out: Array) -> Array:
    """Return the finite held-out VAFs or, if there are none, the VAF of the method's own folds."""
    known = held_out[np.isfinite(held_out)]
    return known if known.size else np.array([model.diagnostics.details.get("vaf_folds", np.nan)])


def model_spread(
    ensemble: Ensemble,
    methods: Mapping[str, Method],
    models: Mapping[str, Model],
    label: str,
    vaf: Mapping[str, float],
) -> Array:
    r"""Return how far methods differ from one of them in N·m/rad, shape (time,).

    .. math:: s(t) = 1.96 \max_m \sqrt{\frac{w_m}{w_m + w}} \, |K_m(t) - K(t)|,
              \quad w_m = \frac{1}{100 - VAF_m}

    Here, :math:`K` is the stiffness by the method ``label``, and :math:`w` its weight. A method
    weighs more if it predicts more of the held-out torque. The stiffness of a method that takes the
    joint as constant is compared with the mean of :math:`K`. If the method ``label`` finds a
    reflex, its reflex torque is subtracted before methods with one pathway identify the stiffness.
    A method whose VAF is unknown has no weight.
    The spread is never less than the half width of the stiffness's 95 % band, since a smaller
    difference is noise. NaN where no other method has an estimate.
    """
    own, without_reflex = models[label], ensemble
    pathways = own.pathways(ensemble) if is_reflex_detected(own) else {}
    if "reflex" in pathways:
        torque = ensemble.torque.copy()
        torque[:, ensemble.core] -= np.nan_to_num(pathways["reflex"])
        without_reflex = attrs.evolve(ensemble, torque=torque)
    weights = {name: np.nan_to_num(1 / max(100 - each, 1e-9)) for name, each in vaf.items()}
    spread = np.full(len(own.time), np.nan)
    for name, model in models.items():
        stiffness = model.stiffness
        if name == label or not weights[name]:
            continue
        if "reflex" in pathways and has_one_pathway(methods[name], model):
            with without_quality_warnings():
                stiffness = methods[name].identify(without_reflex).stiffness
        difference = stiffness - own.stiffness
        if methods[name].time_invariant:
            difference = np.full(len(difference), mean_of(difference))
        share = weights[name] / (weights[name] + weights[label])
        spread = np.fmax(spread, CRITICAL_VALUE * math.sqrt(share) * abs(difference))
    return np.maximum(spread, np.nan_to_num(half_width(own.band("stiffness"))))


def judge_trust(
    model: Model,
    method: Method,
    recommendation: Recommendation,
    is_suited: bool,
    held_out_vaf: float,
    spread: float = math.nan,
) -> tuple[Trust, tuple[str, ...]]:
    """Judge how far the stiffness of a model can be trusted, and give the reasons for doubt.

    Parameters
    ----------
    model, method
        Model, and the method that identified it.
    recommendation
        Recommended methods, with measures and diagnosis of the data.
    is_suited
        Whether the method is a recommended one.
    held_out_vaf
        Median VAF of held-out realizations by the method in %.
    spread
        Mean over time of how far methods differ in N·m/rad.
    """
    measured, diagnosis = recommendation.measured, recommendation.diagnosis
    faults = diagnosis.findings if isinstance(diagnosis, Diagnosis) else ()
    has_reference = any(item.kind == "reference" for item in method.inputs)
    unnamed = () if has_reference else recommendation.unnamed_references
    loop = [] if has_reference else _reasons(faults, "closed loop")
    wrong = _invalidating_fault(model, faults)
    # With a wrong period, any channel seems to move the joint.
    if all(each.name != "wrong-period" for each in faults):
        wrong = [*unnamed, *wrong]
    if not (is_suited or unnamed):  # an unnamed reference explains the loop already
        wrong += loop
    # In a closed loop, the right impedance may predict none of the torque. With a reference, the
    # stiffness is therefore refused only if the data hold too little information for any method.
    if not wrong and (not has_reference or measured.information < MIN_INFORMATION):
        if not recommendation.suited:
            wrong = [sentence(recommendation.why)]
        elif held_out_vaf <= 0:
            wrong = [UNPREDICTED]
    if wrong:
        return "none", tuple(wrong[:MAX_REASONS])
    reflexes = [
        f"Part of this stiffness is a stretch reflex: {each.what}. {each.fault.remedy}."
        for each in faults
        if each.name == "reflex" and has_one_pathway(method, model)
    ]
    reasons, cautions = [*loop, *reflexes, *_reasons(faults, "serious", "doubtful")], []
    if not has_reference:
        if measured.is_biased and not is_suited:
            first = recommendation.suited[0]
            reasons.insert(0, f"{sentence(recommendation.why)} Identify by --method {first}.")
        elif measured.feedback > MIN_FEEDBACK_PERCENT:
            cautions = [POSSIBLE_LOOP.format(measured.feedback)]
        band = 2 * mean_of(half_width(model.band("stiffness")))
        if spread > np.fmax(MAX_SPREAD * mean_of(model.stiffness), band):
            reasons.insert(0, WIDE_SPREAD.format(spread))
    return "doubtful" if reasons else "good", (*reasons, *cautions)[:MAX_REASONS]


def _invalidating_fault(model: Model, faults: Iterable[Finding]) -> list[str]:
    """Return at most one fault that makes every method wrong: the one that explains the others.

    Angles in degrees that are read as radians make a joint 57 times too soft. If its mean stiffness
    times 57 is plausible, the angle's unit is the fault. Otherwise, channels are swapped, or
    the torque is another signal.
    """
    invalid = [each for each in faults if each.fault.severity == "invalid"]
    units = [each.name for each in invalid[:2]] == ["torque-unit", "angle-unit"]
    if units and math.degrees(invalid[0].value) > MIN_STIFFNESS:
        del invalid[0]
    if not invalid and (mean := mean_of(model.stiffness)) < 0:
        what = f"the mean stiffness is {mean:.3g} N·m/rad"
        invalid = [Finding("reversed-torque", mean, what)]
    return _reasons(invalid[:1], "invalid")


def _reasons(faults: Iterable[Finding], *severities: str) -> list[str]:
    """Return each fault of these severities, its evidence and its remedy as sentences.

    Faults of one severity are in the order of the diagnosis: causes before effects.
    """
    return [
        f"{each.fault.title}: {each.what.partition(';')[0]}. {sentence(each.fault.remedy)}"
        for severity in severities
        for each in faults
        if each.fault.severity == severity
        and (each.name != "delay" or abs(each.value) > MAX_DELAY_MS)
    ]


def sentence(text: str) -> str:
    """Return a text with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}."


def has_one_pathway(method: Method, model: Model) -> bool:
    """Return whether a model has no reflex pathway, so that its stiffness includes a reflex."""
    return "reflex" not in method.pathway_names and "reflex_gain" not in model.estimates


def is_reflex_detected(model: Model) -> bool:
    """Return whether the data support the reflex pathway of a model; True if it is not tested."""
    return bool(model.diagnostics.details.get("reflex_detected", True))
