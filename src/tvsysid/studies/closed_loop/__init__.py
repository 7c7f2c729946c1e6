"""Study of a compliant actuator: methods with and without a reference, and claims on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tvsysid.studies.closed_loop.claims import judge
from tvsysid.studies.closed_loop.figures import loop_figures, loop_of
from tvsysid.studies.closed_loop.presets import PRESETS
from tvsysid.studies.scored import HOW_DECIDED
from tvsysid.studies.van_de_ruit_2021.folder import Published

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LITERATURE", "PRESETS", "judge", "loop_figures", "published"]

LITERATURE = Published(
    judge,
    loop_figures,
    f"What is said of joints in closed loop, and whether this study finds it. {HOW_DECIDED}",
    tuple(PRESETS),
)


def published(results: xr.Dataset) -> Published | None:
    """Return the claims for a simulation study, if all its systems are closed loops."""
    return (
        LITERATURE if all(loop_of(label) is not None for label in results.system.values) else None
    )
