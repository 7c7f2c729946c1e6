"""How far an identified stiffness can be trusted, and why not further."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from tvsysid.estimates import UNITS
from tvsysid.methods.base import inputs_of
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Diagnosis, Finding
from tvsysid.recommendation.decide import MAY_BE_A_LOOP, Recommendation
from tvsysid.recommendation.rules import IS_SLOW, holds

CHANCE = 0.025  # share of the time over which a band of 95 % lies below its truth
MAX_DELAY_MS = 4.0  # up to which a late torque hardly changes the stiffness
# Faults that make the stiffness doubtful, the worst first.
DOUBTFUL = (
    "clipped-angle",
    "clipped-torque",
    "sampling-rate",
    "narrow-excitation",
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
    "-1 (in Python "
    "torque_sign=-1), or leave it out if it is there. If the sign is right, the actuator is "
    "compliant: record its "
    "command."
)
SWAPPED = (
    "Angle and torque are probably swapped: {angle}, and {stiffness}. Name the channels the other "
    "way round (--angle, "
    "--torque). If they are right, the angle may be in degrees: --angle-unit deg."
)
WRONG = {  # faults that make every method's stiffness wrong, the cause of others first
    "same-channel": "Angle and torque are one signal. Name two channels: --angle, --torque.",
    "angle-unit": "The movement is too large for radians: {what}. Read degrees with --angle-unit "
    "deg.",
    "torque-unit": "No joint is so stiff or so soft: {what}. Check the units: add --torque-unit "
    "Nmm, or leave out a "
    "unit that is there.",
    "reversed-torque": REVERSED,
    "wrong-period": "The movement does not repeat with this period: {what}. Cut this way, changes "
    "of stiffness cancel "
    "out. Check --period and --rate.",
}
LOOP = {  # those that a reference mends
    "loop-bias": "The torque moves the angle (a closed loop): {what}.",
    "feedback": "Noise in the torque moves the angle (a closed loop), which biases every method, "
    "or one channel was "
    "filtered alone. Record the actuator's "
    "command, and identify with it: --channel command=… --method "
    "kbr:reference=command,weighting=residual.",
}

CHECK_CHANNELS = "Check the channels (--angle, --torque), or record more."


class Trust(NamedTuple):
    """Level of trust in a stiffness, and reasons for doubt or caution.

    At the level ``"none"`` none is stated.
    """

    level: Literal["good", "doubtful", "none"]
    reasons: tuple[str, ...] = ()


def trust_in(
    model: Model,
    method: object,
    recommendation: Recommendation,
    is_suited: bool,
    diagnosis: Diagnosis | None,
    held_out_vaf: float,
    unnamed_references: Sequence[str],
) -> Trust:
    """Return how far the stiffness of a model can be trusted.

    Parameters
    ----------
    model, method
        What was identified, and by which method.
    recommendation, is_suited
        Which methods suit the data, and whether this one does.
    diagnosis
        Of the data, if there is one.
    held_out_vaf
        Typical VAF of the model in % of realizations held out; NaN if it is not known.
    unnamed_references
        A sentence for each channel that moves the angle and was not named as the reference.
    """
    faults = {} if diagnosis is None else {each.name: each for each in diagnosis.findings}
    by_reference = any(item.kind == "reference" for item in inputs_of(method))
    texts = WRONG if by_reference or is_suited or unnamed_references else WRONG | LOOP
    wrong = list(_faults(model, faults, texts, () if by_reference else unnamed_references))
    # In a closed loop, the right impedance may predict none of the torque; a weak torque is weak
    # with a reference too.
    if not wrong and (not by_reference or holds("information < 2", recommendation.measured)):
        if not recommendation.suited:
            wrong = [sentence(recommendation.why)]
        elif held_out_vaf <= 0:
            wrong = [
                "The model predicts none of the torque of held-out realizations. " + CHECK_CHANNELS
            ]
    if wrong:
        return Trust("none", tuple(wrong))
    doubts = []
    biased = not is_suited and all(
        holds(each, recommendation.measured) for each in (IS_SLOW, "noise bias > 10")
    )
    if biased and not by_reference:
        doubts.append(
            f"{sentence(recommendation.why)} Identify by --method {recommendation.suited[0]}."
        )
    if not by_reference:  # of a method that suits the data all the same
        doubts += [
            text.format(what=faults[name].what) for name, text in LOOP.items() if name in faults
        ]
    doubts += _doubts(model, method, faults)
    cautious = MAY_BE_A_LOOP in recommendation.caveats and not by_reference and not biased
    reasons = (*doubts, sentence(MAY_BE_A_LOOP)) if cautious else tuple(doubts)
    return Trust("doubtful" if doubts else "good", reasons)


def _faults(
    model: Model,
    faults: Mapping[str, Finding],
    texts: Mapping[str, str],
    unnamed_references: Sequence[str],
) -> Iterator[str]:
    """Yield which faults of the data make every method's stiffness wrong, and what to do."""
    if {"angle-unit", "torque-unit"} <= faults.keys():
        yield SWAPPED.format(angle=faults["angle-unit"].what, stiffness=faults["torque-unit"].what)
        return
    if "wrong-period" not in faults:  # with a wrong period, any channel seems to move the joint
        yield from unnamed_references
    for name, text in texts.items():
        if name in faults:
            yield text.format(what=faults[name].what)
    if mean_of(model.stiffness) < 0 and "reversed-torque" not in faults:
        yield REVERSED


def _doubts(model: Model, method: object, faults: Mapping[str, Finding]) -> Iterator[str]:
    """Yield what may make the stiffness wrong, and what to do."""
    if share := negative_reflex(model):
        yield (
            f"The reflex gain is negative over {share}, as no stretch reflex's is. The difference "
            "from a method with "
            "one pathway (as kbr) is an uncertainty of this stiffness."
        )
    if "reflex" in faults and has_one_pathway(method, model):
        yield (
            f"Part of this stiffness is a stretch reflex: {faults['reflex'].what}. "
            f"{faults['reflex'].fault.remedy}."
        )
    for fault in (faults[name] for name in DOUBTFUL if name in faults):
        if fault.name != "delay" or abs(fault.value) > MAX_DELAY_MS:
            yield (
                f"{fault.fault.title}: {fault.what.partition(';')[0]}. "
                f"{sentence(fault.fault.remedy)}"
            )


def sentence(text: str) -> str:
    """Return a text as a sentence."""
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}."


def has_one_pathway(method: object, model: Model) -> bool:
    """Return whether a model's stiffness includes a reflex, if there is one."""
    return (
        "reflex" not in getattr(method, "pathway_names", ())
        and "reflex_gain" not in model.estimates
    )


def reflex_shown(model: Model) -> bool:
    """Return whether the data show the reflex that a model has beside its stiffness."""
    return bool(model.diagnostics.details.get("reflex_shown", True))


def negative_reflex(model: Model) -> str:
    """Return over how much of the time a model's reflex gain is negative; empty if it is not."""
    gain = model.estimates.get("reflex_gain")
    if (
        gain is None
        or gain.unit != UNITS["reflex_gain"]
        or gain.standard_error is None
        or not reflex_shown(model)
    ):
        return ""
    upper = gain.band()[1]
    share = float(np.mean(upper[np.isfinite(upper)] < 0))
    return f"{100 * share:.0f} % of the time, with its whole 95 % band" if share > CHANCE else ""
