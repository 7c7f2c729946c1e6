"""Published claims as tables of comparisons, and one function that judges a row.

Each claim becomes a set of margins, numbers that must be positive for it to be true. It holds if
the 95 % limits of every margin are above zero: to establish that all are positive, each may be
tested by itself. It does not hold if one margin is below zero with 95 % confidence for all jointly
(Bonferroni). It is undecided otherwise.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from tvsysid.numerics import Array
from tvsysid.study.scenarios import PERIOD, RATE, Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from tvsysid.figures import Illustration

COLUMNS = ("claim", "source", "finding", "estimate", "low", "high", "unit", "verdict", "remark")
HOLDS, FAILS, UNDECIDED, NOT_STUDIED = "holds", "does not hold", "undecided", "not studied"
RATIO = "ratio"  # unit of margins that are logarithms
MIN_TRIALS = 10  # below which limits from drawing among trials are too narrow to decide by
HOW_DECIDED = (
    "Estimate and limits (95 %) are those of the comparison that decides: a difference above 0 or "
    "a ratio above 1 speaks for the claim. For “does not hold” the confidence is 95 % for all "
    "comparisons together."
)


class Comparison(NamedTuple):
    """A margin in words, and its values: an estimate with replicates, or one for each person."""

    words: str
    values: Array


class Evidence(ABC):
    """Values that claims are held against."""

    more = "data"
    """What to have more of where a claim is undecided."""
    too_few = ""
    """Why nothing can be decided, if so."""
    also = ""
    """What every claim needs."""

    @abstractmethod
    def of(self, *place: Any) -> Array | None:
        """Return the values at a place; None if the study lacks it."""

    @abstractmethod
    def estimate(self, values: Array) -> Any:
        """Return the estimate of some values."""

    @abstractmethod
    def limits(self, values: Array, tail: float) -> tuple[float, float]:
        """Return limits beyond which the estimate lies with this probability on either side.

        NaN where nothing is known.
        """


Comparisons = Callable[[Any], Iterator[Comparison]]
Rows = Iterable[tuple[Any, ...]]


@attrs.frozen
class Claim:
    """A published sentence, and the comparisons that it is held against.

    Parameters
    ----------
    sentence, source
        The claim, and the paper or section that has it.
    comparisons
        Function of the evidence. It gives none where the study lacks what the claim ``needs``.
    unit
        Unit of the margins; ``RATIO`` for logarithms.
    disagreement
        Why the claim may fail, where that is known.
    """

    sentence: str
    source: str
    comparisons: Comparisons
    unit: str
    needs: str
    disagreement: str = ""


def compare(rows: Rows | Callable[[Any], Rows], margin: Callable[..., Any]) -> Comparisons:
    """Return the comparisons of a claim.

    Parameters
    ----------
    rows
        Words and one or more places, or a function of the evidence that gives them. The words are
        a format of the values at these places, and of the ``ratio`` of the first to the last.
    margin
        Function of the values; it returns one margin, or several along the first axis.
    """

    def comparisons(evidence: Evidence) -> Iterator[Comparison]:
        for words, *places in rows(evidence) if callable(rows) else rows:
            values = [evidence.of(*place) for place in places]
            known = [each for each in values if each is not None]
            if len(known) < len(values):
                continue
            shown = [evidence.estimate(each) for each in known]
            said = words.format(*shown, ratio=shown[0] / shown[-1])
            yield from (Comparison(said, each) for each in np.atleast_2d(margin(*known)))

    return comparisons


def log_ratio(one: Array, other: Array) -> Array:
    """Return the logarithm of a ratio: the margin between two values, in the unit ``RATIO``."""
    return np.asarray(np.log(one / other))


def within(low: float, high: float = np.inf) -> Callable[[Array], Array]:
    """Return the margins of a value to the ends of a range."""
    return lambda value: np.stack([value - low, high - value] if high < np.inf else [value - low])


def judge_claims(
    claims: Iterable[Claim], evidence: Evidence, further: Iterable[tuple[object, ...]] = ()
) -> pd.DataFrame:
    """Return a row of ``COLUMNS`` for each claim, and the further rows."""
    import pandas as pd  # noqa: PLC0415  # heavy

    # A draw of few trials may have no spread to take the logarithm of.
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = [judge_claim(claim, evidence) for claim in claims]
    return pd.DataFrame([*rows, *further], columns=list(COLUMNS))


def judge_claim(claim: Claim, evidence: Evidence) -> tuple[object, ...]:
    """Return the row of ``COLUMNS`` for a claim; without comparisons it was not studied."""
    every = list(claim.comparisons(evidence))
    estimates = [float(evidence.estimate(each.values)) for each in every]
    known = [place for place, estimate in enumerate(estimates) if np.isfinite(estimate)]
    numbers, finding = np.full(3, np.nan), ""
    if not every:
        also = f", and {evidence.also}" if evidence.also else ""
        verdict, remark = NOT_STUDIED, f"Needs {claim.needs}{also}."
    elif evidence.too_few or not known:
        verdict = UNDECIDED
        remark = evidence.too_few if known else "The methods gave no results."
    else:
        limits = {place: evidence.limits(every[place].values, 0.025) for place in known}
        joint = 0.025 / len(known)
        against = [place for place in known if evidence.limits(every[place].values, joint)[1] < 0]
        open_ = [place for place in known if not limits[place][0] > 0 and place not in against]
        verdict, deciding, told, remark = _decide(
            against, open_, known, len(every), estimates, limits, evidence.more
        )
        remark = "" if verdict == HOLDS else f"{remark} {claim.disagreement}".strip()
        numbers = np.array([estimates[deciding], *limits[deciding]])
        finding = told + every[deciding].words
    shown = np.exp(numbers) if claim.unit == RATIO else numbers
    return (claim.sentence, claim.source, finding, *shown.tolist(), claim.unit, verdict, remark)


def _decide(
    against: list[int],
    open_: list[int],
    known: list[int],
    count: int,
    estimates: Sequence[float],
    limits: Mapping[int, tuple[float, float]],
    more: str,
) -> tuple[str, int, str, str]:
    """Return the verdict, the comparison that decides, how many do, and a remark."""
    if against:
        speak = "speaks" if len(against) == 1 else "speak"
        told = f"{len(against)} of {count} comparisons {speak} against it; the clearest: "
        return FAILS, min(against, key=lambda place: estimates[place]), told, ""
    lost = count - len(known)
    if open_ or lost:
        number = len(open_) + lost
        told = f"{number} of {count} comparisons {'is' if number == 1 else 'are'} open; "
        told += "the most so: " if open_ else "the closest of the others: "
        remark = "A method gave no results." if lost else f"More {more} may decide."
        return UNDECIDED, min(open_ or known, key=lambda place: estimates[place]), told, remark
    told = f"all {count} comparisons speak for it; the closest: " if count > 1 else ""
    return HOLDS, min(known, key=lambda place: limits[place][0]), told, ""


class Scores(Evidence):
    """Metrics of scenarios and methods with their replicates, from the scores of a study.

    A place is a scenario, the label of a method and a metric.
    """

    more = "trials"

    def __init__(self, scores: xr.Dataset) -> None:
        self.scores = scores
        names = ("profile", "perturbation", "duration_s", "snr_db", "viscosity", "system")
        if "profile" in scores.coords:
            columns = zip(*(scores[name].values.tolist() for name in names), strict=True)
            self.scenarios = [Scenario(*each) for each in columns]
        self._axes = [scores.indexes[name] for name in ("scenario", "method_key", "metric")]
        self._values = [
            scores[name].transpose(*scores.value.dims, ...).values
            for name in ("value", "replicates")
        ]
        if int(scores.trials.max()) < MIN_TRIALS:
            self.too_few = f"Needs at least {MIN_TRIALS} trials."

    def of(self, scenario: Scenario, method: str, metric: str) -> Array | None:
        """Return a metric followed by its replicates."""
        labels = (scenario.label, method, metric)
        if not all(label in axis for label, axis in zip(labels, self._axes, strict=True)):
            return None
        place = tuple(axis.get_loc(label) for label, axis in zip(labels, self._axes, strict=True))
        if "asked" in self.scores.coords and not self.scores.asked.values[place[:2]]:
            return None
        value, replicates = (each[place] for each in self._values)
        return np.append(value, replicates)

    def estimate(self, values: Array) -> Any:
        """Return the value before its replicates."""
        return values[0]

    def limits(self, values: Array, tail: float) -> tuple[float, float]:
        """Return percentiles of the replicates."""
        known = values[1:][~np.isnan(values[1:])]
        if not len(known):
            return np.nan, np.nan
        low, high = np.quantile(known, [tail, 1 - tail], method="nearest")
        return float(low), float(high)

    def where(self, least_s: float = 0.0, **settings: object) -> list[Scenario]:
        """Return scenarios of the paper's joint, rate and period, with these settings."""
        study = json.loads(self.scores.attrs.get("study", "{}"))
        if (study.get("rate", RATE), study.get("period", PERIOD)) != (RATE, PERIOD):
            return []
        settings = {"system": "joint"} | settings
        return [
            scenario
            for scenario in self.scenarios
            if scenario.duration_s >= least_s
            and all(getattr(scenario, name) == value for name, value in settings.items())
        ]


class Published(NamedTuple):
    """What papers say of simulations, and how a study of these is drawn.

    Parameters
    ----------
    judge
        Function from scores to a row for each claim.
    figures
        Function of results and their summary with full names.
    about
        Text above the claims.
    presets
        Studies that all claims together need.
    """

    judge: Callable[[xr.Dataset], pd.DataFrame]
    figures: Callable[[xr.Dataset, pd.DataFrame], dict[str, Illustration]]
    about: str
    presets: tuple[str, ...]
