"""What papers say of simulations: the studies that test it, its claims, and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs

from tvsysid import figures
from tvsysid.figures.results import scenario_traits
from tvsysid.figures.saving import Illustration, draw_all, illustrated
from tvsysid.figures.words import described
from tvsysid.recordings.write import write_table
from tvsysid.report import write_report
from tvsysid.studies.claims import Claim, judge_claims, simulation_evidence
from tvsysid.study import score, summarize

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

COMPARISON = (
    "A column for each method. Upper rows, over one realization of {}: estimates, mean and two "
    "standard deviations over trials, against the truth, time-varying VAF, and the share of trials "
    "whose 95 % band holds the true stiffness. Lower rows: metrics of all scenarios with standard "
    "errors; the ranking has the numbers."
)


class Written(NamedTuple):
    """Tables that were written to a folder, and names of the files."""

    summary: pd.DataFrame
    """A row for each metric, as of :func:`tvsysid.study.summarize`."""
    claims: pd.DataFrame
    """A row for each claim, with its verdict."""
    files: Sequence[str]
    """Names in the folder."""
    answers: pd.DataFrame | None = None
    """Of an experiment: a row for each recording with the stiffness to report."""


@attrs.frozen(eq=False)
class PublishedStudy:
    """What papers say of simulations, and how a study of these is judged and drawn.

    Parameters
    ----------
    systems
        Kinds of systems that the claims are about.
    says
        Who says so of what, as in "the literature says of reflexes".
    presets
        Settings of the studies that all claims together need, by name.
    claims
        The claims.
    grouped
        From results and the traits of their scenarios, return for each scenario the name of the
        group that shares its figures, and the size of what the bias depends on.
    size
        What that size is, with its unit.
    of_square_wave
        Further figures of a study with a square wave.
    """

    systems: Sequence[str]
    says: str
    presets: Mapping[str, Mapping[str, Any]]
    claims: Sequence[Claim]
    grouped: Callable[[xr.Dataset, pd.DataFrame], tuple[Any, Any]]
    size: str = ""
    of_square_wave: dict[str, Illustration] = attrs.field(factory=dict)

    def judge(self, scores: xr.Dataset) -> pd.DataFrame:
        """Return a row for each claim, from scores as of :func:`tvsysid.study.score`.

        ``finding`` names the comparison that decides, with its figures; ``estimate``, ``low`` and
        ``high`` are its margin and 95 % limits (from drawing trials), in ``unit``: a difference
        speaks for the claim above 0, a ratio above 1. ``verdict`` is "holds", "does not hold",
        "undecided" or "not studied".
        """
        return judge_claims(self.claims, simulation_evidence(scores))

    def figures(self, results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
        """Return all figures of a study, by the stem of the file's name.

        For each group of scenarios ``"comparison-GROUP"`` (metrics of the scenarios that most
        methods identified, and estimates over time in the one in the middle),
        and ``"bias-GROUP"``: the bias against several sizes, from the first scenario of each.

        Parameters
        ----------
        results, summary
            As of :func:`tvsysid.study.run` and, of these, :func:`tvsysid.study.summarize`.
        """
        traits = scenario_traits(results)
        shown: dict[str, Illustration] = {}
        names, sizes = self.grouped(results, traits)
        methods = summary.groupby("scenario").method.nunique()
        traits = traits.assign(group=names, size=sizes, methods=methods)
        bias = summary[summary.metric == "mean_bias"]
        for name, rows in traits.groupby("group", sort=False):
            labels = list(rows.index[rows.methods == rows.methods.max()])
            stem = str(name).replace(" ", "")
            shown[f"comparison-{stem}"] = comparison(results, summary, labels)
            first = rows["size"].drop_duplicates()
            points = bias.join(first, on="scenario", how="inner")
            if len(first) > 1:
                title = f"Bias of the stiffness against the {self.size}, {name}"
                text = "A line for each method, with standard errors."
                shown[f"bias-{stem}"] = illustrated(
                    figures.error_against, self.size, points, title=title, text=text
                )
        return shown | self.of_square_wave if "square" in results.profile else shown

    def write(
        self,
        results: xr.Dataset,
        folder: Path,
        command: str = "",
        executor: Executor | None = None,
    ) -> Written:
        """Write tables, figures and page of a study.

        Parameters
        ----------
        results, folder
            As of :func:`tvsysid.study.run`, finished or not, and where to write.
        command
            Command that ran the study; the page does not mention it if it is empty.
        executor
            Draws the figures; None draws them in this process.
        """
        scores = score(results)
        summary, claims = summarize(scores), self.judge(scores)
        tables = {"summary.csv": summary, "claims.csv": claims}
        for name, table in tables.items():
            write_table(folder / name, table)
        call_each = executor.map if executor else map
        pictures = draw_all(self.figures(results, summary), folder / "figures", call_each)
        page = folder / "report.html"
        write_report(page, results, summary, claims, pictures, command, self.says)
        return Written(summary, claims, (page.name, *tables, "figures/"))


def comparison(results: xr.Dataset, summary: pd.DataFrame, labels: Sequence[str]) -> Illustration:
    """Return the figure of methods in a group of scenarios."""
    shown = labels[len(labels) // 2]
    rows = summary[summary.scenario.isin(labels)]
    is_reflex = "reflex_gain" in results.quantity
    metrics = figures.METRICS_OF_PATHWAYS if is_reflex else figures.METRICS
    return illustrated(
        partial(figures.method_comparison, metrics=metrics),
        results.sel(method_key=rows.method.unique()),
        rows,
        shown,
        labels,
        title=f"Methods compared: {described(scenario_traits(results).loc[shown].to_dict())}",
        text=COMPARISON.format(shown),
    )
