"""`tvsysid leaderboard`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tvsysid.cli.console import remark, say_written, show_table, shown_warnings, waiting
from tvsysid.cli.options import (
    MethodOption,
    OutOption,
    SchedulerOption,
    WorkersOption,
    given,
    option,
)
from tvsysid.cli.running import STORE, check_folder, print_met, run_in

if TYPE_CHECKING:
    import pandas as pd


def leaderboard(
    method: MethodOption = [],
    scenario: Annotated[
        list[str] | None,
        option(
            "NAME",
            "Further scenario, of an installed package or as `module:name`; repeatable. The table "
            "is then not that of "
            "the version.",
        ),
    ] = None,
    trials: Annotated[
        int | None,
        option("N", "Trials of each scenario, fewer to try it out. [10, which the version has]"),
    ] = None,
    seed: Annotated[
        int | None,
        option(
            "N",
            "Seed that is kept secret; the page has its hash only. [the public one of the version]",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: OutOption = Path("tvsysid-leaderboard"),
) -> None:
    """Rank methods by one score, on simulated joints that are the same for everybody.

    Entries are the package's methods, those of installed packages, and those given with `--method`.
    Each identifies joints whose angle is imposed, with a reflex, in closed loop, and scheduled by a
    measured variable. The score is the error of the stiffness in per cent of its mean, with its
    standard error; entries that cannot be told apart share a rank.

    Writes to the folder:

    - `leaderboard.html`: ranks, scores, errors and what the score is, the same page whenever it is
      made;

    - `leaderboard.csv`: a row for each entry;

    - `results.zarr`: every trial. It holds the seed: do not publish that of a secret one.

    If the command is interrupted or killed, the same command resumes.

    Example: `tvsysid leaderboard --method mymodule:MyMethod`
    """
    from tvsysid.report import problems
    from tvsysid.studies.leaderboard import FILES, SECRET, SEED, study_of, write_leaderboard
    from tvsysid.study import run

    with shown_warnings():
        study = study_of(method, scenario or (), **given(trials=trials, seed=seed))
    if SEED != study.seed < SECRET:
        remark(
            "warning",
            "a seed below 2^64 can be found from its hash by trying; give one of 20 digits or more",
        )
    check_folder(out)
    title = (
        f"{len(study.scenarios)} scenarios x {study.trials} trials x "
        f"{len(study.named_methods)} entries"
    )
    results = run_in(out, partial(run, study), title, "trials", workers, scheduler)
    with waiting("scoring and drawing"):
        table = write_leaderboard(study, results.load(), out)
    _show(table)
    if study.trials == 1:
        remark(
            "warning",
            "one trial gives no standard error, so that all share a rank; --trials 2 or more ranks",
        )
    failed = [
        each for each in problems(results) if each["kind"] == "failed"
    ]  # the page has all else
    complete = print_met(results, failed, "trials", "trials")
    say_written(out, [*FILES, STORE])
    if not complete:
        raise typer.Exit(1)


def _show(table: pd.DataFrame) -> None:
    numbers = table[["score", "score_error", "coverage"]].to_numpy()
    texts = [
        [
            f"{each:.{places}f}".replace("nan", "-")
            for each, places in zip(row, (2, 2, 1), strict=True)
        ]
        for row in numbers
    ]
    rows = [
        (str(rank), entry, *row)
        for rank, entry, row in zip(table["rank"], table.entry, texts, strict=True)
    ]
    show_table(
        "leaderboard", ["rank", "entry", "score\n(%)", "±\n(%)", "in 95 % band\n(%)"], rows, "rl"
    )
