"""Studies that were published, and what they claim: a folder for each paper, or for what several say of one thing."""

from tvsysid.studies import reflex, van_de_ruit_2021

__all__ = ["reflex", "van_de_ruit_2021"]
