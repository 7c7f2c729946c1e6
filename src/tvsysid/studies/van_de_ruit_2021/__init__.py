"""Studies and claims of van de Ruit, Cavallo, Lataire, van der Helm, Mugge et al. 2021."""

from tvsysid.studies.van_de_ruit_2021.experiment import COUNTS
from tvsysid.studies.van_de_ruit_2021.experiment_figures import (
    experiment_figures,
    participant_figures,
    representative,
)
from tvsysid.studies.van_de_ruit_2021.figures import example_responses, study_figures
from tvsysid.studies.van_de_ruit_2021.folder import Written, judge, write_experiment, write_study
from tvsysid.studies.van_de_ruit_2021.presets import PRESETS, preset

__all__ = [
    "COUNTS",
    "PRESETS",
    "Written",
    "example_responses",
    "experiment_figures",
    "judge",
    "participant_figures",
    "preset",
    "representative",
    "study_figures",
    "write_experiment",
    "write_study",
]
