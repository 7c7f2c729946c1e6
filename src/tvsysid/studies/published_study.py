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
from tvsysid.studies.claims import Claim, Evidence, judge_claims, simulation_evidence
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
    about
        Text above the claims.
    figures
        Return the figures from results and their summary.
    applies
        Return whether the claims are about the systems of a study, from its results.
    evidence
        Return the numbers that claims are compared with, from scores.
    """

    presets: Mapping[str, Mapping[str, Any]]
    claims: Sequence[Claim]
    about: str
    figures: Callable[[xr.Dataset, pd.DataFrame], dict[str, Illustration]]
    applies: Callable[[xr.Dataset], bool]
    evidence: Callable[[xr.Dataset], Evidence] = simulation_evidence

    def judge(self, scores: xr.Dataset) -> pd.DataFrame:
        """Return a row for each claim, as :func:`tvsysid.studies.van_de_ruit_2021.judge`."""
        return judge_claims(self.claims, self.evidence(scores))


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
    page, about = folder / "report.html", published.about
    write_report(page, results, summary, claims, pictures, command, about)
    return Written(summary, claims, ("report.html", *tables, f"figures/ ({len(pictures)})"))


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write tables as CSV files with six digits."""
    for name, table in tables.items():
        write_table(folder / name, table)
