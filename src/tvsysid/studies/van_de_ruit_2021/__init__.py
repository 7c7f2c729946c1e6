"""Van de Ruit, Cavallo, Lataire, van der Helm, Mugge, van Wingerden and Schouten 2021: its studies and its claims."""

from tvsysid.studies.van_de_ruit_2021.example import example_responses
from tvsysid.studies.van_de_ruit_2021.judge import judge
from tvsysid.studies.van_de_ruit_2021.presets import PRESETS, preset

__all__ = ["PRESETS", "example_responses", "judge", "preset"]
