"""Write and print the results of a study, and what became of its tasks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.cli.console import errors, remark, say, say_written, show_table

if TYPE_CHECKING:
    import xarray as xr

    from tvsysid.study import Prepared

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


def write_study(
    results: xr.Dataset,
    out: Path,
    command: str = "",
    executor: Executor | None = None,
    prepared: Sequence[Prepared] = (),
) -> int:
    """Write tables, figures and pages of a study, print its results, and return the exit code.

    The code is 1 if a method failed. ``command`` is what was typed, ``prepared`` are the recordings
    of an experiment. The processes of the ``executor`` draw.
    """
    from tvsysid.report import problems
    from tvsysid.studies import published

    is_experiment = "recording" in results.dims
    with errors.status("scoring and drawing"):
        if is_experiment:
            from tvsysid.studies.van_de_ruit_2021.experiment import write_experiment

            written = write_experiment(results, prepared, out, command, executor)
        else:
            written = published(results).write(results, out, command, executor)
    if written.answers is not None:
        columns = {name: name for name in map(str, written.answers)}
        show_table("stiffness to report", written.answers.to_dict("records"), columns)
    groups = written.summary.groupby("perturbation" if is_experiment else "scenario", sort=False)
    for name, summary in list(groups)[:MAX_TABLES]:
        labels = [each for each in ("method", "realizations") if each in summary]
        scores = summary.pivot_table("value", labels, "metric", sort=False).reset_index()
        show_table(str(name), scores.to_dict("records"), SCORES)
    say(UNITS)
    if len(groups) > MAX_TABLES:
        say(f"and {len(groups) - MAX_TABLES} more in summary.csv and report.html")
    studied = written.claims[written.claims.verdict != "not studied"]
    title = f"published claims: {len(studied)} of {len(written.claims)} were studied"
    show_table(title, studied.to_dict("records"), {"claim": "claim", "verdict": "verdict"})
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
