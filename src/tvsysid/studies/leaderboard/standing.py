"""The score: from the results of a study to a table of who stands where, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.methods.registry import origin_of
from tvsysid.numerics import Array
from tvsysid.study.scores import MAIN

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DRAWS = 2000  # bootstrap draws
MAX_TIE = 2.0  # standard errors of a difference up to which entries share a rank
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
    scenarios, trials, entries = errors.shape
    if trials < 2:
        return np.full((DRAWS, entries), np.nan)
    random, share = np.random.default_rng(0), np.full(trials, 1 / trials)
    counts = random.multinomial(trials, share, (DRAWS, scenarios)).astype(float)
    drawn = scores_of(errors, counts)
    # A bootstrap draw varies less than a sample does
    wider = np.sqrt(trials / (trials - 1))
    return np.asarray(drawn * wider + drawn.mean(axis=0) * (1 - wider))


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

    Columns rank, entry, origin, score, score_error (standard), behind (gap to the leader of its
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
        "origin": [origin_of(entry) for entry in entries],
        "score": score,
        "score_error": replicates.std(axis=0),
        **ranks,
        "coverage": 100 * own.covered.mean(["trial", "time"]).mean("scenario"),
        "answered": own.estimate.notnull().any(["trial", "time"]).sum("scenario"),
        **{name: scores_of(errors.sel(scenario=part).values)[0] for name, part in parts.items()},
    }
    return pd.DataFrame(columns).sort_values("score", kind="stable", ignore_index=True)
