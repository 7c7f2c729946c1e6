"""Numerics on plain arrays: no recordings, ensembles or models here."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
