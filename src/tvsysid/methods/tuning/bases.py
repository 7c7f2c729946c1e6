"""Which basis describes a change in time best, judged by the evidence of its coefficients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.numerics.bases import Basis, CubicBSplines, FourierSeries, HaarWavelets, evaluate

BASES: tuple[Basis, ...] = (
    *(CubicBSplines(functions) for functions in (4, 6, 8, 10, 12, 16, 20, 28, 40)),
    *(CubicBSplines(functions, periodic=True) for functions in (6, 8, 10, 12, 16, 20, 28, 40)),
    *(FourierSeries(harmonics) for harmonics in (0, 1, 2, 3, 4, 6, 8, 12, 16)),
    *(HaarWavelets(functions) for functions in (2, 4, 8, 16, 32)),
)
"""Bases of which a tuned one is the best."""
MOST = 500
"""Coefficients of the largest model that is tried."""
CLEARLY = 3.0
"""Log evidence by which a basis must be better than the one given to be chosen: 20 to 1."""


def evidence_of_bases(
    given: Basis, prior: str, samples: int, log_evidence: Callable[[Basis], float], per_function: int
) -> Evidence:
    """Log evidence of bases, less the number of precisions that were fitted to the data.

    Parameters
    ----------
    given
        Basis that the method has.
    prior
        ``"ard"`` fits a precision for each coefficient, ``"ridge"`` one for all, ``"none"`` has no evidence.
    samples
        Of a realization.
    log_evidence
        Of a basis; noise that is not white makes samples worth less than as many independent ones.
    per_function
        Coefficients of each function of a basis.
    """
    if prior == "none":
        raise InputError("BasisIRF: least squares has no evidence to choose a basis by; set prior to 'ard' or 'ridge'")
    counts = {basis: evaluate(basis, samples).shape[1] for basis in BASES}
    tried = [given, *(basis for basis in BASES if basis != given and per_function * counts[basis] <= MOST)]
    positions = [evaluate(basis, samples).shape[1] for basis in tried]
    # Each precision that was fitted raises the evidence, even of a function that is not there.
    fitted = [per_function * functions if prior == "ard" else 1 for functions in positions]
    values = np.array([log_evidence(basis) for basis in tried]) - fitted
    best = int(np.argmax(values))
    return Evidence(
        criterion="log evidence less precisions fitted",
        unit="nat",
        better="higher",
        tried=tuple({"basis": basis} for basis in tried),
        values=values,
        standard_errors=np.full(len(values), np.nan),
        chosen=best if values[best] > values[0] + CLEARLY else 0,
        axis="functions",
        positions=np.array(positions, dtype=np.float64),
        lines=tuple(_kind(basis) for basis in tried),
    )


def _kind(basis: Basis) -> str:
    """Name of a basis, without the number of its functions."""
    name = getattr(type(basis), "__name__", "basis")
    return f"periodic {name}" if isinstance(basis, CubicBSplines) and basis.periodic else name
