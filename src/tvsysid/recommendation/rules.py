"""Rules by which a method is recommended."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

MAX_FEW_HARMONICS = 3
SLOW_NOISE, STRONG_NOISE = "slow noise > 10", "signal-to-noise ratio < 3"
NOISE_BIAS = "noise bias > 10"
CLOSED_LOOP = "noise in the torque moves the angle (a closed loop)"
FOLLOWS = "the joint follows {scheduling!r}, which was recorded and differs between realizations"
LOWER = f"{CLOSED_LOOP}: frequencies with noise make stiffness {{noise bias:.0f}} % lower"
RECORD_REFERENCE = "Record the disturbance or the actuator's command"
BY_REFERENCE = ("kbr:reference={reference},weighting=residual", "birf:reference={reference}")
BY_VARIABLE = ("lpvkbi:variable={scheduling}", "lpv:variable={scheduling}")

Measured = Mapping[str, tuple[float, str]]  # value and unit by property


class Rule(NamedTuple):
    """Row of the decision table.

    Parameters
    ----------
    conditions
        ``property > limit`` or ``property < limit``, in the property's unit. All must hold.
    methods
        Methods as typed on the command line, the best first. Empty where no method is right.
    why
        Reason, a sentence with values of properties.
    """

    conditions: tuple[str, ...]
    methods: tuple[str, ...]
    why: str


# The first rule whose conditions all hold decides.
RULES = (
    Rule(
        ("scheduling variable > 0", "reflex held out < 0.1"),
        (f"{BY_VARIABLE[0]},reflex=false", *BY_VARIABLE),
        f"{FOLLOWS}; a reflex pathway does not predict held-out data better",
    ),
    Rule(("scheduling variable > 0",), BY_VARIABLE, FOLLOWS),
    Rule(
        ("wrong period > 0",),
        (),
        "the movement does not repeat every {duration:g} s, so every method averages changes of "
        "stiffness out. Cut with the true period, if there is one",
    ),
    Rule(
        ("information < 2",),
        (),
        "the torque that depends on the angle is too weak for a stiffness over time (worth "
        "{information:.1f} realizations at 0 dB). Perturb more, or record more",
    ),
    Rule(
        ("loop bias > 5", SLOW_NOISE),
        (f"{BY_REFERENCE[0]},tuned=true", *BY_REFERENCE),
        f"{CLOSED_LOOP}, but not {{reference!r}}. The noise is slow, and frequencies with little "
        "noise have more weight",
    ),
    Rule(
        ("loop bias > 5",),
        (f"{BY_REFERENCE[1]},tuned=true", BY_REFERENCE[1], "kbr:reference={reference}"),
        f"{CLOSED_LOOP}, but not {{reference!r}}",
    ),
    Rule(
        ("feedback > 0", "reference > 0"),
        BY_REFERENCE,
        f"{CLOSED_LOOP}, but not {{reference!r}}",
    ),
    Rule(
        ("feedback > 0",),
        (),
        f"{CLOSED_LOOP}, which biases every method, and no reference is named. {RECORD_REFERENCE}",
    ),
    Rule(
        ("mean stiffness < 0",),
        (),
        "stiffness is negative ({mean stiffness:.0f} N·m/rad). If the actuator imposes the angle, "
        "the torque's sign is reversed: read it with --torque-sign -1 (in Python torque_sign=-1), "
        "or, if you already do, without. If the actuator is compliant, noise moves the angle more "
        "than the perturbation does: record the actuator's command",
    ),
    Rule(  # before the rules on noise bias: stiffness with a reflex depends on frequency, too
        ("reflex > 0",),
        ("adaptive", "cascade"),
        "the data show a stretch reflex, and adaptive separates it from the stiffness (cascade "
        "tells more about the reflex)",
    ),
    Rule(
        (SLOW_NOISE, "noise bias > 30"),
        (),
        f"{LOWER}. Every method is biased. {RECORD_REFERENCE}",
    ),
    Rule(
        (SLOW_NOISE, NOISE_BIAS),
        ("kbr:weighting=residual",),
        f"{LOWER}. Frequencies with little noise have the most weight",
    ),
    Rule(
        ("realizations > 5", "switches > 0"),
        ("adaptive", "kbr:tuned=true"),
        "stiffness switches; adaptive locates the switches, other methods smear them",
    ),
    Rule(
        (SLOW_NOISE, "realizations > 3"),
        ("kbr:weighting=residual,tuned=true", "adaptive"),
        "the torque's noise is slow, and frequencies with little noise have more weight; stiffness "
        "does not switch",
    ),
    Rule(
        ("evidence of few harmonics > 5",),
        ("birf:tuned=true", "adaptive", "kbr"),
        f"at most {MAX_FEW_HARMONICS} harmonics of the period describe how stiffness changes: "
        "their evidence is {evidence of few harmonics:.0f} nat higher than that of others. Few "
        "coefficients have the least random error",
    ),
    Rule(
        ("constant > 50",),
        ("birf:tuned=true", "adaptive", "kbr"),
        "stiffness is probably constant ({constant:.0f} %), and a single coefficient has the least "
        "random error",
    ),
    Rule(
        ("realizations < 4",),
        ("cascade", "kbr"),
        "there are too few realizations to tell a switch from noise; cascade finds how smooth "
        "stiffness is from all of its harmonics together",
    ),
    Rule(
        (),
        ("adaptive", "kbr:tuned=true", "kbr"),
        "the behaviour repeats, and adaptive finds from the data how fast stiffness changes, and "
        "whether it switches",
    ),
)


def rule_of(measured: Measured) -> Rule:
    """Return the first rule whose conditions hold."""
    return next(rule for rule in RULES if all(holds(each, measured) for each in rule.conditions))


def holds(condition: str, measured: Measured) -> bool:
    """Return whether a condition holds. It does not if the property is unknown."""
    name, side, limit = condition.rsplit(" ", 2)
    value, _ = measured.get(name, (math.nan, ""))
    return value > float(limit) if side == ">" else value < float(limit)
