"""What there is to say about a method: what it is for, what it needs and reports, its assumptions and settings."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple

from tvsysid.errors import InputError
from tvsysid.estimates import IMPEDANCE
from tvsysid.methods.base import inputs_of, names_said, said_by, scheduled_by, special
from tvsysid.methods.plugins import key_of, parse, settings_of, target_of

NEEDS = {
    "reference": "the disturbance that was applied (channel {0.name!r})",
    "scheduling": "a scheduling variable (channel {0.name!r})",
    "input": "the channel {0.name!r}, in {0.unit}",
}


class Description(NamedTuple):
    """What there is to say about a method: what it is for, needs and reports.

    Settings as ``name = default``.
    """

    title: str
    purpose: str
    needs: tuple[str, ...]
    reports: tuple[str, ...]
    assumptions: tuple[str, ...]
    settings: tuple[str, ...]


def describe(text: str) -> Description:
    """Title, assumptions and settings of a method, as far as it states them.

    Text and errors as for :func:`parse`.

    Examples
    --------
    >>> describe("birf:reference=disturbance")[1:3]
    ('closed loops', ("the disturbance that was applied (channel 'disturbance')",))
    """
    target = target_of(key_of(text), "method")
    kind = target if isinstance(target, type) else type(target)
    stated = getattr(target, "assumptions", ())
    assumptions = (
        stated if isinstance(stated, Iterable) and not isinstance(stated, str) else [stated]
    )
    settings = []
    made = None
    if isinstance(target, type):
        with suppress(InputError):  # it needs settings that have no default
            made = parse(text)
        for name, item in settings_of(target)[0].items():
            default = getattr(made, name, item.default)
            settings.append(
                f"{name} (must be given)" if item.default is item.empty else f"{name} = {default!r}"
            )
    method = target if made is None else made
    title = str(getattr(target, "title", kind.__name__))
    about = _purpose(method), _needs(method), _reports(method)
    return Description(title, *about, tuple(map(str, assumptions)), tuple(settings))


def _purpose(method: object) -> str:
    """What a method is for, by the signals that it needs and the pathways that it tells apart."""
    if special(method, "perturbation"):
        return "special perturbations"
    kinds = {item.kind for item in inputs_of(method)}
    if "reference" in kinds:
        return "closed loops"
    if "scheduling" in kinds:
        return "a scheduling variable"
    return "two pathways" if len(getattr(method, "pathway_names", ())) > 1 else "repeated behaviour"


def _needs(method: object) -> tuple[str, ...]:
    """What a method needs beside angle and torque of realizations."""
    needs = [NEEDS[item.kind].format(item) for item in inputs_of(method)]
    if perturbed := special(method, "perturbation"):
        needs.append(f"a perturbation of this kind: {perturbed}")
    if said_by(method, "contiguous", "true or false", bool):
        needs.append("realizations that follow each other")
    return (
        (*needs, "EMG, if emg= names its channel")
        if getattr(method, "emg", "") is None
        else tuple(needs)
    )


def _reports(method: object) -> tuple[str, ...]:
    """Quantities that a method estimates, always or sometimes, and pathways."""
    several = len(getattr(method, "pathway_names", ())) > 1
    quantities = dict.fromkeys(
        (*IMPEDANCE, *names_said(method, "quantities"), *scheduled_by(method))
    )
    sometimes = names_said(method, "sometimes")
    return (*quantities, *sometimes, *(["the torque of each pathway"] if several else []))
