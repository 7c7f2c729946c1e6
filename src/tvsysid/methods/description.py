"""Description of a method: its purpose, needs, results, assumptions and settings."""

from __future__ import annotations

from collections.abc import Iterator
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
PURPOSES = {"reference": "closed loops", "scheduling": "a scheduling variable"}


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
    several = ("the torque of each pathway",) if len(method.pathway_names) > 1 else ()
    quantities = dict.fromkeys([*IMPEDANCE, *method.quantities, *method.scheduled_quantities])
    return Description(
        title=method.title,
        purpose=_purpose(method),
        needs=tuple(_needs(method)),
        reports=(*quantities, *method.sometimes, *several),
        assumptions=method.assumptions,
        settings=tuple(f"{name} = {value!r}" for name, value in settings_of(method).items()),
    )


def _purpose(method: Method) -> str:
    """Return what a method is for, by the signals that it needs and its pathways."""
    if method.perturbation:
        return "special perturbations"
    for item in method.inputs:
        if item.kind in PURPOSES:
            return PURPOSES[item.kind]
    return "two pathways" if len(method.pathway_names) > 1 else "repeated behaviour"


def _needs(method: Method) -> Iterator[str]:
    """Yield what a method needs beside angle and torque of realizations."""
    yield from (NEEDS[item.kind].format(item) for item in method.inputs)
    if method.perturbation:
        yield f"a perturbation of this kind: {method.perturbation}"
    if method.contiguous:
        yield "realizations that follow each other"
    if getattr(method, "emg", "") is None:
        yield "EMG, if emg= names its channel"
