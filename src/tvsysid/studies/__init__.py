"""Published studies and their claims: a file or folder for each paper or subject."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tvsysid.errors import InputError
from tvsysid.studies import closed_loop, reflex, van_de_ruit_2021
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.study import Study

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PRESETS", "preset", "published", "van_de_ruit_2021"]

STUDIES = (van_de_ruit_2021.STUDY, reflex.STUDY, closed_loop.STUDY)
PRESETS = {name: given for study in STUDIES for name, given in study.presets.items()}
"""Settings of studies by name."""


def preset(name: str, **settings: Any) -> Study:
    """Return a study of ``PRESETS``, such as ``"quick"``, ``"paper"`` or ``"reflex"``.

    Settings given take the place of the preset's, in its further scenarios too.

    Raises
    ------
    InputError
        For an unknown name, or a setting that a study does not take.

    Examples
    --------
    >>> len(preset("paper").scenarios), len(preset("paper", duration_s=40).scenarios)
    (12, 4)
    """
    if name not in PRESETS:
        raise InputError(f"unknown preset {name!r}; the presets are {', '.join(PRESETS)}")
    return Study(**PRESETS[name]).replaced(**settings)


def published(results: xr.Dataset) -> PublishedStudy:
    """Return the claims for a simulation study: the paper's, if nothing else fits."""
    kinds = {label.partition(":")[0] for label in results.system.values}
    return next((each for each in STUDIES if kinds <= {*each.systems}), STUDIES[0])
