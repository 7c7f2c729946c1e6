"""What papers say of simulations: the studies that test it, its claims, and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs

from tvsysid.figures import Illustration, draw_all
from tvsysid.quality import Diagnosis
from tvsysid.recordings.write import write_table
from tvsysid.report import write_report
from tvsysid.studies.claims import Claim, judge_claims, simulation_evidence
from tvsysid.study import score, summarize

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@attrs.frozen(eq=False)
class PublishedStudy:
    """What papers say of simulations, and how a study of these is judged and drawn.

    Parameters
    ----------
    presets
        Settings of the studies that all claims together need, by name.
    claims
        The claims.
    says
        Who says so of what, as in "the literature says of reflexes".
    figures
        Return the figures from results and their summary.
    systems
        Kinds of systems that the claims are about.
    """

    presets: Mapping[str, Mapping[str, Any]]
    claims: Sequence[Claim]
    says: str
    figures: Callable[[xr.Dataset, pd.DataFrame], dict[str, Illustration]]
    systems: Sequence[str]

    def judge(self, scores: xr.Dataset) -> pd.DataFrame:
        """Return a row for each claim, from scores as of :func:`tvsysid.study.score`.

        ``finding`` names the comparison that decides, with its figures; ``estimate``, ``low`` and
        ``high`` are its margin and 95 % limits (from drawing trials), in ``unit``: a difference
        speaks for the claim above 0, a ratio above 1. ``verdict`` is "holds", "does not hold",
        "undecided" or "not studied".
        """
        return judge_claims(self.claims, simulation_evidence(scores))


class Written(NamedTuple):
    """Tables that were written to a folder, and names of the files."""

    summary: pd.DataFrame
    """A row for each metric, as of :func:`tvsysid.study.summarize`."""
    claims: pd.DataFrame
    """A row for each claim, with its verdict."""
    files: tuple[str, ...]
    """Names in the folder."""
    diagnoses: Mapping[str, Diagnosis] = MappingProxyType({})
    """Of an experiment: by recording."""


def write_study(
    results: xr.Dataset, folder: Path, published: PublishedStudy, command: str = ""
) -> Written:
    """Write tables, figures and page of a simulation study.

    Parameters
    ----------
    results, folder
        As of :func:`tvsysid.study.run`, finished or not, and where to write.
    published
        Claims that are compared with the study, and its figures.
    command
        Command that ran the study; the page does not mention it if it is empty.
    """
    scores = score(results)
    summary, claims = summarize(scores), published.judge(scores)
    tables = {"summary.csv": summary, "claims.csv": claims}
    write_tables(folder, tables)
    pictures = draw_all(published.figures(results, summary), folder / "figures")
    page = folder / "report.html"
    write_report(page, results, summary, claims, pictures, command, published.says)
    return Written(summary, claims, ("report.html", *tables, "figures/"))


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write tables as CSV files with six digits."""
    for name, table in tables.items():
        write_table(folder / name, table)
