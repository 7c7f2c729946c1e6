"""Description of a method: its purpose, needs, results, assumptions and settings."""

from __future__ import annotations

from typing import NamedTuple

from tvsysid.methods.base import Method
from tvsysid.methods.registry import parse
from tvsysid.models import IMPEDANCE
from tvsysid.validators import settings_of

NEEDS = {
    "reference": "the disturbance that was applied (channel {0.name!r})",
    "scheduling": "a scheduling variable (channel {0.name!r})",
    "input": "the channel {0.name!r}, in {0.unit}",
}


class Description(NamedTuple):
    """Description of a method. Settings are texts such as ``"window = 0.1"``."""

    title: str
    purpose: str
    needs: tuple[str, ...]
    reports: tuple[str, ...]
    assumptions: tuple[str, ...]
    settings: tuple[str, ...]


def describe(text: str) -> Description:
    """Describe a method. Text and errors are those of :func:`parse`.

    Examples
    --------
    >>> describe("birf:reference=disturbance")[1:3]
    ('closed loops', ("the disturbance that was applied (channel 'disturbance')",))
    """
    method = parse(text)
    settings = tuple(f"{name} = {value!r}" for name, value in settings_of(method).items())
    several = ("the torque of each pathway",) if len(method.pathway_names) > 1 else ()
    quantities = dict.fromkeys([*IMPEDANCE, *method.quantities, *method.scheduled_quantities])
    reports = (*quantities, *method.sometimes, *several)
    return Description(
        method.title, _purpose(method), _needs(method), reports, method.assumptions, settings
    )


def _purpose(method: Method) -> str:
    """Return what a method is for, by the signals that it needs and its pathways."""
    if method.perturbation:
        return "special perturbations"
    kinds = {item.kind for item in method.inputs}
    if "reference" in kinds:
        return "closed loops"
    if "scheduling" in kinds:
        return "a scheduling variable"
    return "two pathways" if len(method.pathway_names) > 1 else "repeated behaviour"


def _needs(method: Method) -> tuple[str, ...]:
    """Return what a method needs beside angle and torque of realizations."""
    needs = [NEEDS[item.kind].format(item) for item in method.inputs]
    if method.perturbation:
        needs.append(f"a perturbation of this kind: {method.perturbation}")
    if method.contiguous:
        needs.append("realizations that follow each other")
    if getattr(method, "emg", "") is None:
        needs.append("EMG, if emg= names its channel")
    return tuple(needs)
