"""Why settings were chosen: a criterion, and its value for all that were tried."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What speaks for settings that were chosen from data.

    Parameters
    ----------
    criterion
        What was compared.
    unit
        Of the criterion.
    better
        Which values are better.
    tried
        Settings by name, for each trial; the first are those that the method had before.
    values
        The criterion for each, shape (trial,).
    standard_errors
        Of each value's difference from the first, shape (trial,); NaN where the criterion has none.
    chosen
        Which was chosen.
    axis
        What the trials are drawn against, with its unit.
    positions
        Where on it, shape (trial,).
    lines
        What else they differ in, for each: trials of one name make one line.
    """

    criterion: str
    unit: str
    better: Literal["higher", "lower"]
    tried: tuple[Mapping[str, Any], ...]
    values: Array
    standard_errors: Array
    chosen: int
    axis: str
    positions: Array
    lines: tuple[str, ...]

    def __post_init__(self) -> None:
        for values in (self.values, self.standard_errors, self.positions):
            values.flags.writeable = False

    @property
    def settings(self) -> Mapping[str, Any]:
        """Those chosen, by name."""
        return self.tried[self.chosen]

    @property
    def gain(self) -> float:
        """By how much the criterion is better than with the settings that the method had before."""
        difference = float(self.values[self.chosen] - self.values[0])
        return difference if self.better == "higher" else 0.0 - difference

    def __str__(self) -> str:
        tried = f"; {len(self.values)} tried"
        if self.chosen == 0:
            return f"{_told(self.settings)} as given: nothing else has a clearly better {self.criterion}{tried}"
        return (
            f"{_told(self.settings)} instead of {_told(self.tried[0])}: {self.criterion} better by {self.gain:.3g} "
            f"{self.unit}{tried}"
        )

    def __repr__(self) -> str:
        return f"Evidence({self})"

    def _repr_html_(self) -> str:
        table = self.to_pandas().to_html(index=False, na_rep="", float_format="{:.4g}".format)
        return f"<p>{html.escape(str(self))}</p>{table}"

    def to_pandas(self) -> pd.DataFrame:
        """A row for each trial: settings, criterion, its value and unit, standard error, and whether it was chosen."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(
            {
                "settings": [_told(settings) for settings in self.tried],
                "criterion": self.criterion,
                "value": self.values,
                "unit": self.unit,
                "standard_error": self.standard_errors,
                "chosen": np.arange(len(self.values)) == self.chosen,
            }
        )


def _told(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={_short(value)}" for name, value in settings.items())


def _short(value: Any) -> str:
    """Numbers with four digits."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"({', '.join(map(_short, value))})" if isinstance(value, tuple) else repr(value)
