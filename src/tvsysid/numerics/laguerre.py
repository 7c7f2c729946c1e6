"""Orthonormal filters that decay, of which responses are sums."""

from __future__ import annotations

import math

import numpy as np
import scipy

from tvsysid.numerics import Array


def laguerre_filters(count: int, lags: int, time_constant: float) -> Array:
    r"""Impulse responses (filter, lag) of Laguerre filters from lag 0 on.

    They decay over a time constant in samples.

    .. math:: L_i(z) = \frac{\sqrt{1 - a^2}}{1 - a z^{-1}}
              \left(\frac{z^{-1} - a}{1 - a z^{-1}}\right)^i, \qquad
              a = e^{-1/\tau}

    Examples
    --------
    >>> filters = laguerre_filters(3, 200, 5.0)
    >>> np.abs(filters @ filters.T - np.eye(3)).max() < 1e-9
    np.True_
    """
    pole = math.exp(-1 / time_constant)
    impulse = np.zeros(lags)
    impulse[0] = math.sqrt(1 - pole**2)
    filters = [scipy.signal.lfilter([1.0], [1.0, -pole], impulse)]
    while len(filters) < count:
        filters.append(scipy.signal.lfilter([-pole, 1.0], [1.0, -pole], filters[-1]))
    return np.stack(filters)
