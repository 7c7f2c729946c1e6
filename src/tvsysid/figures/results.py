"""Access to the results of a study or an experiment for its figures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures.words import TRAITS, wrapped

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def scenario_traits(results: xr.Dataset) -> pd.DataFrame:
    """Return the traits of each scenario of a study, by its label."""
    return results[list(TRAITS)].to_dataframe()[list(TRAITS)]


def of_least_data(results: xr.Dataset) -> xr.Dataset:
    """Return the stiffness by each method's analysis with the fewest realizations."""
    amounts = results.realizations.to_series()
    labels = amounts.groupby(results.method_key.to_series(), sort=False).idxmin()
    return results.sel(quantity="stiffness", analysis=labels.tolist())


def is_known(results: xr.Dataset) -> bool:
    """Whether the true stiffness of anybody is known."""
    return bool(np.isfinite(results.truth.sel(quantity="stiffness").values).any())


def unique(values: Iterable[object]) -> list[str]:
    """Return values as text, each once, in order of appearance."""
    return list(dict.fromkeys(map(str, values)))


def headings(results: xr.Dataset, width: int) -> list[str]:
    """Return method and seconds of data of each analysis, in lines of limited length."""
    period = results.sizes["time"] * float(results.time.diff("time")[0])
    pairs = zip(results.method_key.values, results.realizations.values, strict=True)
    return [wrapped(f"{method}, {number:.0f} × {period:.4g} s", width) for method, number in pairs]
