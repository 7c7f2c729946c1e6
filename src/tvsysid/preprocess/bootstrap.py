"""Draw ensembles with replacement."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.signals import Ensemble
from tvsysid.validators import at_least


def bootstrap(
    ensemble: Ensemble, count: int, seed: int, size: int | None = None
) -> Iterator[Ensemble]:
    """Draw ensembles of realizations with replacement, one at a time.

    Parameters
    ----------
    count, seed
        Number of ensembles, and random seed. A higher count with the same seed only adds draws.
    size
        Number of realizations in each; by default as many as there are.

    References
    ----------
    van de Ruit et al. 2021, section 4.1.4: 100 draws of 75 or 150 realizations.
    """
    weights = bootstrap_weights(len(ensemble), len(ensemble) if size is None else size, count, seed)
    return (ensemble.select(np.repeat(np.arange(len(ensemble)), times)) for times in weights)


def bootstrap_weights(
    realizations: int, size: int, count: int, seed: int, contiguous: bool = False
) -> NDArray[np.int64]:
    """Return how often each realization is in each draw with replacement.

    Parameters
    ----------
    realizations, size, count
        Number of realizations, number drawn each time, and number of draws.
    seed
        Random seed. A higher count with the same seed only adds draws.
    contiguous
        Draw one block of successive realizations each time, for methods that need a record in one
        piece. A block begins anywhere. The first realization follows the last, so that all are
        drawn equally often (circular blocks, Politis & Romano 1992).

    Returns
    -------
    Whole numbers that sum to ``size`` in each row, shape (count, realizations).
    """
    at_least(0).check("bootstrap", "seed", seed)
    if contiguous and size > realizations:
        raise InputError(
            f"bootstrap: a block of {size} realizations cannot be drawn from {realizations}; give "
            "a shorter one"
        )
    random = np.random.default_rng(seed)
    drawn = random.integers(0, realizations, (count, 1 if contiguous else size))
    if contiguous:
        drawn = (drawn + np.arange(size)) % realizations
    return np.stack([np.bincount(row, minlength=realizations) for row in drawn])
