"""Names of scenarios, methods and units in figures and in the report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any

from tvsysid.errors import printable

if TYPE_CHECKING:
    import pandas as pd

PROFILES = {
    "square": "square-wave stiffness",
    "sine": "sinusoidal stiffness",
    "constant": "constant stiffness",
}
PERTURBATIONS = {"noise": "filtered noise", "prbs": "PRBS"}
TRAITS = ("system", "profile", "perturbation", "duration_s", "snr_db", "viscosity")
"""Settings in which scenarios differ."""
UNREMARKABLE = {("system", "joint"), ("viscosity", "constant")}


def perturbation_name(perturbation: object) -> str:
    """Return the name of a perturbation: the package's own in words, others as they are."""
    return PERTURBATIONS.get(str(perturbation), str(perturbation))


def count(number: int, word: str) -> str:
    """Return a number with its noun, as in "3 trials"."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def trait(name: str, value: object) -> str:
    """Return a short text for one trait of a scenario, like "40 s", "PRBS", "b covarying"."""
    if name == "duration_s":
        return f"{value:g} s"
    if name == "snr_db":
        return "no noise" if value == float("inf") else f"{value:g} dB"
    if name == "viscosity":
        return f"b {value}"
    return "PRBS" if value == "prbs" else str(value)


def differing(traits: pd.DataFrame) -> list[str]:
    """Return a text for each row: traits, and settings of the system, that not all rows share."""
    parts = [
        [
            *re.split(r"[:,](?![^(]*\))", str(each["system"])),
            *(trait(name, each[name]) for name in TRAITS[1:]),
        ]
        for each in traits.to_dict("records")
    ]
    shared = set.intersection(*map(set, parts))
    texts = (", ".join(each for each in own if each not in shared) for own in parts)
    return [text.replace("_", " ") for text in texts]


def described(scenario: Mapping[Any, Any]) -> str:
    """Describe a scenario from its traits.

    Viscosity is mentioned only where it varies with stiffness.
    """
    full = {**PROFILES, **PERTURBATIONS, "covarying": "viscosity that varies with stiffness"}
    return ", ".join(
        full.get(str(scenario[name]), trait(name, scenario[name]))
        for name in TRAITS
        if (name, scenario[name]) not in UNREMARKABLE
    )


def wrapped(label: str, width: int = 20, rows: int = 4) -> str:
    """Break a label into lines of limited length, behind its punctuation if possible."""
    wrapper = TextWrapper(width, max_lines=rows, placeholder="…", break_on_hyphens=False)
    wrapper.wordsep_simple_re = re.compile(r"(?<=[:,(=])( *)")
    return wrapper.fill(printable(label))


def unit_name(unit: str) -> str:
    """Return an SI unit for print: "N m s/rad" as "N·m·s/rad", "kg m2" as "kg·m²"."""
    return "–" if unit in ("", "1") else unit.replace(" ", "·").replace("2", "²")
