"""Why settings were chosen: a criterion, and its value for all that were tried.

And methods that choose their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.estimates import frozen
from tvsysid.methods.base import Choice, Method
from tvsysid.models import Model
from tvsysid.numerics.bases import Basis, CubicBSplines, FourierSeries, HaarWavelets, evaluate
from tvsysid.showing import Shown, summary_html
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import pandas as pd


# Bases of which a tuned one is the best.
BASES: tuple[Basis, ...] = (
    *(CubicBSplines(functions) for functions in (4, 6, 8, 10, 12, 16, 20, 28, 40)),
    *(CubicBSplines(functions, periodic=True) for functions in (6, 8, 10, 12, 16, 20, 28, 40)),
    *(FourierSeries(harmonics) for harmonics in (0, 1, 2, 3, 4, 6, 8, 12, 16)),
    *(HaarWavelets(functions) for functions in (2, 4, 8, 16, 32)),
)
MOST = 500  # coefficients of the largest model that is tried
CLEARLY = (
    3.0  # log evidence by which a basis must be better than the one given to be chosen: 20 to 1
)


@attrs.frozen(eq=False)
class Evidence(Shown):
    """What speaks for settings that were chosen from data.

    The ``criterion``, in a ``unit``, of which ``"higher"`` or ``"lower"`` values are better; the
    settings ``tried`` by name, the first being those that the method had before, and which were
    ``chosen``; the ``values`` of the criterion, and the ``standard_errors`` of their differences
    from the first, NaN where it has none. To be drawn against an ``axis`` at ``positions`` in
    ``lines``: trials of one name make one line. All of shape (trial,). Which of the settings
    chosen lie at the edge of what was tried, so that others beyond may be better, is said by the
    ``edges``, in words.
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
    edges: tuple[str, ...] = ()

    def __attrs_post_init__(self) -> None:
        for name in ("values", "standard_errors", "positions"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

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
        tried = "; ".join(("", f"{len(self.values)} tried", *self.edges))
        if self.chosen == 0:
            return (
                f"{_told(self.settings)} as given: nothing else has a clearly better "
                f"{self.criterion}{tried}"
            )
        return (
            f"{_told(self.settings)} instead of {_told(self.tried[0])}: {self.criterion} better "
            f"by {self.gain:.3g} "
            f"{self.unit}{tried}"
        )

    def __repr__(self) -> str:
        return f"Evidence({self})"

    def _repr_html_(self) -> str:
        table = self.to_pandas()
        return summary_html(
            "Evidence", str(self), list(map(str, table.columns)), table.itertuples(index=False)
        )

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


def _told(settings: Mapping[str, object]) -> str:
    return ", ".join(f"{name}={_short(value)}" for name, value in settings.items())


def _short(value: object) -> str:
    """Numbers with four digits."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"({', '.join(map(_short, value))})" if isinstance(value, tuple) else repr(value)


def edge_of(name: str, value: float, tried: Iterable[float]) -> tuple[str, ...]:
    """In words, that a value is the smallest or the largest of several that were tried.

    Nothing if it is neither.
    """
    several = set(tried) | {value}
    ends = {min(several): "smallest", max(several): "largest"}
    if len(several) == 1 or value not in ends:
        return ()
    return (f"{name}={_short(value)} is the {ends[value]} that was tried",)


def evidence_of_bases(
    given: Basis,
    prior: str,
    samples: int,
    log_evidence: Callable[[Basis], float],
    per_function: int,
) -> Evidence:
    """Log evidence of bases, less the number of precisions that were fitted to the data.

    The ``"ard"`` prior fits a precision for each coefficient, of which there are so many
    ``per_function`` of a basis, ``"ridge"`` one for all; ``"none"`` has no evidence. Noise that
    is not white makes samples worth less than as many independent ones, which ``log_evidence``
    knows.
    """
    if prior == "none":
        raise InputError(
            "BasisIRF: least squares has no evidence to choose a basis by; set prior to 'ard' or "
            "'ridge'"
        )
    counts = {basis: evaluate(basis, samples).shape[1] for basis in BASES}
    tried = [
        given,
        *(basis for basis in BASES if basis != given and per_function * counts[basis] <= MOST),
    ]
    positions = [evaluate(basis, samples).shape[1] for basis in tried]
    # Each precision that was fitted raises the evidence, even of a function that is not there.
    fitted = [per_function * functions if prior == "ard" else 1 for functions in positions]
    values = np.array([log_evidence(basis) for basis in tried]) - fitted
    best = int(np.argmax(values))
    chosen = best if values[best] > values[0] + CLEARLY else 0
    lines = tuple(_kind(basis) for basis in tried)
    # One function is a constant: no basis has less.
    most, alike = (
        positions[chosen],
        [many for many, kind in zip(positions, lines, strict=True) if kind == lines[chosen]],
    )
    return Evidence(
        criterion="log evidence less precisions fitted",
        unit="nat",
        better="higher",
        tried=tuple({"basis": basis} for basis in tried),
        values=values,
        standard_errors=np.full(len(values), np.nan),
        chosen=chosen,
        axis="functions",
        positions=np.array(positions, dtype=np.float64),
        lines=lines,
        edges=edge_of("functions", most, alike) if chosen and most == max(alike) else (),
    )


def _kind(basis: Basis) -> str:
    """Name of a basis, without the number of its functions."""
    name = getattr(type(basis), "__name__", "basis")
    return f"periodic {name}" if isinstance(basis, CubicBSplines) and basis.periodic else name


@attrs.frozen
class Tuned(Method):
    """Method that chooses its settings anew from each ensemble; ``kbr:tuned=true`` as text.

    The model's ``method`` tells the settings that were chosen.

    Parameters
    ----------
    method
        Method with the settings to begin with.
    seed
        Random seed of :meth:`tvsysid.methods.Method.tuned`.

    Examples
    --------
    >>> from tvsysid.methods import ShortDataSegments
    >>> Tuned(ShortDataSegments()).title
    'Short data segments, tuned'
    """

    method: Method
    seed: int = 0

    @property
    def title(self) -> str:  # type: ignore[override]
        """Title of the method."""
        return f"{self.method.title}, tuned"

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return why the method cannot identify the ensemble."""
        return self.method.skip(ensemble)

    def tuned(self, ensemble: Ensemble, seed: int | None = None) -> Choice[Any]:
        """Choose the settings."""
        return self.method.tuned(ensemble, self.seed if seed is None else seed)

    def fit(self, ensemble: Ensemble) -> Model:
        """Choose the settings, and identify by them."""
        model: Model = self.tuned(ensemble).method.identify(ensemble)
        return model

    def identify(self, ensemble: Ensemble) -> Model:
        """Choose the settings, and identify by them; warnings are those of the method."""
        return self.fit(ensemble)

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Identify a part of the realizations as the method does."""
        return self.method.refit(ensemble, model)


# What holds with any settings is that of the method.
for _name in (
    *("key", "assumptions", "differs", "cites", "inputs", "quantities", "sometimes"),
    *("scheduled_quantities", "pathway_names", "contiguous", "time_invariant"),
    *("uses_recorded_angle", "perturbation", "system"),
):
    setattr(Tuned, _name, property(attrgetter(f"method.{_name}")))
