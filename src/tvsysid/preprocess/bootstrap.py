"""Draw ensembles with replacement."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.signals import Ensemble


def bootstrap(
    ensemble: Ensemble, count: int, seed: int, size: int | None = None
) -> Iterator[Ensemble]:
    """Ensembles of realizations drawn with replacement, each made when it is asked for.

    Parameters
    ----------
    count, seed
        How many ensembles to draw. The same seed gives the same draws; a higher count only adds
        draws.
    size
        Realizations in each; by default as many as there are.

    References
    ----------
    van de Ruit et al. 2021, section 4.1.4: 100 draws of 75 or 150 realizations.
    """
    weights = bootstrap_weights(len(ensemble), len(ensemble) if size is None else size, count, seed)
    every = np.arange(len(ensemble))
    return (ensemble.select(np.repeat(every, times)) for times in weights)


def bootstrap_weights(realizations: int, size: int, count: int, seed: int) -> NDArray[np.int64]:
    """How often each realization is drawn: a bootstrap as weights on realizations.

    Whole numbers that sum to ``size`` in each row, shape (count, realizations).

    Parameters
    ----------
    realizations, size, count
        How many there are, how many are drawn each time, with replacement, and the number of draws.
    seed
        The same one gives the same draws; a higher count only adds draws.
    """
    random = _checked(realizations, size, count, seed)
    drawn = random.integers(0, realizations, (count, size))
    return _counted(drawn, realizations)


def block_weights(realizations: int, size: int, count: int, seed: int) -> NDArray[np.int64]:
    """How often each realization is drawn if a draw is one block of realizations that follow each other.

    For methods that need a record in one piece. A block begins anywhere; after the last realization
    comes the first, so that each is drawn as often as any other (circular blocks, Politis & Romano
    1992).

    Parameters as of :func:`bootstrap_weights`; ``size`` is the length of a block, at most as
    many as there are. Returns 0 or 1, ``size`` ones in each row, shape (count, realizations).
    """
    random = _checked(realizations, size, count, seed)
    if size > realizations:
        raise InputError(
            f"bootstrap: a block of {size} realizations cannot be drawn from {realizations}; give "
            "a shorter one"
        )
    firsts = random.integers(0, realizations, (count, 1))
    return _counted((firsts + np.arange(size)) % realizations, realizations)


def _checked(realizations: int, size: int, count: int, seed: int) -> np.random.Generator:
    for name, number in (("realizations", realizations), ("size", size), ("count", count)):
        if not isinstance(number, (int, np.integer)) or isinstance(number, bool) or number < 1:
            raise InputError(
                f"bootstrap: {name} must be a whole number of one or more, got {number!r}"
            )
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"bootstrap: seed must be a whole number of zero or more, got {seed!r}"
        ) from error


def _counted(drawn: NDArray[np.int64], realizations: int) -> NDArray[np.int64]:
    """How often each realization is in each row of indices, shape (row, realization)."""
    count = len(drawn)
    apart = (
        drawn + np.arange(count)[:, None] * realizations
    )  # so that rows are counted by themselves
    return np.bincount(apart.ravel(), minlength=count * realizations).reshape(count, realizations)
