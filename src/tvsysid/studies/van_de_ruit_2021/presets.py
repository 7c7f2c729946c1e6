"""Simulation studies by name: what van de Ruit et al. 2021 compare, and what they leave open."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tvsysid.errors import InputError
from tvsysid.methods import PAPER_METHODS
from tvsysid.study.scenarios import VISCOSITIES, Study, preset_study

PRESETS: dict[str, dict[str, object]] = {
    "quick": {},
    "paper": {
        "methods": PAPER_METHODS,
        "duration_s": (40.0, 80.0, 150.0, 300.0, 600.0),
        "also": ({"stiffness": ("sine",), "duration_s": (150.0,)},),
        "trials": 100,
    },
    "snr": {"snr_db": (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0), "trials": 100},
    "viscosity": {"viscosity": VISCOSITIES, "trials": 100},
}
"""Studies by name: the default, that of van de Ruit et al.

2021 with its Appendix A, and two that it leaves open.
"""


def preset(
    name: str, further: Mapping[str, dict[str, object]] = MappingProxyType({}), **settings: Any
) -> Study:
    """Return a study of ``PRESETS``: ``"quick"``, ``"paper"``, ``"snr"`` or ``"viscosity"``.

    Or of ``further`` ones.

    Settings given take the place of the preset's, in its further scenarios too. ``InputError`` for
    an unknown name, or a setting that a study does not take.

    Examples
    --------
    >>> len(preset("paper").scenarios), len(preset("paper", duration_s=40).scenarios)
    (12, 4)
    """
    known = PRESETS | dict(further)
    if name not in known:
        raise InputError(f"unknown preset {name!r}; the presets are {', '.join(known)}")
    return preset_study(known[name], **settings)
