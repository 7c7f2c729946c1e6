"""Print the results of a study, and what became of its tasks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import remark, say, say_written, show_table

if TYPE_CHECKING:
    import xarray as xr

    from tvsysid.studies.published_study import Written

SCORES = {  # names and formats, by heading
    "method": "method",
    "drawn": "realizations:d",
    "mean": "mean_stiffness:.1f",
    "bias": "bias_error:.1f",
    "random": "random_error:.1f",
    "total": "total_error:.1f",
    "rise": "rise_time:.2f",
    "VAF": "vaf:.1f",
    "VAF\n1-10 Hz": "bandpassed_vaf:.1f",
    "reflex\ngain": "reflex_gain total_error:.1f",
    "reflex\nVAF": "reflex pathway_vaf:.1f",
    "time": "seconds:.3f",
}
MAX_TABLES = 4  # that are printed; the report has all
UNITS = (
    "stiffness and its errors in N·m/rad (those of a reflex gain in N·m·s/rad), rise (from 10 to "
    "90 % of a step) and computing time in s, VAF in %"
)


def show_study(written: Written, results: xr.Dataset, out: Path, by: str, need: str) -> int:
    """Print what was written of a study, and return the exit code: 1 if a method failed.

    Parameters
    ----------
    by
        Column of the summary with a table of scores for each value.
    need
        What the claims that were not studied need.
    """
    from tvsysid.report import problems

    if written.answers is not None:
        columns = {name: name for name in map(str, written.answers)}
        show_table("stiffness to report", written.answers.to_dict("records"), columns)
    groups = written.summary.groupby(by, sort=False)
    for name, summary in list(groups)[:MAX_TABLES]:
        labels = [each for each in ("method", "realizations") if each in summary]
        scores = summary.pivot_table("value", labels, "metric", sort=False).reset_index()
        show_table(str(name), scores.to_dict("records"), SCORES)
    say(UNITS)
    if len(groups) > MAX_TABLES:
        say(f"and {len(groups) - MAX_TABLES} more in summary.csv and report.html")
    studied = written.claims[written.claims.verdict != "not studied"]
    missing = len(written.claims) - len(studied)
    title = f"published claims; {missing} more need {need}" if missing else "published claims"
    show_table(title, studied.to_dict("records"), {"claim": "claim", "verdict": "verdict"})
    for label, diagnosis in written.diagnoses.items():
        if names := ", ".join(finding.name for finding in diagnosis.findings):
            remark("warning", f"{label}: {names} (diagnosis.html says what to do)")
    return show_end(out, written.files, problems(results))


def show_end(out: Path, files: Iterable[str], problems: Iterable[Mapping[str, Any]]) -> int:
    """Print failures, warnings and files; return the exit code, 1 if a method failed."""
    code = 0
    for each in problems:
        failed = each["kind"] == "failed"
        text = "{method}: {kind} in {count} of {trials}; the first: {first}"
        remark("error" if failed else "warning", text.format(**each))
        code |= failed
    say_written(out, [*files, "results.nc"])
    return code
