"""`tvsysid leaderboard`."""

from __future__ import annotations

from pathlib import Path

from tvsysid.cli.console import errors, show_table
from tvsysid.cli.options import Methods, WorkerOptions, Workers, given
from tvsysid.cli.results import show_end
from tvsysid.cli.running import opened, run_study


def leaderboard(
    *,
    method: Methods | None = None,
    trials: int | None = None,
    seed: int | None = None,
    workers: WorkerOptions = Workers(),
    out: Path = Path("tvsysid-leaderboard"),
) -> int:
    """Rank methods by one score, on simulated joints that are the same for everybody.

    Entries are the package's methods, and those given with `--method`.
    Each identifies joints whose angle is imposed, with a reflex, in closed loop, and scheduled by a
    measured variable. The score is the error of the stiffness in per cent of its mean, with its
    standard error; entries whose scores do not differ significantly share a rank.

    Writes to the folder:

    - `leaderboard.html`: ranks, scores, errors and what the score is, the same page whenever it is
      made;

    - `leaderboard.csv`: a row for each entry, with its error in each scenario;

    - `results.nc`: every trial. It holds the seed: do not publish that of a secret one.

    If the command is interrupted or killed, the same command resumes.

    Example: `tvsysid leaderboard --method mymodule:MyMethod`

    Parameters
    ----------
    trials
        Trials of each scenario, two at least, to try it out. [10, which the version has]
    seed
        Seed that is kept secret, of 20 digits or more; the page has its hash only. [the public one
        of the version]
    out
        Folder for the results.
    """
    from tvsysid.report import problems
    from tvsysid.studies.leaderboard import FILES, study_of, write_leaderboard

    study = study_of(method or (), **given(trials=trials, seed=seed))
    with opened(workers) as executor:
        results = run_study(study, out, workers, executor)
    with errors.status("scoring and drawing"):
        table = write_leaderboard(study, results, out)
    columns = {
        "rank": "rank:d",
        "entry": "entry",
        "score (%)": "score:.2f",
        "± (%)": "score_error:.2f",
        "in 95 % band (%)": "coverage:.1f",
    }
    show_table("leaderboard", table.to_dict("records"), columns)
    failed = [each for each in problems(results) if each["kind"] == "failed"]
    return show_end(out, FILES, failed)
