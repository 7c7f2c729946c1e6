"""The paper's claims, held against what a study found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.studies.van_de_ruit_2021.experiment import judge_experiment
from tvsysid.studies.van_de_ruit_2021.simulations import judge_simulations

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def judge(found: xr.Dataset) -> pd.DataFrame:
    """Hold every claim that the paper makes of its simulations, or of its experiment, against a study.

    Parameters
    ----------
    found
        Of a simulation study its scores, as of :func:`tvsysid.study.score`; of an experiment its results, as of
        :func:`tvsysid.study.run`.

    Returns
    -------
    pandas.DataFrame
        A row for each claim. ``finding`` names the comparison that decides, with its figures; ``estimate``, ``low``
        and ``high`` are its margin and 95 % limits (from drawing trials; of an experiment, over participants), in
        ``unit``: a difference speaks for the claim above 0, a ratio above 1. ``verdict`` is "holds", "does not hold",
        "undecided" or "not studied".
    """
    return judge_simulations(found) if "scenario" in found.dims else judge_experiment(found)
