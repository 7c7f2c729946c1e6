"""Claims whose margins are metrics of scenarios and methods, with limits from drawing trials."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tvsysid.numerics import Array
from tvsysid.studies.van_de_ruit_2021.simulations import FEWEST, Replicated
from tvsysid.studies.verdicts import COLUMNS, Claim, judged
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import xarray as xr

HOW_DECIDED = (
    "Estimate and limits (95 %) are those of the comparison that decides: a difference above 0 or "
    "a ratio above 1 "
    "speaks for the claim. For “does not hold” the confidence is 95 % for all comparisons together."
)
Place = tuple[Scenario, str, str]  # scenario, method and metric


class Scores:
    """Metrics with their replicates."""

    def __init__(self, scores: xr.Dataset) -> None:
        self._scores = scores

    def of(self, *places: Place) -> list[Array]:
        """Return metrics followed by their replicates; none if the study lacks any."""
        indexes, found = self._scores.indexes, []
        for place in places:
            names = dict(
                zip(("scenario", "method_key", "metric"), (place[0].label, *place[1:]), strict=True)
            )
            if not all(name in indexes[dim] for dim, name in names.items()):
                return []
            own = self._scores.sel(names)
            if not own.trials:
                return []
            found.append(np.append(own.value.values, own.replicates.values))
        return found


Margins = Callable[[Scores], Iterator[Replicated]]


def judged_by(claims: Sequence[Claim], scores: xr.Dataset) -> pd.DataFrame:
    """Return the table of claims, tested against the scores of a study."""
    known = Scores(scores)
    too_few = f"Needs at least {FEWEST} trials." if int(scores.trials.max()) < FEWEST else ""
    with np.errstate(divide="ignore", invalid="ignore"):  # a draw of few trials may have no error
        rows = [
            judged(claim, list(claim.margins(known)), too_few=too_few, more="trials")
            for claim in claims
        ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def margin(words: str, values: Array) -> Replicated:
    """Return a margin followed by its replicates."""
    return Replicated(words, float(values[0]), values[1:])
