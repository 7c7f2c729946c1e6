"""Evidence for settings that are chosen from data, and methods that choose their own."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Mapping
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import attrs
import numpy as np

from tvsysid.arrays import read_only
from tvsysid.errors import InputError
from tvsysid.methods.base import Choice, Method
from tvsysid.models import Model
from tvsysid.numerics.bases import Basis, CubicBSplines, FourierSeries, HaarWavelets, evaluate
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


# Bases that are tried.
BASES: tuple[Basis, ...] = (
    *(CubicBSplines(functions) for functions in (4, 6, 8, 10, 12, 16, 20, 28, 40)),
    *(CubicBSplines(functions, periodic=True) for functions in (6, 8, 10, 12, 16, 20, 28, 40)),
    *(FourierSeries(harmonics) for harmonics in (0, 1, 2, 3, 4, 6, 8, 12, 16)),
    *(HaarWavelets(functions) for functions in (2, 4, 8, 16, 32)),
)
MAX_COEFFICIENTS = 500
MIN_GAIN_NAT = 3.0  # log evidence by which another basis must be better: 20 to 1


@attrs.frozen(eq=False, repr=False)
class Evidence:
    """Settings that were tried on data, and how good each is.

    Parameters
    ----------
    criterion, unit, better
        What measures how good settings are, and whether ``"higher"`` or ``"lower"`` is better.
    tried
        Settings by name; the first are those that the method had before.
    values
        Criterion of each of them.
    chosen
        Position of the settings that were chosen.
    axis, positions, lines
        How a figure shows them: axis, position on it, and name of the line.
    edges
        Sentences about settings chosen at the edge of what was tried; others beyond may be better.
    """

    criterion: str
    unit: str
    better: Literal["higher", "lower"]
    tried: tuple[Mapping[str, Any], ...]
    values: Array = attrs.field(converter=read_only)
    chosen: int
    axis: str
    positions: Array = attrs.field(converter=read_only)
    lines: tuple[str, ...]
    edges: tuple[str, ...] = ()

    @property
    def settings(self) -> Mapping[str, Any]:
        """Return the settings that were chosen, by name."""
        return self.tried[self.chosen]

    @property
    def gain(self) -> float:
        """Return the gain over the first settings in the criterion; positive is better."""
        difference = float(self.values[self.chosen] - self.values[0])
        return difference if self.better == "higher" else 0.0 - difference

    def __str__(self) -> str:
        settings = _as_text(self.settings)
        result = f"{settings} as given: nothing else has a clearly better {self.criterion}"
        if self.chosen != 0:
            result = (
                f"{settings} instead of {_as_text(self.tried[0])}: {self.criterion} better by "
                f"{self.gain:.3g} {self.unit}"
            )
        return "; ".join((result, f"{len(self.values)} tried", *self.edges))

    def plot(self, title: str = "") -> Figure:
        """Draw the criterion against the settings."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above

        return plot(self, title)

    def __repr__(self) -> str:
        return f"Evidence({self})"

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(str(self))}</p>{self.to_pandas().to_html(index=False)}"

    def to_pandas(self) -> pd.DataFrame:
        """Return a table: a row for each of the settings that were tried."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(
            {
                "settings": list(map(_as_text, self.tried)),
                "criterion": self.criterion,
                "value": self.values,
                "unit": self.unit,
                "chosen": np.arange(len(self.values)) == self.chosen,
            }
        )


def _as_text(settings: Mapping[str, object]) -> str:
    return ", ".join(f"{name}={_rounded(value)}" for name, value in settings.items())


def _rounded(value: object) -> str:
    """Return a value as text, numbers with four digits."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"({', '.join(map(_rounded, value))})" if isinstance(value, tuple) else repr(value)


def edge_of(name: str, value: float, tried: Iterable[float]) -> tuple[str, ...]:
    """Return a sentence if a value is the smallest or largest of several that were tried."""
    several = {*tried, value}
    ends = {min(several): "smallest", max(several): "largest"}
    if len(several) == 1 or value not in ends:
        return ()
    return (f"{name}={_rounded(value)} is the {ends[value]} that was tried",)


def evidence_of_bases(
    given: Basis,
    prior: str,
    samples: int,
    log_evidence: Callable[[Basis], float],
    per_function: int,
) -> Evidence:
    """Compare bases by their log evidence, less the number of precisions that were fitted.

    Parameters
    ----------
    given
        Basis that the method has.
    prior
        ``"ard"`` fits a precision for each coefficient, ``"ridge"`` one for all. ``"none"`` has no
        evidence.
    samples
        Samples of a realization.
    log_evidence
        Function that returns the log evidence of a basis.
    per_function
        Coefficients of each function of a basis.
    """
    if prior == "none":
        raise InputError(
            "BasisIRF: least squares has no evidence to choose a basis by; set prior to 'ard' or "
            "'ridge'"
        )
    counts = {basis: evaluate(basis, samples).shape[1] for basis in (given, *BASES)}
    tried = [
        basis
        for basis, count in counts.items()
        if basis == given or per_function * count <= MAX_COEFFICIENTS
    ]
    functions, lines = np.array([counts[basis] for basis in tried]), tuple(map(_kind, tried))
    # Each precision that was fitted raises the evidence, even of a function that is not there.
    fitted = per_function * functions if prior == "ard" else 1
    values = np.array([log_evidence(basis) for basis in tried]) - fitted
    best = int(np.argmax(values))
    chosen = best if values[best] > values[0] + MIN_GAIN_NAT else 0
    alike = functions[[line == lines[chosen] for line in lines]].tolist()
    # One function is a constant: no basis has fewer.
    is_largest = chosen and functions[chosen] == max(alike)
    return Evidence(
        criterion="log evidence less precisions fitted",
        unit="nat",
        better="higher",
        tried=tuple({"basis": basis} for basis in tried),
        values=values,
        chosen=chosen,
        axis="functions",
        positions=functions,
        lines=lines,
        edges=edge_of("functions", max(alike), alike) if is_largest else (),
    )


def _kind(basis: Basis) -> str:
    """Return the name of a basis, without the number of its functions."""
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
        """Return the title of the method."""
        return f"{self.method.title}, tuned"

    def tuned(self, ensemble: Ensemble, seed: int | None = None) -> Choice[Any]:
        """Choose the settings."""
        return self.method.tuned(ensemble, self.seed if seed is None else seed)

    def fit(self, ensemble: Ensemble) -> Model:
        """Choose the settings, and identify by them; warnings are those of the method."""
        model: Model = self.tuned(ensemble).method.identify(ensemble)
        return model

    identify = fit


# What holds with any settings is that of the method.
for _name in {*Method.__annotations__, "skip", "refit"} - {"title", "can_be_tuned"}:
    setattr(Tuned, _name, property(attrgetter(f"method.{_name}")))
