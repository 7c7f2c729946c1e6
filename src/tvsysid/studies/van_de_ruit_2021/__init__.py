"""Studies and claims of van de Ruit, Cavallo, Lataire, van der Helm, Mugge et al. 2021."""

from tvsysid.studies.van_de_ruit_2021.experiment import judge_experiment, write_experiment
from tvsysid.studies.van_de_ruit_2021.simulations import STUDY

__all__ = ["STUDY", "judge_experiment", "write_experiment"]
