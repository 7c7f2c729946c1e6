"""Studies and claims of van de Ruit, Cavallo, Lataire, van der Helm, Mugge et al. 2021."""

from tvsysid.studies.van_de_ruit_2021.simulations import STUDY as STUDY
