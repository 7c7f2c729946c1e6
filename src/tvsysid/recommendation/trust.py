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
REVERSED = (
    "No joint has a negative stiffness. The torque's sign is probably reversed: add --torque-sign "
    "-1 (in Python torque_sign=-1), or leave it out if it is there. If the sign is right, the "
    "actuator is compliant: record its command."
)
WRONG = {  # faults that make every method's stiffness wrong, causes before their consequences
    "same-channel": "Angle and torque are one signal. Name two channels: --angle, --torque.",
    "too-soft": "No joint is so soft: {what}. Angle and torque may be swapped, or one may be "
    "another signal (--angle, --torque). Or leave out --torque-unit Nmm, if it is there.",
    "too-stiff": "No joint is so stiff: {what}. Leave out --angle-unit deg, if it is there. Or add "
    "--torque-unit Nmm.",
    "angle-unit": "The movement is too large for radians: {what}. Read degrees with --angle-unit "
    "deg.",
    "reversed-torque": REVERSED,
    "wrong-period": "The movement does not repeat with this period: {what}. Cut this way, changes "
    "of stiffness cancel out. Check --period and --rate.",
}
LOOP = {  # faults that make the stiffness wrong unless the method has a reference
    "loop-bias": "The torque moves the angle (a closed loop): {what}.",
    "feedback": "Noise in the torque moves the angle (a closed loop), which biases every method, "
    "or one channel was filtered alone. Record the actuator's command, and identify with it: "
    "--channel command=… --method kbr:reference=command,weighting=residual.",
}
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
    typical_vaf = np.median(known) if known.size else folds
    measured, diagnosis = recommendation.measured, recommendation.diagnosis
    faults = {} if diagnosis is None else {each.name: each for each in diagnosis.findings}
    has_reference = any(item.kind == "reference" for item in method.inputs)
    unnamed, loop = recommendation.unnamed_references, _described(LOOP, faults)
    wrong = _described(WRONG, _with_one_cause(faults))
    if not wrong and mean_of(model.stiffness) < 0:
        wrong.append(REVERSED)
    if has_reference:
        loop = []
    elif "wrong-period" not in faults:  # with a wrong period, any channel seems to move the joint
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


def _with_one_cause(faults: Mapping[str, Finding]) -> dict[str, Finding]:
    """Return the faults, with one cause of an impossible stiffness.

    Angles in degrees that are read as radians make a joint 57 times too soft. Swapped channels, or
    another signal in place of the torque, make it much softer.
    """
    if "torque-unit" not in faults:
        return dict(faults)
    size = faults["torque-unit"].value
    if "angle-unit" in faults and math.degrees(size) > MIN_STIFFNESS:
        return {name: each for name, each in faults.items() if name != "torque-unit"}
    explained = ("torque-unit", "angle-unit", "reversed-torque")
    others = {name: each for name, each in faults.items() if name not in explained}
    return others | {"too-stiff" if size > MIN_STIFFNESS else "too-soft": faults["torque-unit"]}


def _described(texts: Mapping[str, str], faults: Mapping[str, Finding]) -> list[str]:
    """Return the texts for the faults that were found."""
    return [text.format(what=faults[name].what) for name, text in texts.items() if name in faults]


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
            what = found.what.partition(";")[0]
            yield f"{found.fault.title}: {what}. {sentence(found.fault.remedy)}"


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
