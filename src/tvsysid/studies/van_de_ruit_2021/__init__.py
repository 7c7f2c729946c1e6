"""Studies and claims of van de Ruit, Cavallo, Lataire, van der Helm, Mugge et al. 2021."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.studies.claims import judge_claims
from tvsysid.studies.van_de_ruit_2021.experiment import CLAIMS, experiment_evidence
from tvsysid.studies.van_de_ruit_2021.folder import write_experiment
from tvsysid.studies.van_de_ruit_2021.simulations import STUDY

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["STUDY", "judge", "write_experiment"]


def judge(found: xr.Dataset) -> pd.DataFrame:
    """Test every claim of the paper on its simulations, or on its experiment, against a study.

    Parameters
    ----------
    found
        Of a simulation study its scores, as of :func:`tvsysid.study.score`; of an experiment its
        results, as of
        :func:`tvsysid.study.run`.

    Returns
    -------
    pandas.DataFrame
        A row for each claim. ``finding`` names the comparison that decides, with its figures;
        ``estimate``, ``low`` and ``high`` are its margin and 95 % limits (from drawing trials; of
        an experiment, over participants), in ``unit``: a difference speaks for the claim above 0, a
        ratio above 1. ``verdict`` is "holds", "does not hold", "undecided" or "not studied".
    """
    if "scenario" in found.dims:
        return STUDY.judge(found)
    return judge_claims(CLAIMS, experiment_evidence(found))
