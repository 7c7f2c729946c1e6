"""One thing that was looked at in an ensemble."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.quality.catalogue import FAULTS, Fault


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at, and what was seen.

    Parameters
    ----------
    name
        Its key in the catalogue, such as ``"drift"``.
    value
        How strong it is, in the unit of its fault; NaN where it could not be judged.
    significant
        Whether the value is more than noise explains.
    what
        What was seen, in words; why it could not be judged where it was not.
    realizations
        Indices of the realizations concerned, of faults that single ones have.
    """

    name: str
    value: float
    significant: bool
    what: str
    realizations: tuple[int, ...] = ()

    @property
    def fault(self) -> Fault:
        """What was looked for: title, measure, unit, limit, effect and remedy."""
        return FAULTS[self.name]

    @property
    def judged(self) -> bool:
        """Whether the data allow a judgement at all."""
        return not math.isnan(self.value)

    @property
    def beyond(self) -> bool:
        """Whether the value is on the wrong side of its limit, significant or not."""
        return self.fault.beyond(self.value)

    @property
    def found(self) -> bool:
        """Whether it is wrong: beyond its limit, and significant."""
        return self.beyond and self.significant

    @property
    def state(self) -> str:
        """``"found"``, ``"in order"``, ``"uncertain"`` (beyond the limit, not significant) or ``"not judged"``."""
        if self.found:
            return "found"
        return "uncertain" if self.beyond else "in order" if self.judged else "not judged"

    @property
    def strength(self) -> str:
        """Value against limit, in words.

        Examples
        --------
        >>> Finding("drift", 24.3, True, "").strength
        '24.3 %, at most 10 is in order'
        """
        if not self.judged:
            return "–"
        fault, size = self.fault, abs(self.value)
        value = "0" if size < 1e-9 else f"{self.value:.3g}" if size < 1e4 else f"{self.value:.2g}"
        unit = fault.unit.removesuffix("s") if value == "1" else fault.unit
        allowed = "at most" if fault.wrong == "above" else "at least"
        caveat = ", but not significant" if self.state == "uncertain" else ""
        return f"{value} {unit}, {allowed} {fault.limit:g} is in order{caveat}"

    def __repr__(self) -> str:
        return f"Finding({self.name}: {self.state}; {self.what})"


class Seen(NamedTuple):
    """What a check returns: the value that is held against the limit, and the rest as of :class:`Finding`."""

    value: float
    what: str
    significant: bool = True
    realizations: tuple[int, ...] = ()


class NotJudged(Exception):  # noqa: N818  # no error: these data do not allow a check; its text says why
    """Raised by a check that these data do not allow, with the reason."""


def finding_of(name: str, check: Callable[[], Seen]) -> Finding:
    """Finding of a check, which may raise NotJudged."""
    try:
        seen = check()
    except NotJudged as reason:
        return Finding(name, math.nan, False, str(reason))
    return Finding(name, float(seen.value), bool(seen.significant), seen.what, seen.realizations)


def indices(concerned: NDArray[np.bool_] | np.bool_) -> tuple[int, ...]:
    """Indices of the realizations concerned."""
    return tuple(np.flatnonzero(concerned).tolist())
