"""The score: from the results of a study to a table of who stands where, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.methods.registry import origin_of
from tvsysid.numerics import Array
from tvsysid.study.scores import MAIN

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DRAWS = 2000  # bootstrap draws
SURE = 2.0  # standard errors of a difference up to which it is a tie
SCORE = (
    "In each trial an entry’s error is the root mean square over time of its stiffness minus the "
    "true one, divided by the mean true stiffness, and 100 % at most; a trial that it skips or in "
    "which it fails counts as 100 %, and times that it leaves out as an estimate of 0. The score "
    "is the geometric mean over scenarios of the root-mean-square error over trials, in per cent: "
    "to halve the error in any scenario is worth the same. What stands after ± is one standard "
    "error, from drawing trials with replacement, the same ones for all entries; down the table an "
    "entry shares the rank of the one that leads it, unless it is behind by more than two standard "
    "errors of their difference, and then leads the next."
)


def errors_of(results: xr.Dataset) -> xr.DataArray:
    """Return the relative error of stiffness, at most 1, (scenario, trial, method_key)."""
    truth = (results.trial_truth if "trial_truth" in results else results.truth).sel(quantity=MAIN)
    off = results.estimate.sel(quantity=MAIN).fillna(0.0) - truth
    found: xr.DataArray = np.sqrt((off**2).mean("time")) / truth.mean("time")
    return found.clip(max=1.0).transpose("scenario", "trial", "method_key")


def scores_of(errors: Array, counts: Array | None = None) -> Array:
    r"""Score of each entry in per cent, a row for each draw.

    .. math:: 100 \exp \frac{1}{S} \sum_s \log \sqrt{\sum_t c_{dst}\, e_{ste}^2 / T}

    Errors have shape (scenario, trial, entry); how often a draw has each trial, (draw, scenario,
    trial), is once if nothing is said.
    """
    counts = np.ones((1, *errors.shape[:2])) if counts is None else counts
    squares = np.einsum("dst,ste->dse", counts, np.square(errors)) / errors.shape[1]
    return np.asarray(100 * np.exp(0.5 * np.log(squares).mean(axis=1)))


def replicates_of(errors: Array) -> Array:
    """Return scores of resampled trials, (draw, entry), with the spread of new trials."""
    scenarios, trials = errors.shape[:2]
    if trials < 2:
        return np.full((2, errors.shape[2]), np.nan)
    random = np.random.default_rng(0)
    drawn = scores_of(
        errors,
        random.multinomial(trials, np.full(trials, 1 / trials), (DRAWS, scenarios)).astype(float),
    )
    usual = drawn.mean(axis=0)
    # A bootstrap draw varies less than a sample does
    return np.asarray(usual + (drawn - usual) * np.sqrt(trials / (trials - 1)))


def ranks_of(scores: Array, replicates: Array) -> dict[str, Array]:
    """Rank the entries, with the gap ``behind`` the best remaining one and ``behind_error``."""
    order = np.argsort(scores, kind="stable").tolist()
    rank, leader = np.ones(len(scores), dtype=np.int64), order[0]
    behind, error = np.full((2, len(scores)), np.nan)
    for place, entry in enumerate(order[1:], start=2):
        behind[entry] = scores[entry] - scores[leader]
        error[entry] = np.std(replicates[:, entry] - replicates[:, leader])
        clearly = behind[entry] > SURE * error[entry]
        rank[entry] = place if clearly else rank[leader]
        leader = entry if clearly else leader
    return {"rank": rank, "behind": behind, "behind_error": error}


def answered(results: xr.Dataset) -> xr.DataArray:
    """Whether there is an estimate in any trial, over (scenario, method_key)."""
    found: xr.DataArray = results.estimate.sel(quantity=MAIN).notnull().any(["trial", "time"])
    return found


def standings(results: xr.Dataset, groups: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """Return a row for each entry, in order of score.

    Columns rank, entry, origin, score, score_error (standard), behind (who led when it was its
    turn), behind_error, coverage (mean over scenarios with a band), answered (scenarios with an
    estimate), the score in each group of scenarios, and the error in each scenario; in %.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    errors, entries = errors_of(results), [str(name) for name in results.method_key.values]
    every = {"": list(map(str, results.scenario.values)), **groups}
    every |= {name: [name] for name in every[""]}
    scores = {
        name: scores_of(errors.sel(scenario=list(part)).values)[0] for name, part in every.items()
    }
    score, replicates = scores.pop(""), replicates_of(errors.values)
    covered = results.covered.sel(quantity=MAIN).mean(["trial", "time"]).mean("scenario")
    found = ranks_of(score, replicates)
    columns: dict[str, object] = {
        "rank": found.pop("rank"),
        "entry": entries,
        "origin": list(map(origin_of, entries)),
    }
    columns |= {"score": score, "score_error": np.std(replicates, axis=0), **found}
    columns |= {
        "coverage": 100 * covered.values,
        "answered": answered(results).sum("scenario").values,
        **scores,
    }
    return pd.DataFrame(columns).sort_values("score", kind="stable", ignore_index=True)
