"""Studies that were published, and what they claim: a folder for each paper."""

from tvsysid.studies import van_de_ruit_2021

__all__ = ["van_de_ruit_2021"]
