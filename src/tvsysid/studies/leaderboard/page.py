"""Leaderboard as a table and a page, without times, machines or folders, so that it repeats."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.figures import Illustration, draw_all, leaderboard
from tvsysid.figures.results import traits_of
from tvsysid.figures.words import count
from tvsysid.recordings import whole_file
from tvsysid.report import page, problems, sections
from tvsysid.report.study import TRAIT_COLUMNS
from tvsysid.simulate import CompliantActuator, Joint, ReflexJoint, ScheduledJoint
from tvsysid.studies.leaderboard.standing import SCORE, SURE, answered, standings
from tvsysid.studies.leaderboard.version import DIGEST, SEED, VERSION, commitment, digest

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
    "Score ± standard error, and how far it is behind the one that leads its rank or, if it leads "
    "one, the rank before; the share of times at which the entry’s own 95 % band holds the truth, "
    "which the score does not count; scenarios with an estimate; and the score in the scenarios of "
    "each kind. Click a heading to sort."
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


def write_leaderboard(study: Study, results: xr.Dataset, folder: Path) -> pd.DataFrame:
    """Write ``FILES`` to a folder, and return the table of standings.

    Parameters
    ----------
    study, results, folder
        As of :func:`study_of`, of this study by :func:`tvsysid.study.run`, and where to write.
    """
    groups = _groups(study)
    table = standings(results, groups)
    with whole_file(folder / FILES[1]) as file:
        table.to_csv(file, index=False, float_format="%.6g")
    page.write_page(folder / FILES[0], _page(study, results, table, groups))
    return table


def _groups(study: Study) -> dict[str, list[str]]:
    """Return labels of scenarios by their kind."""
    found: dict[str, list[str]] = {}
    for scenario in study.scenarios:
        system, _ = study.simulated(scenario)
        kind = next((kind for of, kind in KINDS.items() if isinstance(system, of)), "other")
        found.setdefault(kind, []).append(scenario.label)
    return found


def _page(
    study: Study, results: xr.Dataset, table: pd.DataFrame, groups: dict[str, list[str]]
) -> page.Page:
    own = digest(study)
    changed = (
        "" if own == DIGEST else f"Not leaderboard {VERSION}: its scenarios or trials were changed."
    )
    versions = sections.settings_of(results, "versions")
    software = ", ".join(f"{name} {each}" for name, each in versions.items())
    lines = [*_told(table, groups), f"Seed: {_seed_in_words(study.seed)}."]
    facts = (
        f"Digest of the scenarios: {own}. The same settings and software give the same page: "
        f"{software}."
    )
    drawing = Illustration(
        partial(leaderboard, table, groups), "Scores and errors", PICTURE, ("svg",)
    )
    figure = page.Figure("figure-scores", draw_all({"scores": drawing})["scores"])
    command = page.Code("Command", "tvsysid leaderboard --method module:Class")
    parts = [
        page.Section(
            "standings", "Standings", [page.Box(lines), _standings(table, groups), figure]
        ),
        page.Section("score", "What the score is", [SCORE]),
        page.Section(
            "errors", "Error in each scenario", [_errors(results, table, groups)], wide=True
        ),
        page.Section("scenarios", "Scenarios", [_scenarios(results, groups), facts]),
        sections.problems_section(problems(results), "entry", COUNTED),
        page.Section("enter", "How to enter", [ENTER, command]),
    ]
    title = f"Leaderboard {VERSION} of time-varying joint identification"
    trials = (
        f"{count(results.sizes['scenario'], 'scenario')} of {count(study.trials, 'trial')} each"
    )
    subtitle = (
        f"How well {count(len(table), 'method')} found the stiffness of simulated joints: {trials}."
    )
    return page.Page(title, subtitle, parts, sections.version_of(results), changed)


def _seed_in_words(seed: int) -> str:
    if seed == SEED:
        return (
            f"{seed}, which is public: whoever enters can try these very trials, so this table is "
            "for practice"
        )
    return (
        f"secret; the SHA-256 of “tvsysid leaderboard {VERSION} seed ” followed by it is "
        f"{commitment(seed)}"
    )


def _told(table: pd.DataFrame, kinds: Iterable[str]) -> list[str]:
    """Describe who leads, overall and by kind of scenario, and which ranks are shared."""
    ranks = {
        each: list(table.entry[table["rank"] == each]) for each in table["rank"].unique().tolist()
    }
    shared = "; ".join(
        f"{rank}: {', '.join(entries)}" for rank, entries in ranks.items() if len(entries) > 1
    )
    first = (
        f"First: {', '.join(ranks[1])}. The score is the error of the stiffness in per cent: less "
        "is better."
    )
    words = (
        f"Shared, because they differ by no more than {SURE:g} standard errors, are the ranks "
        f"{shared}."
    )
    if table.score_error.isna().all():
        words = "One trial has no standard error: nothing can be told apart, and all share a rank."
    best = "; ".join(
        f"{kind}: {table.sort_values(kind, kind='stable').entry.iloc[0]} ({table[kind].min():.1f} "
        "%)"
        for kind in kinds
    )
    return [
        first,
        f"Lowest in the scenarios of each kind – {best}.",
        words if shared else "No rank is shared.",
    ]


def _standings(table: pd.DataFrame, groups: dict[str, list[str]]) -> page.Table:
    units = {
        "score": "%",
        "behind": "%",
        "in 95 % band": "%",
        "answered": "scenarios",
        **dict.fromkeys(groups, "%"),
    }
    headings = [page.Column("rank", kind="number"), page.Column("entry", kind="label")]
    headings += [
        *(page.Column(name, unit, "number") for name, unit in units.items()),
        page.Column("from", kind="label"),
    ]
    rows = []
    for each in table.to_dict("records"):
        cells = [page.number(each[name], each[f"{name}_error"], 2) for name in ("score", "behind")]
        cells += [
            page.number(each["coverage"], decimals=1),
            page.number(each["answered"], decimals=0),
        ]
        cells += [page.number(each[kind], decimals=1) for kind in groups]
        rows.append(
            page.Row((page.number(each["rank"], decimals=0), each["entry"], *cells, each["origin"]))
        )
    return page.Table(
        "Standings", COLUMNS, headings, rows, "standings-table", sortable=True, narrow=True
    )


def _errors(results: xr.Dataset, table: pd.DataFrame, groups: dict[str, list[str]]) -> page.Table:
    names, found, rows = (
        [name for group in groups.values() for name in group],
        answered(results),
        [],
    )
    for each in table.to_dict("records"):
        here = found.sel(method_key=each["entry"])
        cells = [
            page.number(each[name], decimals=1) if here.sel(scenario=name) else page.Cell("–", 100)
            for name in names
        ]
        rows.append(page.Row((each["entry"], *cells)))
    caption = (
        "Error in per cent of the mean stiffness, by the numbers of the scenarios; without an "
        "estimate it is 100 %."
    )
    headings = [page.Column("entry", kind="label")]
    headings += [page.Column(str(number), kind="number") for number, _ in enumerate(names, start=1)]
    return page.Table("Errors", caption, headings, rows, "errors-table", sortable=True)


def _scenarios(results: xr.Dataset, groups: dict[str, list[str]]) -> page.Table:
    traits = traits_of(results)
    rows: list[page.Row] = []
    for kind, name in ((kind, name) for kind, names in groups.items() for name in names):
        cells = [
            page.number(each, decimals=0) if isinstance(each, float) else each
            for each in traits[name].values()
        ]
        rows.append(page.Row((str(len(rows) + 1), kind, *cells)))
    headings = [page.Column("number"), page.Column("kind")]
    headings += [
        page.Column(each.heading, kind=each.kind or "label") for each in TRAIT_COLUMNS.values()
    ]
    return page.Table(
        "Scenarios", "What is simulated; all entries see the same trials.", headings, rows
    )
