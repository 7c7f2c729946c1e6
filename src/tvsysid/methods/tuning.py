"""Settings chosen from data: the evidence for them, and methods that choose their own."""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.arrays import read_only
from tvsysid.methods.base import Choice, Method
from tvsysid.models import Model
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@attrs.frozen(eq=False, repr=False)
class Evidence:
    """Settings that were tried on data, and how good each is.

    Parameters
    ----------
    criterion
        What measures how good settings are: a log evidence in nat.
    tried
        Settings by name; the first are those that the method had before.
    values
        Criterion of each of them.
    chosen
        Position of the settings that were chosen.
    axis, positions, lines
        How a figure shows them: axis, position on it, and name of the line.
    """

    criterion: str
    tried: tuple[Mapping[str, Any], ...]
    values: Array = attrs.field(converter=read_only)
    chosen: int
    axis: str
    positions: Array = attrs.field(converter=read_only)
    lines: tuple[str, ...]

    @property
    def settings(self) -> Mapping[str, Any]:
        """Return the settings that were chosen, by name."""
        return self.tried[self.chosen]

    @property
    def gain(self) -> float:
        """Return the gain over the first settings in nat."""
        return float(self.values[self.chosen] - self.values[0])

    def __str__(self) -> str:
        chosen, given = _as_text(self.settings), _as_text(self.tried[0])
        result = f"{chosen} as given: nothing else has a clearly better {self.criterion}"
        if self.chosen != 0:
            result = f"{chosen} instead of {given}: {self.criterion} better by {self.gain:.3g} nat"
        return f"{result}; {len(self.values)} tried"

    def plot(self, title: str = "") -> Figure:
        """Draw the criterion against the settings."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above

        return plot(self, title)

    def __repr__(self) -> str:
        return f"Evidence({self})"

    def to_pandas(self) -> pd.DataFrame:
        """Return a table: a row for each of the settings that were tried."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(
            {
                "settings": list(map(_as_text, self.tried)),
                "criterion": self.criterion,
                "value": self.values,
                "unit": "nat",
                "chosen": np.arange(len(self.values)) == self.chosen,
            }
        )


def _as_text(settings: Mapping[str, object]) -> str:
    return ", ".join(f"{name}={rounded(value)}" for name, value in settings.items())


def rounded(value: object) -> str:
    """Return a setting as text, with at most four digits of a number."""
    if isinstance(value, float):
        return repr(float(f"{value:.4g}"))
    return f"({', '.join(map(rounded, value))})" if isinstance(value, tuple) else repr(value)


@attrs.frozen
class Tuned(Method):
    """Method that chooses its settings anew from each ensemble; ``kbr:tuned=true`` as text.

    The model's ``method`` tells the settings that were chosen.

    Parameters
    ----------
    method
        Method with the settings to begin with.

    Examples
    --------
    >>> from tvsysid.methods import KernelRegression
    >>> Tuned(KernelRegression()).title
    'Kernel-based regression, tuned'
    """

    method: Method

    @property
    def title(self) -> str:  # type: ignore[override]
        """Return the title of the method."""
        return f"{self.method.title}, tuned"

    def tuned(self, ensemble: Ensemble) -> Choice:
        """Choose the settings."""
        return self.method.tuned(ensemble)

    def fit(self, ensemble: Ensemble) -> Model:
        """Choose the settings, and identify by them; warnings are those of the method."""
        return self.tuned(ensemble).method.identify(ensemble)

    identify = fit


# All other attributes of a tuned method are those of the method.
for _name in {*Method.__annotations__, "skip"} - {"title", "can_be_tuned"}:
    setattr(Tuned, _name, property(attrgetter(f"method.{_name}")))
