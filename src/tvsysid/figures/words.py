"""What scenarios and methods are called in pictures and in the report."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from tvsysid.errors import printable

PROFILES = {
    "square": "square-wave stiffness",
    "sine": "sinusoidal stiffness",
    "constant": "constant stiffness",
}
PERTURBATIONS = {"noise": "filtered noise", "prbs": "PRBS"}
TRAITS = ("system", "profile", "perturbation", "duration_s", "snr_db", "viscosity")
"""Settings in which scenarios differ."""


def perturbation_name(perturbation: object) -> str:
    """Return the name of a perturbation: the package's own in words, others as they are."""
    return PERTURBATIONS.get(str(perturbation), str(perturbation))


def profile_name(profile: object) -> str:
    """Return the name of a stiffness profile."""
    return PROFILES.get(str(profile), str(profile))


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


def differing(scenarios: Sequence[Mapping[str, object]]) -> list[str]:
    """Return a text for each scenario: the traits that differ, or the duration of a single one."""
    names = [name for name in TRAITS if len({scenario[name] for scenario in scenarios}) > 1] or [
        "duration_s"
    ]
    if len({str(scenario["system"]).partition(":")[0] for scenario in scenarios}) == 1:
        # Settings alone that differ tell variants of one system apart; and one that has none from
        # all others.
        settings = [
            re.split(r",(?![^(]*\))", str(scenario["system"]).partition(":")[2])
            for scenario in scenarios
        ]
        own = [
            [each for each in one if any(each not in other for other in settings)]
            for one in settings
        ]
        texts = [", ".join(each).replace("_", " ") for each in own]
        scenarios = [
            {**scenario, "system": text} for scenario, text in zip(scenarios, texts, strict=True)
        ]
    return [
        ", ".join(filter(None, (trait(name, each[name]) for name in names))) for each in scenarios
    ]


def described(scenario: Mapping[str, object], names: Sequence[str] = TRAITS) -> str:
    """Describe a scenario from its traits.

    Viscosity is mentioned only where it varies with stiffness.
    """
    words = {name: trait(name, scenario[name]) for name in names}
    if words.get("system") == "joint":
        del words["system"]
    if "profile" in words:
        words["profile"] = profile_name(scenario["profile"]) if scenario["profile"] != "own" else ""
    if "perturbation" in words:
        words["perturbation"] = perturbation_name(scenario["perturbation"])
    if "viscosity" in words:
        words["viscosity"] = (
            "viscosity that varies with stiffness" if scenario["viscosity"] == "covarying" else ""
        )
    return ", ".join(filter(None, words.values()))


def wrapped(label: str, width: int = 20, rows: int = 4) -> str:
    """Break a label into lines of limited length, behind its punctuation if possible."""
    pieces = rf"[^:,(=]{{0,{width - 1}}}[:,(=] ?|[^:,(=]{{1,{width}}}"
    lines = [""]
    for piece in re.findall(pieces, printable(label)):
        if len(lines[-1]) + len(piece.rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    if len(lines) > rows:
        lines = [*lines[: rows - 1], f"{lines[rows - 1][: width - 1]}…"]
    return "\n".join(map(str.rstrip, lines))


def unit_name(unit: str) -> str:
    """Return an SI unit for print: "N m s/rad" as "N·m·s/rad", "kg m2" as "kg·m²"."""
    return "–" if unit in ("", "1") else unit.replace(" ", "·").replace("2", "²")
