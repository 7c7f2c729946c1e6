"""Studies and claims of van de Ruit, Cavallo, Lataire, van der Helm, Mugge et al. 2021."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from tvsysid.methods import PAPER_METHODS
from tvsysid.report import CLAIMS as ABOUT
from tvsysid.studies.claims import judge_claims
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.studies.van_de_ruit_2021 import experiment
from tvsysid.studies.van_de_ruit_2021.experiment import COUNTS
from tvsysid.studies.van_de_ruit_2021.experiment_figures import (
    experiment_figures,
    participant_figures,
    representative,
)
from tvsysid.studies.van_de_ruit_2021.figures import example_responses, study_figures
from tvsysid.studies.van_de_ruit_2021.folder import write_experiment
from tvsysid.studies.van_de_ruit_2021.simulations import CLAIMS, paper_evidence
from tvsysid.study.scenarios import VISCOSITIES

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from tvsysid.figures import Illustration

__all__ = [
    "COUNTS",
    "STUDY",
    "example_responses",
    "experiment_figures",
    "judge",
    "participant_figures",
    "representative",
    "study_figures",
    "write_experiment",
]

PRESETS: dict[str, dict[str, object]] = {
    "quick": {},
    "paper": {
        "methods": PAPER_METHODS,
        "duration_s": (40.0, 80.0, 150.0, 300.0, 600.0),
        "also": ({"stiffness": ("sine",), "duration_s": (150.0,)},),
        "trials": 100,
    },
    "snr": {"snr_db": (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0), "trials": 100},
    "viscosity": {"viscosity": VISCOSITIES, "trials": 100},
}
"""The default study; that of the paper with its Appendix A; and two that it leaves open."""


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
    return judge_claims(experiment.CLAIMS, experiment.experiment_evidence(found))


def paper_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, with impulse responses if it has a square wave."""
    seed, has_square = json.loads(results.attrs["study"])["seed"], "square" in results.profile
    return study_figures(results, summary, example_responses(seed) if has_square else None)


STUDY: PublishedStudy = PublishedStudy(
    PRESETS, CLAIMS, ABOUT, paper_figures, lambda results: True, paper_evidence
)
