"""Tables of all that methods estimate, for the command line and pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tvsysid.comparison import Comparison
from tvsysid.figures.words import unit_name
from tvsysid.models import IMPEDANCE, OVER_TIME
from tvsysid.numerics.bands import mean_of

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ["method", "quantity", "unit", "over", "mean", "half_band", "lowest", "lowest at (s)"]
COLUMNS += ["highest", "highest at (s)"]
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

    Times of the extremes are those of estimates over time. A reflex has its shape, with the share
    of the torque's variance that each pathway explains.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    rows = []
    for label, model in found.models.items():
        for name, estimate in model.estimates.items():
            values, (lower, upper) = estimate.values, estimate.limits()
            if is_over_time := estimate.axes in OVER_TIME:
                values, (lower, upper) = model.over_time(name), model.limits(name)
            if not np.isfinite(values).any():
                continue
            row = {
                "method": label,
                "quantity": name.replace("_", " "),
                "unit": unit_name(estimate.unit),
                "over": ", ".join(estimate.axes),
                "mean": mean_of(values),
                "half_band": mean_of(upper - lower) / 2,
                "lowest": float(np.nanmin(values)),
                "highest": float(np.nanmax(values)),
            }
            if is_over_time:
                row["lowest at (s)"] = model.time[np.nanargmin(values)]
                row["highest at (s)"] = model.time[np.nanargmax(values)]
            rows.append(row)
        details = model.diagnostics.details
        for name in filter(details.__contains__, DETAILS):
            half = 1.96 * details.get(f"{name}_error", float("nan"))
            row = {"method": label, "over": "", "mean": details[name], "half_band": half}
            rows.append(row | dict(zip(("quantity", "unit"), DETAILS[name], strict=True)))
    return pd.DataFrame(rows, columns=COLUMNS)


def further(found: Comparison) -> pd.DataFrame:
    """Return the estimates beside stiffness, viscosity and inertia over time."""
    table = estimates(found)
    return table[table["lowest at (s)"].isna() | ~table.quantity.isin(IMPEDANCE)]
