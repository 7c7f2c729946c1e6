"""One thing that was looked at."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tvsysid.diagnosis.catalogue import KINDS


@dataclass(frozen=True)
class Check:
    """One thing that was looked at, and what was seen.

    Parameters
    ----------
    name
        Its key in the catalogue, such as ``"drift"``.
    value
        How strong it is, in ``unit``; NaN where it could not be judged.
    found
        Whether it is wrong: beyond its threshold, and no chance.
    what
        What was seen, in words; why it could not be judged where it was not.
    """

    name: str
    value: float
    found: bool
    what: str

    @property
    def title(self) -> str:
        """It in a few words."""
        return KINDS[self.name].title

    @property
    def measure(self) -> str:
        """What the value is."""
        return KINDS[self.name].measure

    @property
    def unit(self) -> str:
        """Unit of value and threshold."""
        return KINDS[self.name].unit

    @property
    def threshold(self) -> float:
        """Value that is still in order."""
        return KINDS[self.name].limit

    @property
    def wrong(self) -> str:
        """``"above"`` or ``"below"``: the side of the threshold on which it is wrong."""
        return KINDS[self.name].wrong

    @property
    def effect(self) -> str:
        """What it does to the result."""
        return KINDS[self.name].effect

    @property
    def remedy(self) -> str:
        """What to do."""
        return KINDS[self.name].remedy

    @property
    def judged(self) -> bool:
        """Whether it could be told at all."""
        return not math.isnan(self.value)

    @property
    def beyond(self) -> bool:
        """Whether the value is on the wrong side of its threshold, chance or not."""
        return abs(self.value) > self.threshold if self.wrong == "above" else self.value < self.threshold

    @property
    def state(self) -> str:
        """``"found"``, ``"in order"``, ``"uncertain"`` (beyond the threshold, maybe by chance) or ``"not judged"``."""
        if self.found:
            return "found"
        return "uncertain" if self.beyond else "in order" if self.judged else "not judged"

    def __repr__(self) -> str:
        return f"Check({self.name}: {self.state}; {self.what})"


def judged(name: str, value: float, what: str, *, certain: bool = True) -> Check:
    """Check whose value is held against its threshold.

    Parameters
    ----------
    name, value, what
        See :class:`Check`.
    certain
        Whether the value is no chance; only then it counts as found.
    """
    check = Check(name, float(value), False, what)
    return replace(check, found=check.beyond and bool(certain))


def unjudged(name: str, why: str) -> Check:
    """Check that these data do not allow."""
    return Check(name, math.nan, False, why)
