"""The table of rules by which a method is recommended."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

FEW_HARMONICS = 3
REFERENCE, IS_SLOW = "reference={reference}", "slow noise > 10"
IS_STRONG = "signal-to-noise ratio < 3"
BY_VARIABLE = ("lpvkbi:variable={scheduling}", "lpv:variable={scheduling}")
WEIGHTED = "kbr:weighting=residual,tuned=true"

Measured = Mapping[str, tuple[float, str]]  # value and unit by property


class Rule(NamedTuple):
    """A row of the decision table: the first whose conditions all hold decides.

    ``conditions`` are ``property > limit`` or ``property < limit``, in the property's unit. The
    first of the ``methods``, as typed on the command line, that applies is recommended; there is
    none where none is right. ``why`` is a sentence, with values of properties in it;
    ``scenario`` is the kind of data in ``benchmarks/recommend.py`` that shows it, empty where
    none does.
    """

    conditions: tuple[str, ...]
    methods: tuple[str, ...]
    why: str
    scenario: str


LOOP = "noise in the torque moves the angle (a closed loop)"
FOLLOWS = "the joint follows {scheduling!r}, which was recorded and differs between realizations"
RULES = (
    Rule(
        ("scheduling variable > 0", "reflex held out < 0.1"),
        (f"{BY_VARIABLE[0]},reflex=false", *BY_VARIABLE),
        f"{FOLLOWS}; a reflex does not predict what is held out better",
        "follows a variable",
    ),
    Rule(("scheduling variable > 0",), BY_VARIABLE, FOLLOWS, "follows a variable"),
    Rule(
        ("wrong period > 0",),
        (),
        "the behaviour does not repeat every {duration:g} s, so that its time variation averages "
        "out whatever the "
        "method; cut with the true period, if it has one",
        "",
    ),
    Rule(
        ("information < 2",),
        (),
        "the torque that answers the angle is too weak for a stiffness over time (as "
        "{information:.1f} realizations at "
        "0 dB): perturb more, or record more",
        "weak excitation",
    ),
    Rule(
        ("loop bias > 5", IS_SLOW),
        (
            f"kbr:{REFERENCE},weighting=residual,tuned=true",
            f"kbr:{REFERENCE},weighting=residual",
            f"birf:{REFERENCE}",
        ),
        f"{LOOP}, of which {{reference!r}} is free; it is slow, and frequencies count by how "
        "little of it they hold",
        "loop with a reference",
    ),
    Rule(
        ("loop bias > 5", "switches > 0", "shape over level > 1"),
        ("adaptive",),
        f"{LOOP}, which makes stiffness {{loop bias:.0f}} % too low or high; methods that take "
        f"{{reference!r}} for "
        "reference smear its switches, which costs more",
        "loop with a reference",
    ),
    Rule(
        ("loop bias > 5",),
        (f"birf:{REFERENCE},tuned=true", f"birf:{REFERENCE}", f"kbr:{REFERENCE}"),
        f"{LOOP}, of which {{reference!r}} is free",
        "loop with a reference",
    ),
    Rule(
        ("feedback > 0", "reference > 0"),
        (f"kbr:{REFERENCE},weighting=residual", f"birf:{REFERENCE}"),
        f"{LOOP}, of which {{reference!r}} is free",
        "",
    ),
    Rule(
        ("feedback > 0",),
        (),
        f"{LOOP}, which biases them all, and no reference is named: record the disturbance or the "
        "actuator's command",
        "loop without a reference",
    ),
    Rule(
        ("mean stiffness < 0",),
        (),
        "stiffness is negative ({mean stiffness:.0f} N·m/rad). If the actuator imposes the angle, "
        "the torque's sign is "
        "reversed: read it with --torque-sign -1 (in Python torque_sign=-1), or without that; if "
        "it gives way, noise "
        "moves the angle more than the perturbation does: record the actuator's command",
        "loop without a reference",
    ),
    Rule(  # before what tells a loop by frequencies, of which a reflex answers some
        ("reflex > 0",),
        ("adaptive", "cascade"),
        "a stretch reflex is shown, and it takes that out of the stiffness (cascade says more of "
        "the reflex itself)",
        "reflex",
    ),
    Rule(
        (IS_SLOW, "noise bias > 30"),
        (),
        f"stiffness is {{noise bias:.0f}} % lower by all frequencies than by those of little "
        f"noise, so that {LOOP}; "
        "no method is free of it: record the disturbance or the actuator's command",
        "loop without a reference",
    ),
    Rule(
        (IS_SLOW, "noise bias > 10"),
        (
            "kbr:weighting=residual",
        ),  # tuned, it may leave out the inertia, which predicts better and is biased
        f"stiffness is {{noise bias:.0f}} % lower by all frequencies than by those of little "
        f"noise, so that {LOOP}; "
        "these count most",
        "loop without a reference",
    ),
    Rule(
        ("realizations > 5", "switches > 0"),
        ("adaptive", "kbr:tuned=true"),
        "stiffness switches, which it places and other methods smear",
        "fast change",
    ),
    Rule(
        (IS_SLOW, "realizations > 3"),
        (WEIGHTED, "adaptive"),
        "the torque's noise is slow, and frequencies count by how little of it they hold; "
        "stiffness does not switch",
        "slow noise",
    ),
    Rule(
        ("evidence of few harmonics > 5",),
        ("birf:tuned=true", "adaptive", "kbr"),
        f"stiffness changes as at most {FEW_HARMONICS} harmonics of the period, which the "
        "evidence prefers to other "
        "functions by {evidence of few harmonics:.0f} nat; few coefficients have the least random "
        "error",
        "slow change, few realizations, short record",
    ),
    Rule(
        ("constant > 50",),
        ("birf:tuned=true", "adaptive", "kbr"),
        "stiffness is most probably constant ({constant:.0f} %), and of a single coefficient the "
        "random error is least",
        "slow change",
    ),
    Rule(
        ("realizations < 4",),
        ("cascade", "kbr"),
        "realizations are too few to tell a switch from noise, and it finds how smooth stiffness "
        "is without them",
        "few realizations",
    ),
    Rule(
        (),
        ("adaptive", "kbr:tuned=true", "kbr"),
        "the behaviour repeats, and it finds from the data how fast stiffness changes, and "
        "whether it switches",
        "fast change, short record, few realizations",
    ),
)
ONE_PATHWAY = ("eirf", "sds", "esm", "birf", "kbr")
AGAINST = (  # a condition, the methods against which it speaks, and what it says
    (
        "scheduling variable > 0",
        ("adaptive", *ONE_PATHWAY),
        "It takes all realizations as alike; {scheduling!r} differs between them.",
    ),
    (
        "shape over level > 1",
        ("sds", "esm", "birf", "kbr"),
        "It smears a switch, of which stiffness has {switches:.0f}, and that costs more than the "
        "loop.",
    ),
    (
        "loop bias > 5",
        ("adaptive", *ONE_PATHWAY),
        "It takes the angle as imposed, which makes its stiffness {loop bias:.0f} % too low or "
        "high.",
    ),
    (
        "reflex > 0",
        ONE_PATHWAY,
        "It takes the reflex, which explains {reflex:.1f} % of the torque, for stiffness.",
    ),
    (
        "information < 500",
        ("eirf",),
        "It takes each time by itself, and these data are worth no more than {information:.0f} "
        "realizations at 0 dB.",
    ),
    (
        "switches > 0",
        ("sds", "esm", "birf", "kbr"),
        "It smears a switch, of which stiffness has {switches:.0f}.",
    ),
    (
        "noise bias > 10",
        ("adaptive", "sds", "esm", "birf"),
        "It counts frequencies that hold the noise as much as others, by which stiffness is "
        "{noise bias:.0f} % lower.",
    ),
    (
        "evidence of few harmonics > 5",
        ("adaptive",),
        "It does not know of harmonics, which the evidence prefers by {evidence of few "
        "harmonics:.0f} nat.",
    ),
)


def rule_of(measured: Measured) -> Rule:
    """First rule that holds."""
    return next(
        rule for rule in RULES if all(holds(condition, measured) for condition in rule.conditions)
    )


def holds(condition: str, measured: Measured) -> bool:
    """Whether a condition holds; of what is not known, none does."""
    name, side, limit = condition.rsplit(" ", 2)
    value = measured.get(name, (math.nan, ""))[0]
    return value > float(limit) if side == ">" else value < float(limit)
