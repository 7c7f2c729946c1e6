"""Experiments like that of van de Ruit et al. (2021): its claims, and what is written of them.

Samples are the numbers of participants, with limits of a t distribution. The paper gives no
thresholds: those here are ours, and part of the sentences.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import t as student

from tvsysid.figures.saving import draw_all
from tvsysid.methods import PAPER_METHODS as FIVE
from tvsysid.numerics import Array
from tvsysid.recordings import write_ensemble, write_table
from tvsysid.report import write_diagnosis, write_experiment_report
from tvsysid.report.experiment import REPORTED, experiment_figures, stiffness_to_report
from tvsysid.studies.claims import (
    HIGHER,
    HIGHER_RATIO,
    Claim,
    Evidence,
    Margin,
    claim,
    judge_claims,
    ranked,
    ratio,
)
from tvsysid.studies.published_study import Written
from tvsysid.study import Prepared, exclusions, score, stiffness_over_time, summarize
from tvsysid.study.bootstraps import COUNTED
from tvsysid.study.experiment import PREPARATION

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

FOUR = FIVE[:4]  # all but kbr
MIN_PARTICIPANTS = 3  # below which nothing is decided
RECORDED = 300  # realizations from each of the paper's participants under either perturbation
SURVIVED = {"noise": (260, 12), "prbs": (255, 14)}
"""Mean and standard deviation of the paper's survivors of 300 realizations (section 4.4)."""
EXCLUDED = {
    "noise": {"alignment": (0, 3), "task": (4, 12), "residual": (17, 29)},
    "prbs": {"alignment": (5, 40), "task": (3, 10), "residual": (15, 20)},
}
"""Range over the paper's participants of what each step excluded (section 4.1.5)."""
ANY_METHOD, ALL_DATA = "any method", "all data"  # that counts of realizations belong to
LESS, MORE = "less data", "more data"
UNITS = {
    "vaf": "%",
    "bandpassed_vaf": "%",
    "vaf_dip": "%",
    "random_error": "N·m/rad",
    "mean": "N·m/rad",
    "correlation_with_torque": "",
    **dict.fromkeys(COUNTED, "realizations"),
}
"""Unit of each quantity."""


def experiment_evidence(results: xr.Dataset, scores: xr.Dataset) -> Evidence:
    """Return the numbers of participants by quantity, method, perturbation and amount of data.

    Counts are of 300 realizations, as in the paper. Numbers that no participant has are left out.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    rank = results.realizations.to_series().groupby(results.method_key.to_series()).rank()
    amounts = ("analysis", rank.map({1.0: LESS, 2.0: MORE}))
    counts = RECORDED * results[[*COUNTED]] / results.recorded
    parts = (
        counts.assign_coords(method_key=ANY_METHOD, amount=ALL_DATA),
        analysis_quantities(results, scores).assign_coords(amount=amounts),
    )
    table = pd.concat([part.to_dataframe().reset_index() for part in parts])
    kinds = ["method_key", "perturbation", "amount"]
    table = table.dropna(subset="amount").pivot(index="participant", columns=kinds, values=[*UNITS])
    known = table.dropna(axis=1, how="all")
    return Evidence(known.to_dict("series"), UNITS, participant_interval)


def analysis_quantities(results: xr.Dataset, scores: xr.Dataset) -> xr.Dataset:
    """Return the quantities of each recording's analyses.

    ``vaf_dip`` is the time-varying VAF at a period's quarters less that at its ends and middle, a
    tenth of the period each.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    time, vaf = results.time.values, results.time_varying_vaf.mean("bootstrap")
    turn, near = np.cos(4 * np.pi * time / (time[-1] + time[1])), np.cos(np.pi / 5)
    stiffness = results.estimate.sel(quantity="stiffness", drop=True).mean("bootstrap")
    values: xr.Dataset = scores.value.drop_vars("unit").to_dataset("metric")
    return values.assign(
        vaf_dip=vaf[..., turn < -near].mean("time") - vaf[..., turn > near].mean("time"),
        correlation_with_torque=xr.corr(stiffness, results.mean_torque, "time"),
    )


def participant_interval(samples: Array, tail: float) -> tuple[float, float, float]:
    """Return mean and limits of a t distribution over participants; no limits of two or fewer."""
    import pandas as pd  # noqa: PLC0415  # heavy

    known = pd.Series(samples).dropna()
    error = known.sem() if len(known) >= MIN_PARTICIPANTS else np.nan
    mean, width = known.mean(), student.isf(tail, len(known) - 1) * error
    return mean, mean - width, mean + width


LOWEST, HIGHEST = (partial(extreme, key=np.nanmean) for extreme in (min, max))
"""Methods with the lowest and the highest mean over participants."""
KBR = (
    "Why it should be so the paper does not say. Fitted to 20 Hz, ours predicts what inertia does "
    "as well as the other methods do, and so gains by PRBS as they do."
)
ALIKE = "The fluctuations of a virtual participant's torque are the same under either perturbation."
EITHER, BOTH = ("noise", "prbs"), [("prbs", "noise")]
AMOUNTS = [(LESS, MORE)]

CLAIMS = (
    Claim(
        "Some 255 to 260 of 300 realizations survive (within one standard deviation of the paper's "
        "mean)", "4.4",
        [
            (Margin(mean - sd, mean + sd), "survivors", ANY_METHOD, name, ALL_DATA)
            for name, (mean, sd) in SURVIVED.items()
        ],
    ),
    Claim(
        "Each step excludes as many realizations, on average, as in the paper (within the range of "
        "its participants)", "4.1.5",
        [
            (Margin(low - 0.5, high + 0.5), f"excluded_{step}", ANY_METHOD, name, ALL_DATA)
            for name, excluded in EXCLUDED.items()
            for step, (low, high) in excluded.items()
        ],
    ),
    claim(
        "PRBS gives 20 to 30 % more VAF than noise for all but kbr", "4.4",
        Margin(20, 30), "vaf", FOUR, BOTH, LESS,
    ),
    claim(
        "PRBS gives more VAF than noise for all but kbr", "4.4", HIGHER, "vaf", FOUR, BOTH, LESS
    ),
    Claim(
        "VAFs lie near the paper's of 150 s: 75 to 87 % with PRBS, 49 to 63 % with noise (within 5 "
        "points)", "4.4",
        [
            (Margin(level - 5, level + 5, which), "vaf", [FOUR], name, LESS)
            for name, which, level in (
                ("prbs", LOWEST, 74.8), ("prbs", HIGHEST, 87.2),
                ("noise", LOWEST, 49.4), ("noise", HIGHEST, 62.7),
            )
        ],
    ),
    claim(
        "kbr has more VAF with noise than with PRBS", "4.4",
        Margin(high=0), "vaf", "kbr", BOTH, LESS, disagreement=KBR,
    ),
    claim(
        "Between 1 and 10 Hz, PRBS gives less VAF than noise", "4.4",
        Margin(high=0), "bandpassed_vaf", FIVE, BOTH, LESS,
    ),
    claim(
        "Between 1 and 10 Hz, PRBS gives about 10 % less VAF than noise (5 to 15)", "4.4",
        Margin(-15, -5), "bandpassed_vaf", FIVE, BOTH, LESS, disagreement=ALIKE,
    ),
    claim(
        "The random error falls with more data (in the paper from 150 s to 300 s)", "4.4",
        HIGHER_RATIO, "random_error", FIVE, EITHER, AMOUNTS,
    ),
    claim(
        "The mean stiffness stays as it is with more data (changes by less than 5 %)", "4.4",
        ratio(1 / 1.05, 1.05), "mean", FIVE, EITHER, AMOUNTS,
    ),
    claim(
        "The random error is largest for eirf", "4.4",
        HIGHER_RATIO, "random_error", ranked("eirf > sds birf esm kbr"), EITHER, LESS,
    ),
    claim(
        "The random error is smallest for birf", "4.4",
        HIGHER_RATIO, "random_error", ranked("eirf sds esm kbr > birf"), EITHER, LESS,
    ),
    claim(
        "The random error of kbr is larger with PRBS than with noise", "4.4",
        HIGHER_RATIO, "random_error", "kbr", BOTH, LESS,
    ),
    claim(
        "More data do not raise the VAF by 1 point or more, as the torque's noise limits it", "4.4",
        Margin(-1), "vaf", FIVE, EITHER, AMOUNTS,
    ),
    claim(
        "Stiffness rises with torque (correlation over time above 0.5)", "4.4",
        Margin(0.5), "correlation_with_torque", FIVE, EITHER, LESS,
    ),
    claim(
        "The time-varying VAF is lower at the beginning and the middle of a realization", "4.4",
        HIGHER, "vaf_dip", FOUR, EITHER, LESS,
    ),
)  # fmt: skip
"""In the order of the paper."""


def judge_experiment(results: xr.Dataset, scores: xr.Dataset) -> pd.DataFrame:
    """Return a row for each claim, as :meth:`PublishedStudy.judge`, for an experiment.

    Scores are those of the results, as of :func:`tvsysid.study.score`. Limits are over
    participants. There are no rows if the protocol is not the paper's: filtered noise or PRBS,
    realizations of 2 s at 128 Hz, aligned to a torque ``target`` that was followed.
    """
    made = json.loads(results.attrs["experiment"]).get("preparation", PREPARATION)
    is_papers = made == PREPARATION and {*results.perturbation.values} <= {*SURVIVED}
    return judge_claims(CLAIMS if is_papers else (), experiment_evidence(results, scores))


def write_experiment(
    results: xr.Dataset,
    prepared: Sequence[Prepared],
    folder: Path,
    command: str = "",
    executor: Executor | None = None,
) -> Written:
    """Write tables, ensembles, figures and pages of an experiment.

    Parameters
    ----------
    results, folder, command
        As for :meth:`tvsysid.studies.published_study.PublishedStudy.write`.
    prepared
        The recordings; none, if they are gone: then ``answers.csv``, ``exclusions.csv`` and
        ``prepared/`` stay as they are.
    executor
        Finds the stiffness to report, and draws; None does it in this process.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    call_each = executor.map if executor else map
    found = stiffness_to_report(prepared, results, call_each)
    for each in prepared:
        if each.ensemble:
            write_ensemble(folder / "prepared" / f"{each.recorded.label}.nc", each.ensemble)
    scores = score(results)
    summary, claims = summarize(scores), judge_experiment(results, scores)
    figures = experiment_figures(results, summary, prepared)
    # The last figures, those of all realizations, take longest. They are drawn first.
    drawn = draw_all(dict(reversed(figures.items())), folder / "figures", call_each)
    pictures = dict(reversed(drawn.items()))
    tables = {"summary.csv": summary, "stiffness.csv": stiffness_over_time(results)}
    files = ["report.html", "figures/"]
    if len(claims):
        tables["claims.csv"] = claims
    if prepared:
        reported = list(found)
        rows = [each[: len(REPORTED)] for each in reported]
        tables["answers.csv"] = pd.DataFrame(rows, columns=REPORTED)
        tables["exclusions.csv"] = exclusions(prepared)
        diagnoses = {each.recording: each.diagnosis for each in reported if each.diagnosis}
        seen = {each.recording: each.picture for each in reported if each.picture}
        write_diagnosis(folder / "diagnosis.html", diagnoses, command, pictures=seen)
        files += ["prepared/", "diagnosis.html"]
    for name, table in tables.items():
        write_table(folder / name, table)
    file = folder / "answers.csv"  # may be of an earlier call, which had the recordings
    answers = pd.read_csv(file, dtype=str, keep_default_na=False) if file.exists() else None
    page = folder / "report.html"
    write_experiment_report(page, results, summary, claims, pictures, command, answers)
    return Written(summary, claims, [*files, *tables], answers)
