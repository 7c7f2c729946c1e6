"""Judge how far an identified stiffness can be trusted, and give reasons for doubt."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple

import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.methods.base import Method
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Finding
from tvsysid.recommendation.recommendation import POSSIBLE_LOOP, Recommendation
from tvsysid.recommendation.rules import NOISE_BIAS, SLOW_NOISE, holds
from tvsysid.signals import Array

MAX_NEGATIVE_PERCENT = 2.5  # of the time: a 95 % band lies below the truth this often by chance
MIN_STIFFNESS = 1.0  # N·m/rad, of any joint
MAX_DELAY_MS = 4.0  # a shorter delay hardly changes the stiffness
# Faults that make the stiffness doubtful, the worst first.
DOUBTFUL = (
    "clipped-angle",
    "clipped-torque",
    "sampling-rate",
    "narrow-excitation",
    "weak-answer",
    "slow-answer",
    "delay",
    "drift",
    "scattered-realizations",
    "misaligned-realizations",
    "mean-angle",
    "mean-torque",
    "lost-torque",
    "gaps",
    "mains",
)
# Faults that make every method's stiffness wrong, and those that do so without a reference.
WRONG = ("same-channel", "torque-unit", "angle-unit", "reversed-torque", "wrong-period")
LOOP = ("loop-bias", "feedback")
EFFECTS_OF_UNIT = {"angle-unit", "reversed-torque"}
UNPREDICTED = (
    "The model predicts none of the torque of held-out realizations. Check the channels (--angle, "
    "--torque), or record more."
)


class Trust(NamedTuple):
    """Level of trust in a stiffness, and reasons for doubt or caution.

    At the level ``"none"`` no stiffness is stated.
    """

    level: Literal["good", "doubtful", "none"]
    reasons: tuple[str, ...] = ()


def trust_in(
    model: Model,
    method: Method,
    recommendation: Recommendation,
    is_suited: bool,
    held_out_vaf: Array,
) -> Trust:
    """Judge how far the stiffness of a model can be trusted.

    Parameters
    ----------
    model, method
        Model, and the method that identified it.
    recommendation
        Recommended methods, with measures and diagnosis of the data.
    is_suited
        Whether the method is a recommended one.
    held_out_vaf
        VAF of held-out realizations by the method in %, shape (realization,). If it is empty, the
        VAF of held-out folds in the model's diagnostics is used, if there is one.
    """
    known = held_out_vaf[np.isfinite(held_out_vaf)]
    folds = model.diagnostics.details.get("vaf_folds", math.nan)
    typical_vaf, mean = np.median(known) if known.size else folds, mean_of(model.stiffness)
    measured, diagnosis = recommendation.measured, recommendation.diagnosis
    faults = {} if diagnosis is None else {each.name: each for each in diagnosis.findings}
    has_reference = any(item.kind == "reference" for item in method.inputs)
    unnamed = recommendation.unnamed_references
    loop = [] if has_reference else [_reason(faults[name]) for name in LOOP if name in faults]
    wrong = [_reason(faults[name]) for name in WRONG if name in faults.keys() - _effects(faults)]
    if mean < 0 and not wrong:
        what = f"the mean stiffness is {mean:.3g} N·m/rad"
        wrong = [_reason(Finding("reversed-torque", mean, what))]
    # With a wrong period, any channel seems to move the joint.
    if not has_reference and "wrong-period" not in faults:
        wrong = [*unnamed, *wrong]
    if not (is_suited or unnamed):
        wrong += loop
    # In a closed loop, the right impedance may predict none of the torque. A method with a
    # reference is therefore judged only where the data hold too little information for any method.
    if not wrong and (not has_reference or holds("information < 2", measured)):
        if not recommendation.suited:
            wrong = [sentence(recommendation.why)]
        elif typical_vaf <= 0:
            wrong = [UNPREDICTED]
    if wrong:
        return Trust("none", tuple(wrong))
    doubts = [*loop, *_doubts(model, method, faults)]
    cautions = [sentence(POSSIBLE_LOOP)] * (recommendation.possible_loop and not has_reference)
    is_biased = holds(SLOW_NOISE, measured) and holds(NOISE_BIAS, measured)
    if is_biased and not (is_suited or has_reference):
        first = recommendation.suited[0]
        doubts.insert(0, f"{sentence(recommendation.why)} Identify by --method {first}.")
        cautions = []
    return Trust("doubtful" if doubts else "good", (*doubts, *cautions))


def _effects(faults: Mapping[str, Finding]) -> set[str]:
    """Return the faults that are effects of another fault, if the stiffness is impossible.

    Angles in degrees that are read as radians make a joint 57 times too soft. Swapped channels, or
    another signal in place of the torque, make it much softer.
    """
    if "torque-unit" not in faults:
        return set()
    is_degrees = math.degrees(faults["torque-unit"].value) > MIN_STIFFNESS
    return {"torque-unit"} if "angle-unit" in faults and is_degrees else EFFECTS_OF_UNIT


def _reason(found: Finding) -> str:
    """Return what was found and what to do, as sentences."""
    what = found.what.partition(";")[0]
    return f"{found.fault.title}: {what}. {sentence(found.fault.remedy)}"


def _doubts(model: Model, method: Method, faults: Mapping[str, Finding]) -> Iterator[str]:
    """Yield a text for each fault that may make the stiffness wrong, with its remedy."""
    if share := negative_reflex(model):
        yield (
            f"The reflex gain is negative over {share}. No stretch reflex has a negative gain. The "
            "difference from a method with one pathway (kbr) is an uncertainty of this stiffness."
        )
    if "reflex" in faults and has_one_pathway(method, model):
        reflex = faults["reflex"]
        yield f"Part of this stiffness is a stretch reflex: {reflex.what}. {reflex.fault.remedy}."
    for found in (faults[name] for name in DOUBTFUL if name in faults):
        if found.name != "delay" or abs(found.value) > MAX_DELAY_MS:
            yield _reason(found)


def sentence(text: str) -> str:
    """Return a text as a sentence."""
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}."


def has_one_pathway(method: Method, model: Model) -> bool:
    """Return whether a model has no reflex pathway, so that its stiffness includes a reflex."""
    return "reflex" not in method.pathway_names and "reflex_gain" not in model.estimates


def reflex_shown(model: Model) -> bool:
    """Return whether the data support the reflex pathway of a model."""
    return bool(model.diagnostics.details.get("reflex_shown", True))


def negative_reflex(model: Model) -> str:
    """Return the share of the time with a negative reflex gain, in words. Empty if none."""
    gain = model.estimates.get("reflex_gain")
    if gain is None or gain.unit != UNITS["reflex_gain"] or not reflex_shown(model):
        return ""
    upper = gain.limits()[1]
    share = 100 * mean_of(np.where(np.isfinite(upper), upper < 0, np.nan))
    is_often = share > MAX_NEGATIVE_PERCENT
    return f"{share:.0f} % of the time, with its whole 95 % band" if is_often else ""
