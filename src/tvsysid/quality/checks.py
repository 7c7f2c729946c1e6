"""Define a check: a fault with its limit, and the function that measures it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import attrs
import numpy as np
from numpy.typing import ArrayLike

from tvsysid.numerics.threads import single_thread

MAX_LISTED = 10  # realizations in a finding's text


class Fault(NamedTuple):
    """One fault that data can have, and its limit.

    Parameters
    ----------
    title, measure
        Name of the fault in words, and description of the value that is measured.
    limit, unit
        Limit of the values that are in order, and its unit.
    severity
        ``"invalid"`` if the fault makes the stiffness of every method wrong, ``"closed loop"`` of
        every method without a reference, and ``"one pathway"`` of every method without a reflex.
        ``"serious"`` or ``"doubtful"`` if it may make the stiffness wrong, and ``"minor"`` if it
        hardly can.
    effect, remedy
        Effect of the fault on the result, and what to do about it.
    wrong
        Side of the limit on which a value is wrong. With ``"above"``, its magnitude counts.
    lowest
        Second limit for ``"above"``: smaller magnitudes are wrong too.
    """

    title: str
    measure: str
    limit: float
    unit: str
    severity: Literal["invalid", "closed loop", "one pathway", "serious", "doubtful", "minor"]
    effect: str
    remedy: str
    wrong: Literal["above", "below"] = "above"
    lowest: float = 0.0

    def beyond(self, value: float) -> bool:
        """Whether a value is on the wrong side of the limit."""
        if self.wrong == "below":
            return value < self.limit
        return abs(value) > self.limit or abs(value) < self.lowest


class Measured(NamedTuple):
    """Result of a check's function.

    ``value`` is compared with the limit, and ``what`` describes it in words. ``significant`` is
    False where noise may explain the value. ``realizations`` are the indices of faulty ones.
    """

    value: float
    what: str
    significant: bool = True
    realizations: tuple[int, ...] = ()


class NotApplicable(Exception):  # noqa: N818  # not an error
    """Raised by a check's function with the reason why the data do not allow the check."""


Function = Callable[..., Measured]

FAULTS: dict[str, Fault] = {}
"""Faults by name, in the order in which they are reported."""

_FUNCTIONS: dict[str, Function] = {}


def check(name: str, *fault: Any, which: str = "", **words: Any) -> Callable[[Function], Function]:
    """Register the function that measures a fault.

    Parameters
    ----------
    name
        Name of the fault.
    fault, words
        Parameters of :class:`Fault`.
    which
        Signal that the function takes as its second argument.
    """

    def register(function: Function) -> Function:
        FAULTS[name] = Fault(*fault, **words)
        _FUNCTIONS[name] = partial(function, which=which) if which else function
        return function

    return register


@attrs.frozen
class Finding:
    """Result of one check.

    Parameters
    ----------
    name
        Name of the fault, such as ``"drift"``.
    value
        Measured value in the unit of the fault. It is NaN if the data do not allow the check.
    what
        Description of the value in words, or the reason why the data do not allow the check.
    significant
        Whether noise cannot explain the value.
    realizations
        Indices of the faulty realizations, for a fault of single realizations.
    """

    name: str
    value: float
    what: str
    significant: bool = True
    realizations: tuple[int, ...] = ()

    @property
    def fault(self) -> Fault:
        """Description of the fault: title, measure, unit, limit, effect and remedy."""
        return FAULTS[self.name]

    @property
    def state(self) -> str:
        """Return ``"found"``, ``"in order"``, ``"uncertain"`` or ``"not judged"``.

        A value beyond the limit that is not significant is uncertain.
        """
        if math.isnan(self.value):
            return "not judged"
        if not self.fault.beyond(self.value):
            return "in order"
        return "found" if self.significant else "uncertain"

    @property
    def found(self) -> bool:
        """Whether the value is beyond its limit and significant."""
        return self.state == "found"

    @property
    def strength(self) -> str:
        """Value and limit in words.

        Examples
        --------
        >>> Finding("drift", 24.3, "").strength
        '24.3 %, should be at most 10'
        """
        if self.state == "not judged":
            return "–"
        fault, value = self.fault, f"{self.value:.3g}"
        unit = fault.unit.removesuffix("s") if value == "1" else fault.unit
        if fault.wrong == "below" or abs(self.value) < fault.lowest:
            allowed = f"at least {fault.lowest or fault.limit:g}"
        else:
            allowed = f"at most {'±' if self.value < 0 else ''}{fault.limit:g}"
        return f"{value} {unit}, should be {allowed}"

    def __repr__(self) -> str:
        return f"Finding({self.name}: {self.state}; {self.what})"


@single_thread()
def judge(name: str, *arguments: object) -> Finding:
    """Run the check for a fault."""
    try:
        value, what, significant, realizations = _FUNCTIONS[name](*arguments)
    except NotApplicable as reason:
        return Finding(name, math.nan, str(reason), significant=False)
    if realizations:
        more = ", …" * (len(realizations) > MAX_LISTED)
        what += f" (realizations {', '.join(map(str, realizations[:MAX_LISTED]))}{more})"
    return Finding(name, float(value), what, bool(significant), realizations)


def indices(concerned: ArrayLike) -> tuple[int, ...]:
    """Return the indices of the realizations where ``concerned`` is True."""
    return tuple(np.flatnonzero(concerned).tolist())
