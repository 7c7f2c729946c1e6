"""Study of a joint with a stretch reflex: methods with one and two pathways, and claims on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.studies.reflex.claims import judge
from tvsysid.studies.reflex.figures import reflex_figures
from tvsysid.studies.reflex.presets import PRESETS
from tvsysid.studies.scored import HOW_DECIDED
from tvsysid.studies.van_de_ruit_2021.folder import Published

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LITERATURE", "PRESETS", "judge", "published", "reflex_figures"]

LITERATURE = Published(
    judge,
    reflex_figures,
    "What the literature says of reflexes and of methods that separate them, and whether this "
    "study finds it. " + HOW_DECIDED,
    tuple(PRESETS),
)


def published(results: xr.Dataset) -> Published | None:
    """Return the claims for a simulation study of a joint with a reflex."""
    if (
        "reflex_gain" not in results.quantity.values
        or results.truth.sel(quantity="reflex_gain").isnull().any()
    ):
        return None
    return LITERATURE if results.estimate.sel(quantity="reflex_gain").notnull().any() else None
