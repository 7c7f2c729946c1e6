"""Leaderboard as a table and a page, without times, machines or folders, so that it repeats."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tvsysid.figures import Illustration, draw_all, leaderboard
from tvsysid.figures.words import count
from tvsysid.report import page, problems, sections
from tvsysid.simulate import CompliantActuator, Joint, ReflexJoint, ScheduledJoint
from tvsysid.studies.leaderboard.standing import SCORE, standings
from tvsysid.studies.leaderboard.version import DIGEST, SEED, VERSION, commitment, digest
from tvsysid.studies.published_study import write_tables

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from tvsysid.study import Study

KINDS = {
    ReflexJoint: "reflex",
    ScheduledJoint: "scheduled",
    CompliantActuator: "closed loop",
    Joint: "imposed angle",
}
FILES = ("leaderboard.html", "leaderboard.csv")
COLUMNS = (
    "Score ± standard error, and gap to the leader of the rank or, for a leader, to the next "
    "better rank; the share of times at which the entry’s own 95 % band holds the truth, which the "
    "score does not count; scenarios with an estimate; and the score in the scenarios of each "
    "kind, in %. Click a heading to sort."
)
PICTURE = (
    "Left: rank, and score with two standard errors to either side. Right: error in each scenario, "
    "in per cent of the mean stiffness, the darker the smaller, numbered as in the table of "
    "scenarios. The tables have the same numbers."
)
COUNTED = (
    "What failed or was skipped counts as an error of 100 %; what gave a warning counts as it is."
)
ENTER = (
    "An entry is a method: a subclass of tvsysid.Method, installed with an entry point of the "
    "group tvsysid.methods, or named as module:Class. This command runs it beside all others, and "
    "writes such a page:"
)


ERRORS = (
    "Error in per cent of the mean stiffness, by the numbers of the scenarios; without an estimate "
    "it is 100 %."
)
CHANGED = f"Not leaderboard {VERSION}: its scenarios or trials were changed."
ERRORS_TITLE = "Error in each scenario"
SIMULATED = "What is simulated; all entries see the same trials."
COMMAND = "tvsysid leaderboard --method module:Class"
SECRET_SEED = f"secret; the SHA-256 of “tvsysid leaderboard {VERSION} seed ” followed by it is"
PUBLIC = "which is public: whoever enters can try these very trials, so this table is for practice"


def write_leaderboard(study: Study, results: xr.Dataset, folder: Path) -> pd.DataFrame:
    """Write ``FILES`` to a folder, and return the table of standings.

    Parameters
    ----------
    study, results, folder
        As of :func:`study_of`, of this study by :func:`tvsysid.study.run`, and where to write.
    """
    scenarios = _scenarios(study)
    groups = {str(kind): list(rows.index) for kind, rows in scenarios.groupby("kind", sort=False)}
    table = standings(results, groups)
    write_tables(folder, {FILES[1]: table})
    errors = table[["entry", *scenarios.index]]
    errors = errors.set_axis(["entry", *map(str, scenarios.number)], axis=1)
    drawing = partial(leaderboard, table, groups)
    picture = Illustration(drawing, "Scores and errors", PICTURE, ("svg",))
    found, seed = digest(study), study.seed
    first = ", ".join(table.entry[table["rank"] == 1])
    lines = [
        f"First: {first}. The score is the error of the stiffness in per cent: less is better.",
        f"Seed: {f'{seed}, {PUBLIC}' if seed == SEED else f'{SECRET_SEED} {commitment(seed)}'}.",
    ]
    versions = sections.settings_of(results, "versions")
    facts = (
        f"Digest of the scenarios: {found}. The same settings and software give the same page: "
        f"{', '.join(f'{name} {each}' for name, each in versions.items())}."
    )
    parts = [
        page.Section(
            "standings",
            "Standings",
            [
                page.Box(lines),
                _table("Standings", COLUMNS, table.drop(columns=list(scenarios.index))),
                page.Figure("figure-scores", draw_all({"scores": picture})["scores"]),
            ],
        ),
        page.Section("score", "What the score is", [SCORE]),
        page.Section("errors", ERRORS_TITLE, [_table("Errors", ERRORS, errors)], wide=True),
        page.Section("scenarios", "Scenarios", [_table("Scenarios", SIMULATED, scenarios), facts]),
        sections.problems_section(problems(results), "entry", COUNTED),
        page.Section("enter", "How to enter", [ENTER, page.Code("Command", COMMAND)]),
    ]
    methods, trials = count(len(table), "method"), count(study.trials, "trial")
    whole = page.Page(
        f"Leaderboard {VERSION} of time-varying joint identification",
        f"How well {methods} found the stiffness of simulated joints: "
        f"{count(len(scenarios), 'scenario')} of {trials} each.",
        parts,
        sections.version_of(results),
        "" if found == DIGEST else CHANGED,
    )
    page.write_page(folder / FILES[0], whole)
    return table


def _scenarios(study: Study) -> pd.DataFrame:
    """Return kind and settings of each scenario, by label, those of a kind together."""
    import pandas as pd  # noqa: PLC0415  # heavy

    systems = (study.simulated(scenario)[0] for scenario in study.scenarios)
    kinds = [
        next((kind for of, kind in KINDS.items() if isinstance(system, of)), "other")
        for system in systems
    ]
    table = pd.DataFrame(study.scenarios, index=[each.label for each in study.scenarios])
    table.insert(0, "kind", kinds)
    table = pd.concat([rows for _, rows in table.groupby("kind", sort=False)])
    table.insert(0, "number", range(1, len(table) + 1))
    return table.rename(columns={"duration_s": "data (s)", "snr_db": "SNR (dB)"})


def _table(label: str, caption: str, frame: pd.DataFrame) -> page.Table:
    """Return a data frame as a table: texts, whole numbers, and others ± their ``_error``."""

    def cell(row: dict[Any, Any], name: str) -> page.Cell | str:
        value, error = row[name], row.get(f"{name}_error")
        if isinstance(value, str):
            return value
        decimals = 0 if isinstance(value, int) else 1 if error is None else 2
        return page.number(value, math.nan if error is None else error, decimals)

    names = [str(name) for name in frame if not str(name).endswith("_error")]
    rows = [[cell(row, name) for name in names] for row in frame.to_dict("records")]
    columns = [
        page.Column(name, kind="label" if isinstance(each, str) else "number")
        for name, each in zip(names, rows[0], strict=True)
    ]
    anchor = f"{label.lower()}-table"
    return page.Table(label, caption, columns, list(map(page.Row, rows)), anchor, True, True)
