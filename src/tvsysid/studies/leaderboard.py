"""A leaderboard that others can enter: frozen scenarios, and a ranking of methods by one score.

What is run is frozen: to change any of it is to begin a version with a number of its own. The page
has no times, machines or folders, so that it repeats.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.figures import draw_all, leaderboard
from tvsysid.methods import CLOSED_LOOP, METHODS
from tvsysid.numerics import Array
from tvsysid.recordings.write import write_table
from tvsysid.report.page import render
from tvsysid.report.studies import problems, settings_of, version_of
from tvsysid.studies.published_study import illustrated
from tvsysid.study.scenarios import Scenario, Study
from tvsysid.study.scores import MAIN

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

VERSION = 1
SEED = 1  # of the public trials; those of an official table are kept secret
TRIALS = 10
DRAWS = 2000  # bootstrap draws
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
KINDS = {scenario: kind for kind, every in SCENARIOS.items() for scenario in every}
FILES = ("leaderboard.html", "leaderboard.csv")


def study_of(
    entries: Sequence[object] = (), scenarios: Sequence[object] = (), **changes: Any
) -> Study:
    """Return the leaderboard's study: methods of the package, and others.

    Further ``scenarios`` and ``changes`` of settings make it another one than the version's.
    """
    first, *others = (each._asdict() for each in KINDS)
    study = Study(
        **first,
        also=others,
        methods=tuple(dict.fromkeys((*METHODS, *CLOSED_LOOP, *entries))),
        subtract_mean=True,
        trials=TRIALS,
        seed=SEED,
    ).replaced(**changes)
    return attrs.evolve(study, also=(*study.also, *scenarios))


def commitment(seed: int) -> str:
    """Return the SHA-256 that is published before its seed.

    Whoever is later given the seed can check that it is the same one.
    """
    return hashlib.sha256(f"tvsysid leaderboard {VERSION} seed {seed}".encode()).hexdigest()


def errors_of(results: xr.Dataset) -> xr.DataArray:
    """Return the relative error of stiffness, at most 1, (scenario, trial, method_key)."""
    own = results.sel(quantity=MAIN)
    truth = own.get("trial_truth", own.truth)
    off = own.estimate.fillna(0.0) - truth
    errors: xr.DataArray = np.sqrt((off**2).mean("time")) / truth.mean("time")
    return errors.clip(max=1.0).transpose("scenario", "trial", "method_key")


def score_of(squares: xr.DataArray) -> xr.DataArray:
    r"""Return the score in per cent from mean squares over trials, along scenario.

    .. math:: 100 \exp \frac{1}{S} \sum_s \log \sqrt{\sum_t e_{st}^2 / T}
    """
    logarithms: Any = np.log(squares)
    score: xr.DataArray = 100 * np.exp(0.5 * logarithms.mean("scenario"))
    return score


def replicates_of(errors: xr.DataArray) -> xr.DataArray:
    """Return scores of resampled trials, (draw, method_key), with the spread of new trials."""
    import xarray as xr  # noqa: PLC0415  # heavy

    scenarios, trials, _ = errors.shape
    random, shares = np.random.default_rng(0), np.full(trials, 1 / trials)
    counts = random.multinomial(trials, shares, (DRAWS, scenarios))
    weights = xr.DataArray(counts / trials, dims=("draw", "scenario", "trial"))
    drawn: Any = score_of(xr.dot(weights, errors**2, dim="trial"))
    # A bootstrap draw varies less than a sample does; one trial has no spread
    mean, wider = drawn.mean(dim="draw"), np.sqrt(trials / (trials - 1 or np.nan))
    replicates: xr.DataArray = mean + wider * (drawn - mean)
    return replicates.transpose("draw", ...)


def ranks_of(scores: Array, replicates: Array) -> list[int]:
    """Rank entries in the order of their scores.

    An entry shares the rank of the one that leads it, unless it is behind by more than ``MAX_TIE``
    standard errors of their difference. Then it leads the next rank.
    """
    leader, ranks = 0, [1]
    for place in range(1, len(scores)):
        error = np.std(replicates[:, place] - replicates[:, leader])
        if scores[place] - scores[leader] > MAX_TIE * error:
            leader = place
        ranks.append(leader + 1)
    return ranks


def standings(results: xr.Dataset, groups: Mapping[str, list[str]]) -> pd.DataFrame:
    """Return a row for each entry, in order of score.

    Columns rank, entry, score, score_error (standard), coverage (mean over scenarios with a
    band), the score in each group of scenarios, and the error in each scenario; in %.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    errors, own = errors_of(results), results.sel(quantity=MAIN)
    squares, replicates = (errors**2).mean("trial"), replicates_of(errors)
    labels = results.scenario.values.tolist()
    parts = {**groups, **{label: [label] for label in labels}}
    columns = {
        "entry": results.method_key,
        "score": score_of(squares),
        "score_error": replicates.std("draw"),
        "coverage": 100 * own.covered.mean(["trial", "time"]).mean("scenario"),
        **{name: score_of(squares.sel(scenario=part)) for name, part in parts.items()},
    }
    table = pd.DataFrame(columns).sort_values("score", kind="stable")
    ranks = ranks_of(table.score.to_numpy(), replicates.values[:, table.index])
    table.insert(0, "rank", ranks)
    return table.reset_index(drop=True)


def write_leaderboard(study: Study, results: xr.Dataset, folder: Path) -> pd.DataFrame:
    """Write ``FILES`` to a folder, and return the table of standings.

    Parameters
    ----------
    study, results, folder
        As of :func:`study_of`, of this study by :func:`tvsysid.study.run`, and where to write.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    scenarios = pd.DataFrame(study.scenarios, index=[each.label for each in study.scenarios])
    scenarios.insert(0, "number", range(1, len(scenarios) + 1))
    scenarios.insert(1, "kind", [KINDS.get(each, "further") for each in study.scenarios])
    groups = {str(kind): list(rows.index) for kind, rows in scenarios.groupby("kind", sort=False)}
    table = standings(results, groups)
    write_table(folder / FILES[1], table)
    picture = illustrated(
        leaderboard,
        table,
        groups,
        title="Scores and errors",
        text="Left: rank, and score with two standard errors to either side. Right: error in each "
        "scenario, in per cent of the mean stiffness, the darker the smaller, numbered as in the "
        "table of scenarios. The tables have the same numbers.",
    )
    numbered = ["entry", *map(str, scenarios.number)]
    render(
        folder / FILES[0],
        "leaderboard.html",
        standings=table.drop(columns=scenarios.index),
        errors=table[["entry", *scenarios.index]].set_axis(numbered, axis=1),
        scenarios=scenarios,
        picture=draw_all({"scores": picture})["scores"],
        problems=problems(results),
        versions=settings_of(results, "versions"),
        version=version_of(results),
        number=VERSION,
        is_official=(study.scenarios, study.trials) == (tuple(KINDS), TRIALS),
        trials=study.trials,
        seed=SEED if study.seed == SEED else None,
        commitment=commitment(study.seed),
    )
    return table
