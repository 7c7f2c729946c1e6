"""Published studies and their claims: a folder for each paper or subject."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.studies import closed_loop, reflex, van_de_ruit_2021
from tvsysid.studies.claims import Published
from tvsysid.studies.van_de_ruit_2021.folder import PAPER

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PRESETS", "closed_loop", "published", "reflex", "van_de_ruit_2021"]

PRESETS = reflex.PRESETS | closed_loop.PRESETS
"""Studies by name, beside those of the paper."""


def published(results: xr.Dataset) -> Published:
    """Return the claims for a simulation study: the paper's, if nothing else fits."""
    return reflex.published(results) or closed_loop.published(results) or PAPER
