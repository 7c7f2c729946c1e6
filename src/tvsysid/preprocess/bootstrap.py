"""Draw realizations with replacement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.validators import at_least


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
