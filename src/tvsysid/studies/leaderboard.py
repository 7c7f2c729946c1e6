"""A leaderboard that others can enter: frozen scenarios, and a ranking of methods by one score.

What is run is frozen: to change any of it is to begin a version with a number of its own. The page
has no times, machines or folders, so that it repeats.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid import figures
from tvsysid.errors import InputError
from tvsysid.figures.saving import draw_all, illustrated
from tvsysid.methods import CLOSED_LOOP, METHODS
from tvsysid.numerics import Array
from tvsysid.recordings.write import write_table
from tvsysid.report.page import render
from tvsysid.report.studies import problems, settings_of, version_of
from tvsysid.study.scenarios import Scenario, Study
from tvsysid.study.scores import MAIN

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

VERSION = 1
SEED = 1  # of the public trials; those of an official table are kept secret
TRIALS = 10
MAX_TIE = 2.0  # standard errors of a difference up to which entries share a rank

OTHER_SINE = "sine:mean=80,amplitude=60,offset=0.3"
SCHEDULED = "scheduled:variable=scheduling"
SOFT = "loaded:actuator_stiffness=30,noise_bandwidth=2"
FREE = (
    "loaded:inertia=0.1,viscosity=1.3,actuator_stiffness=0,actuator_viscosity=0,actuator_inertia=0"
)
SCENARIOS = {
    "imposed angle": (
        Scenario("square", "noise", 40.0, 10.0),
        Scenario("square", "prbs", 80.0, 10.0, "covarying"),
        Scenario(OTHER_SINE, "pulses", 40.0, 0.0),
        Scenario("sine", "multisine", 80.0, 10.0),
    ),
    "reflex": (
        Scenario("sine", "noise", 80.0, 10.0, system="reflex-sine"),
        Scenario("square", "prbs", 80.0, 10.0, system="reflex-square:noise_bandwidth=1"),
        Scenario("constant", "pulses", 40.0, 5.0, system="reflex"),
    ),
    "closed loop": (
        Scenario("sine", "noise:cutoff=20", 40.0, 5.0, system="compliant:noise_bandwidth=5"),
        Scenario("square", "noise:cutoff=20", 80.0, 5.0, system=SOFT),
        Scenario("sine", "pulses:duration=0.02,interval=1", 80.0, 10.0, system=FREE),
    ),
    "scheduled": (
        Scenario("sine", "noise", 40.0, 10.0, system=SCHEDULED),
        Scenario("square", "prbs", 150.0, 0.0, system=SCHEDULED),
        Scenario(OTHER_SINE, "pulses", 80.0, 10.0, system=SCHEDULED),
    ),
}
"""Joints by their kind, in an order that the tables keep."""
FILES = PAGE, TABLE = "leaderboard.html", "leaderboard.csv"


def study_of(entries: Sequence[object] = (), **changes: Any) -> Study:
    """Return the leaderboard's study: methods of the package, and others.

    Changes of settings make it another one than the version's.

    Raises
    ------
    InputError
        For a single trial, whose scores have no standard error to rank by.
    """
    first, *others = (each._asdict() for every in SCENARIOS.values() for each in every)
    study = Study(
        **first,
        also=others,
        methods=tuple(dict.fromkeys((*METHODS, *CLOSED_LOOP, *entries))),
        subtract_mean=True,
        trials=TRIALS,
        seed=SEED,
    ).replaced(**changes)
    if study.trials < 2:
        raise InputError("one trial cannot rank methods: take at least two (--trials 2)")
    return study


def errors_of(results: xr.Dataset) -> xr.DataArray:
    """Return the relative error of stiffness, at most 1, (scenario, trial, method_key)."""
    own = results.sel(quantity=MAIN)
    truth = own.get("trial_truth", own.truth)
    off = own.estimate.fillna(0.0) - truth
    errors: xr.DataArray = np.sqrt((off**2).mean("time")) / truth.mean("time")
    return errors.clip(max=1.0)


def score_of(errors: Array) -> Array:
    r"""Return the score of each entry in per cent, from errors (scenario, trial, entry).

    .. math:: 100 \exp \frac{1}{S} \sum_s \log \sqrt{\sum_t e_{st}^2 / T}
    """
    squares = (errors**2).mean(axis=1)
    return 100 * np.exp(0.5 * np.log(squares).mean(axis=0))


def influence_of(errors: Array) -> Array:
    """Return how much the score changes with each trial's weight, as the errors' shape."""
    squares = errors**2
    shares = squares / squares.mean(axis=1, keepdims=True)
    return score_of(errors) * shares / (2 * len(errors))


def standard_error(influence: Array) -> Array:
    """Return the standard error of scores from the influence of each trial.

    All entries see the same trials: a difference of influences gives the error of a difference.
    """
    return np.sqrt((influence.var(axis=1) / (influence.shape[1] - 1)).sum(axis=0))


def ranks_of(errors: Array) -> list[int]:
    """Rank entries in the order of their scores.

    An entry shares the rank of the one that leads it, unless it is behind by more than ``MAX_TIE``
    standard errors of their difference. Then it leads the next rank.
    """
    scores, influence = score_of(errors), influence_of(errors)
    leader, ranks = 0, [1]
    for place in range(1, len(scores)):
        error = standard_error(influence[..., place] - influence[..., leader])
        if scores[place] - scores[leader] > MAX_TIE * error:
            leader = place
        ranks.append(leader + 1)
    return ranks


def standings(results: xr.Dataset, groups: dict[str, list[str]]) -> pd.DataFrame:
    """Return a row for each entry, in order of score.

    Columns rank, entry, score, score_error (standard), coverage (mean over scenarios with a
    band), the score in each group of scenarios, and the error in each scenario; in %.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    order = np.argsort(score_of(errors_of(results).values), kind="stable")
    results = results.isel(method_key=order)
    errors, held = errors_of(results), results.covered.sel(quantity=MAIN)
    parts = groups | {label: [label] for label in results.scenario.values}
    columns = {
        "rank": ranks_of(errors.values),
        "entry": results.method_key,
        "score": score_of(errors.values),
        "score_error": standard_error(influence_of(errors.values)),
        "coverage": 100 * held.mean(["trial", "time"]).mean("scenario"),
        **{name: score_of(errors.sel(scenario=part).values) for name, part in parts.items()},
    }
    return pd.DataFrame(columns)


def write_leaderboard(study: Study, results: xr.Dataset, folder: Path) -> pd.DataFrame:
    """Write ``FILES`` to a folder, and return the table of standings.

    Parameters
    ----------
    study, results, folder
        As of :func:`study_of`, of this study by :func:`tvsysid.study.run`, and where to write.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    scenarios = pd.DataFrame(
        [{"kind": kind} | each._asdict() for kind, every in SCENARIOS.items() for each in every]
    )
    scenarios.insert(0, "number", scenarios.index + 1)
    groups = {kind: [each.label for each in every] for kind, every in SCENARIOS.items()}
    table = standings(results, groups)
    # Whoever is later given the seed can check that it is the same one
    seed_text = f"tvsysid leaderboard {VERSION} seed {study.seed}"
    write_table(folder / TABLE, table)
    picture = illustrated(
        figures.leaderboard,
        table,
        groups,
        title="Scores and errors",
        text="Left: rank, and score with two standard errors to either side. Right: error in each "
        "scenario, in per cent of the mean stiffness, the darker the smaller, numbered as in the "
        f"table of scenarios. {TABLE} has the same numbers.",
    )
    render(
        folder / PAGE,
        "leaderboard.html",
        standings=table.drop(columns=results.scenario.values),
        scenarios=scenarios,
        picture=draw_all({"scores": picture})["scores"],
        problems=problems(results),
        versions=settings_of(results, "versions"),
        version=version_of(results),
        number=VERSION,
        is_official=study.trials == TRIALS,
        trials=study.trials,
        seed=SEED if study.seed == SEED else None,
        commitment=hashlib.sha256(seed_text.encode()).hexdigest(),
    )
    return table
