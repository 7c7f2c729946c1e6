"""Where the figures find estimates and truth in the results of a study or an experiment: the one place that knows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


OVER_TIME = ["estimate", "truth", "time_varying_vaf"]
"""Variables of a study that are drawn over time; of an experiment, also those of :data:`TORQUES`."""
TORQUES = ["target_torque", "mean_torque"]
BANDS = ["covered", "truth"]
"""Variables that :func:`tvsysid.figures.coverage_over_time` takes."""


def estimates(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """What the methods estimated, over time and the axes of the study; NaN where there is no estimate."""
    return _of(results.estimate, quantity)


def truth(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """What the simulation knows, over scenario or recording and time; NaN where it is not known."""
    return _of(results.truth, quantity)


def covered(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Whether the 95 % band holds the truth: 1, 0, or NaN where there is no band."""
    return _of(results.covered, quantity)


def _of(values: xr.DataArray, quantity: str) -> xr.DataArray:
    found: xr.DataArray = values.sel(quantity=quantity) if "quantity" in values.dims else values
    return found


def knows_truth(results: xr.Dataset) -> bool:
    """Whether the true stiffness of anybody is known."""
    return bool(np.isfinite(truth(results).values).any())


def unique(values: Any) -> list[str]:
    """Values as text, each once, in the order of their first appearance."""
    return list(dict.fromkeys(map(str, values)))
