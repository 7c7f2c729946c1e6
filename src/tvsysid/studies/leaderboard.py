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

from tvsysid.figures import Illustration, draw_all, leaderboard
from tvsysid.methods import CLOSED_LOOP, METHODS
from tvsysid.numerics import Array
from tvsysid.report import write_leaderboard_page
from tvsysid.studies.published_study import write_tables
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
PICTURE = (
    "Left: rank, and score with two standard errors to either side. Right: error in each scenario, "
    "in per cent of the mean stiffness, the darker the smaller, numbered as in the table of "
    "scenarios. The tables have the same numbers."
)


def study_of(
    entries: Sequence[object] = (), scenarios: Sequence[object] = (), **changes: Any
) -> Study:
    """Return the leaderboard's study: methods of the package, and others.

    Further ``scenarios`` and ``changes`` of settings make it another one than the version's.
    """
    first, *others = (each._asdict() for each in KINDS)
    methods = dict.fromkeys((*METHODS, *CLOSED_LOOP, *entries))
    fixed: dict[str, Any] = {
        "subtract_mean": True,
        "trials": TRIALS,
        "seed": SEED,
        "methods": tuple(methods),
    }
    study = Study(**{**first, **fixed, "also": others}).replaced(**changes)
    return attrs.evolve(study, also=(*study.also, *scenarios))


def commitment(seed: int) -> str:
    """Return the SHA-256 that is published before its seed.

    Whoever is later given the seed can check that it is the same one.
    """
    return hashlib.sha256(f"tvsysid leaderboard {VERSION} seed {seed}".encode()).hexdigest()


def errors_of(results: xr.Dataset) -> xr.DataArray:
    """Return the relative error of stiffness, at most 1, (scenario, trial, method_key)."""
    own = results.sel(quantity=MAIN)
    truth = own.trial_truth if "trial_truth" in own else own.truth
    off = own.estimate.fillna(0.0) - truth
    errors: xr.DataArray = np.sqrt((off**2).mean("time")) / truth.mean("time")
    return errors.clip(max=1.0).transpose("scenario", "trial", "method_key")


def scores_of(errors: Array, counts: Array | None = None) -> Array:
    r"""Return the score of each entry in per cent, a row for each draw.

    .. math:: 100 \exp \frac{1}{S} \sum_s \log \sqrt{\sum_t c_{dst}\, e_{ste}^2 / T}

    Errors have shape (scenario, trial, entry); ``counts``, how often a draw has each trial, has
    shape (draw, scenario, trial). None has each once.
    """
    counts = np.ones((1, *errors.shape[:2])) if counts is None else counts
    squares = np.einsum("dst,ste->dse", counts, errors**2) / errors.shape[1]
    return np.asarray(100 * np.exp(0.5 * np.log(squares).mean(axis=1)))


def replicates_of(errors: Array) -> Array:
    """Return scores of resampled trials, (draw, entry), with the spread of new trials."""
    scenarios, trials, _ = errors.shape
    counts = np.random.default_rng(0).multinomial(
        trials, np.full(trials, 1 / trials), (DRAWS, scenarios)
    )
    drawn = scores_of(errors, counts.astype(np.float64))
    # A bootstrap draw varies less than a sample does; one trial has no spread
    mean, wider = drawn.mean(axis=0), np.sqrt(trials / (trials - 1 or np.nan))
    return np.asarray(mean + wider * (drawn - mean))


def ranks_of(scores: Array, replicates: Array) -> dict[str, Array]:
    """Rank the entries, with the gap ``behind`` the best remaining one and ``behind_error``."""
    leader, *others = np.argsort(scores, kind="stable").tolist()
    rank = np.ones(len(scores), dtype=np.int64)
    behind, error = np.full((2, len(scores)), np.nan)
    for place, entry in enumerate(others, start=2):
        behind[entry] = scores[entry] - scores[leader]
        error[entry] = np.std(replicates[:, entry] - replicates[:, leader])
        rank[entry] = rank[leader]
        if behind[entry] > MAX_TIE * error[entry]:
            rank[entry], leader = place, entry
    return {"rank": rank, "behind": behind, "behind_error": error}


def standings(results: xr.Dataset, groups: Mapping[str, list[str]]) -> pd.DataFrame:
    """Return a row for each entry, in order of score.

    Columns rank, entry, score, score_error (standard), behind (gap to the leader of its
    rank, or of the next better one), behind_error, coverage (mean over scenarios with a band),
    answered (scenarios with an estimate), the score in each group of scenarios, and the error in
    each scenario; in %.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    errors, own = errors_of(results), results.sel(quantity=MAIN)
    entries, labels = (results[dim].values.tolist() for dim in ("method_key", "scenario"))
    score, replicates = scores_of(errors.values)[0], replicates_of(errors.values)
    ranks = ranks_of(score, replicates)
    parts = {**groups, **{label: [label] for label in labels}}
    columns = {
        "rank": ranks.pop("rank"),
        "entry": entries,
        "score": score,
        "score_error": replicates.std(axis=0),
        **ranks,
        "coverage": 100 * own.covered.mean(["trial", "time"]).mean("scenario"),
        "answered": own.estimate.notnull().any(["trial", "time"]).sum("scenario"),
        **{name: scores_of(errors.sel(scenario=part).values)[0] for name, part in parts.items()},
    }
    return pd.DataFrame(columns).sort_values("score", kind="stable", ignore_index=True)


def scenarios_of(study: Study) -> pd.DataFrame:
    """Return number, kind and settings of each scenario, by label."""
    import pandas as pd  # noqa: PLC0415  # heavy

    table = pd.DataFrame(study.scenarios, index=[each.label for each in study.scenarios])
    table.insert(0, "number", range(1, len(table) + 1))
    table.insert(1, "kind", [KINDS.get(each, "further") for each in study.scenarios])
    return table


def write_leaderboard(study: Study, results: xr.Dataset, folder: Path) -> pd.DataFrame:
    """Write ``FILES`` to a folder, and return the table of standings.

    Parameters
    ----------
    study, results, folder
        As of :func:`study_of`, of this study by :func:`tvsysid.study.run`, and where to write.
    """
    scenarios = scenarios_of(study)
    groups = {str(kind): list(rows.index) for kind, rows in scenarios.groupby("kind", sort=False)}
    table = standings(results, groups)
    write_tables(folder, {FILES[1]: table})
    picture = Illustration(
        lambda: leaderboard(table, groups), "Scores and errors", PICTURE, ("svg",)
    )
    write_leaderboard_page(
        folder / FILES[0],
        results,
        table,
        scenarios,
        draw_all({"scores": picture})["scores"],
        number=VERSION,
        is_official=(study.scenarios, study.trials) == (tuple(KINDS), TRIALS),
        trials=study.trials,
        seed=SEED if study.seed == SEED else None,
        commitment=commitment(study.seed),
    )
    return table
