"""Tables of all that methods estimate, for the command line and pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tvsysid.comparison.comparison import Comparison, describe_values
from tvsysid.figures.words import unit_name
from tvsysid.models import IMPEDANCE, OVER_TIME

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ["method", "quantity", "unit", "over", "mean", "band ±", "lowest", "lowest at (s)"]
COLUMNS += ["highest", "highest at (s)"]
TIMES = [", ".join(axes) for axes in OVER_TIME]
DETAILS = {
    "delay": ("delay of the reflex", "s"),
    "frequency": ("frequency of the muscle", "rad/s"),
    "damping": ("damping of the muscle", ""),
    "threshold": ("threshold of the reflex", "rad/s"),
    "vaf_intrinsic": ("VAF, intrinsic", "%"),
    "vaf_reflex": ("VAF, reflex", "%"),
    "vaf_folds": ("VAF, five folds", "%"),
}
"""Names and units of what models with a reflex know beside their estimates."""


def estimates(found: Comparison) -> pd.DataFrame:
    """Return all that the methods estimate: mean, half width of the 95 % band, and extremes.

    Estimates over time have the times of the extremes. A constant has no extremes. A reflex has its
    shape, with the share of the torque's variance that each pathway explains.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    rows = []
    for label, model in found.models.items():
        for name, estimate in model.estimates.items():
            about = label, name.replace("_", " "), unit_name(estimate.unit)
            described = describe_values(estimate.values, estimate.band())
            if estimate.axes in OVER_TIME:
                described = describe_values(model.over_time(name), model.band(name), model.time)
            if np.isfinite(described[0]):
                rows.append((*about, ", ".join(estimate.axes), *described))
        details = model.diagnostics.details
        for name in filter(details.__contains__, DETAILS):
            half = 1.96 * details.get(f"{name}_error", np.nan)
            rows.append((label, *DETAILS[name], "", details[name], half, *[np.nan] * 4))
    return pd.DataFrame(rows, columns=COLUMNS)


def further(found: Comparison) -> pd.DataFrame:
    """Return the estimates beside stiffness, viscosity and inertia over time."""
    table = estimates(found)
    return table[~(table.over.isin(TIMES) & table.quantity.isin(IMPEDANCE))]
