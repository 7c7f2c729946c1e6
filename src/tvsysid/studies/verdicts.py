"""How a sentence is held against figures.

Each claim becomes a set of margins, numbers that must be positive for it to be true. It holds if
the 95 % limits of every one are above zero: to establish that all are positive, each may be
tested by itself. It does not hold if one is below zero with 95 % confidence for all of them
jointly (Bonferroni). It is undecided otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

COLUMNS = ("claim", "source", "finding", "estimate", "low", "high", "unit", "verdict", "remark")
HOLDS, FAILS, UNDECIDED, NOT_STUDIED = "holds", "does not hold", "undecided", "not studied"
RATIO = "ratio"  # unit of margins that are logarithms


class Margin(Protocol):
    """A number that must be positive for a claim to be true."""

    @property
    def words(self) -> str:
        """What is compared, with its figures."""

    @property
    def estimate(self) -> float:
        """The number."""

    def limits(self, tail: float) -> tuple[float, float]:
        """Return the limits beyond which it lies with this probability on either side.

        NaN where nothing is known.
        """


@attrs.frozen
class Claim:
    """A sentence of the paper with its section, and how to hold it against figures.

    ``margins`` gives none where a study does not have what the claim ``needs``; their unit
    ``RATIO`` says that they are logarithms. ``disagreement`` says why the claim may fail, where
    that is known.
    """

    sentence: str
    source: str
    margins: Callable[[Any], Iterator[Margin]]
    unit: str
    needs: str
    disagreement: str = ""


def judged(
    claim: Claim,
    margins: Sequence[Margin],
    *,
    also: str = "",
    too_few: str = "",
    more: str = "data",
) -> tuple[object, ...]:
    """Return the row of ``COLUMNS`` for a claim; without margins it was not studied.

    In words: what every claim needs ``also``, why there is ``too_few`` to decide by, and what to
    have ``more`` of.
    """
    nothing = (np.nan, np.nan, np.nan, claim.unit)
    known = [margin for margin in margins if np.isfinite(margin.estimate)]
    if not margins:
        needs = f"Needs {claim.needs}, and {also}." if also else f"Needs {claim.needs}."
        return (claim.sentence, claim.source, "", *nothing, NOT_STUDIED, needs)
    if too_few or not known:
        why = too_few if known else "The methods gave no results."
        return (claim.sentence, claim.source, "", *nothing, UNDECIDED, why)
    bounds = [margin.limits(0.025) for margin in known]
    against = [
        place for place, margin in enumerate(known) if margin.limits(0.025 / len(known))[1] < 0
    ]
    unsure = [
        place for place, (low, _) in enumerate(bounds) if not low > 0 and place not in against
    ]
    lost = len(margins) - len(known)
    remark = claim.disagreement
    if against:
        verdict, deciding = FAILS, min(against, key=lambda place: known[place].estimate)
        speak = "speaks" if len(against) == 1 else "speak"
        told = f"{len(against)} of {len(margins)} comparisons {speak} against it; the clearest: "
    elif unsure or lost:
        verdict, deciding = (
            UNDECIDED,
            min(unsure or range(len(known)), key=lambda place: known[place].estimate),
        )
        count = len(unsure) + lost
        told = f"{count} of {len(margins)} comparisons {'is' if count == 1 else 'are'} open; " + (
            "the most so: " if unsure else "the closest of the others: "
        )
        remark = (
            f"{'A method gave no results.' if lost else f'More {more} may decide.'} {remark}"
        ).strip()
    else:
        verdict, deciding = HOLDS, min(range(len(known)), key=lambda place: bounds[place][0])
        told = (
            f"all {len(margins)} comparisons speak for it; the closest: "
            if len(margins) > 1
            else ""
        )
        remark = ""
    numbers = np.array([known[deciding].estimate, *bounds[deciding]])
    shown = np.exp(numbers) if claim.unit == RATIO else numbers
    return (
        claim.sentence,
        claim.source,
        told + known[deciding].words,
        *shown.tolist(),
        claim.unit,
        verdict,
        remark,
    )


def log_ratio(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithm of a ratio: the margin between two values, in the unit ``RATIO``."""
    return np.asarray(np.log(one / other))
