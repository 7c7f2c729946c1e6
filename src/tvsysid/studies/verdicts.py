"""How a sentence is held against figures.

Each claim becomes a set of margins, numbers that must be positive for it to be true. It holds if the 95 % limits of
every one are above zero: to establish that all are positive, each may be tested by itself. It does not hold if one is
below zero with 95 % confidence for all of them jointly (Bonferroni). It is undecided otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

COLUMNS = ("claim", "source", "finding", "estimate", "low", "high", "unit", "verdict", "remark")
HOLDS, FAILS, UNDECIDED, NOT_STUDIED = "holds", "does not hold", "undecided", "not studied"
RATIO = "ratio"
"""Unit of margins that are logarithms."""


class Margin(Protocol):
    """A number that must be positive for a claim to be true."""

    @property
    def words(self) -> str:
        """What is compared, with its figures."""

    @property
    def estimate(self) -> float:
        """The number."""

    def limits(self, tail: float) -> tuple[float, float]:
        """Limits outside of which it lies with this probability on either side; NaN where nothing is known."""


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, and how to hold it against figures.

    Parameters
    ----------
    sentence, source
        What it says, and where.
    margins
        From figures to margins; none where the study does not have what is needed.
    unit
        Of the margins; those of ``RATIO`` are logarithms.
    needs
        What a study must have for it.
    disagreement
        Why it may fail, where that is known.
    """

    sentence: str
    source: str
    margins: Callable[[Any], Iterator[Margin]]
    unit: str
    needs: str
    disagreement: str = ""


def judged(
    claim: Claim, margins: Sequence[Margin], *, also: str = "", too_few: str = "", more: str = "data"
) -> tuple[Any, ...]:
    """Row of ``COLUMNS`` for a claim.

    Parameters
    ----------
    claim
        What is judged.
    margins
        Its margins; without any it was not studied.
    also
        What every claim needs.
    too_few
        Why nothing can be decided, if so.
    more
        What might decide where it is open.
    """
    nothing = (np.nan, np.nan, np.nan, claim.unit)
    known = [margin for margin in margins if np.isfinite(margin.estimate)]
    if not margins:
        needs = f"Needs {claim.needs}, and {also}." if also else f"Needs {claim.needs}."
        return (claim.sentence, claim.source, "", *nothing, NOT_STUDIED, needs)
    if not known:
        return (claim.sentence, claim.source, "", *nothing, UNDECIDED, "The methods gave no results.")
    if too_few:
        return (claim.sentence, claim.source, "", *nothing, UNDECIDED, too_few)
    bounds = [margin.limits(0.025) for margin in known]
    against = [place for place, margin in enumerate(known) if margin.limits(0.025 / len(known))[1] < 0]
    unsure = [place for place, (low, _) in enumerate(bounds) if not low > 0 and place not in against]
    lost = len(margins) - len(known)
    if against:
        verdict, deciding = FAILS, min(against, key=lambda place: known[place].estimate)
        speak = "speaks" if len(against) == 1 else "speak"
        told = f"{len(against)} of {len(margins)} comparisons {speak} against it; the clearest: "
    elif unsure or lost:
        verdict, deciding = UNDECIDED, min(unsure or range(len(known)), key=lambda place: known[place].estimate)
        count = len(unsure) + lost
        told = f"{count} of {len(margins)} comparisons {'is' if count == 1 else 'are'} open; " + (
            "the most so: " if unsure else "the closest of the others: "
        )
    else:
        verdict, deciding = HOLDS, min(range(len(known)), key=lambda place: bounds[place][0])
        told = f"all {len(margins)} comparisons speak for it; the closest: " if len(margins) > 1 else ""
    remark = claim.disagreement if verdict != HOLDS else ""
    if verdict == UNDECIDED:
        remark = " ".join(
            filter(None, [f"More {more} may decide." if not lost else "A method gave no results.", remark])
        )
    numbers = np.array([known[deciding].estimate, *bounds[deciding]])
    shown = np.exp(numbers) if claim.unit == RATIO else numbers
    return (claim.sentence, claim.source, told + known[deciding].words, *shown.tolist(), claim.unit, verdict, remark)
