"""A first-order lag of a band-limited signal."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy

from tvsysid.numerics import Array
from tvsysid.numerics.differentiation import BAND, HALF_WIDTH


@lru_cache(maxsize=64)
def lag_weights(lag: float) -> tuple[Array, float]:
    r"""Return weights c (lags from -n to n) and pole q of a filter with a first-order lag.

    The filter lags as :math:`1 / (1 + a s)` does, with a in samples.

    .. math:: v(i) = q\, v(i - 1) + \sum_{j=-n}^{n} c_j u(i - j), \qquad q = e^{-1/a}

    The pole is exact. The weights minimise the relative error of the frequency response up to
    0.8 of the Nyquist frequency, as those of
    :func:`tvsysid.numerics.differentiation.derivative_weights`; at 0 Hz it has none. To hold the
    input over each sample, or to join samples by straight lines, is exact for a signal of that
    kind, not for a band-limited one: at a fifth of the sampling rate the second weakens it by 13
    %, where this filter errs by 0.004 %.
    """
    pole = math.exp(-1 / lag)
    size = 32 * HALF_WIDTH
    omega = (np.arange(1, size) - 0.5) / size * BAND * np.pi
    wanted = (1 - pole * np.exp(-1j * omega)) / (1 + 1j * omega * lag)
    lags = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
    others = lags[lags != 0]
    # The weights sum to one minus the pole, so that what stands still stays as it is.
    system = (np.exp(-1j * np.outer(omega, others)) - 1) / wanted[:, None]
    target = 1 - (1 - pole) / wanted
    found = np.linalg.lstsq(
        np.concatenate([system.real, system.imag]),
        np.concatenate([target.real, target.imag]),
        rcond=None,
    )[0]
    weights = np.insert(found, HALF_WIDTH, 1 - pole - found.sum())
    weights.flags.writeable = False
    return weights, pole


def low_pass(u: Array, lag: float, sampling_rate: float) -> Array:
    r"""Signal (time,) behind a first-order lag of a seconds: :math:`v + a \dot v = u`.

    For a = 0 as it is.

    Before its first sample the signal is continued as point-symmetric, over the width of the
    filter's weights, and before that as constant, where v has come to rest; after its last sample
    likewise. The error that this makes fades as :math:`e^{-t/a}` from the first sample on. It is
    zero beyond the weights' half width from the last sample.
    """
    if lag == 0:
        return u
    weights, pole = lag_weights(lag * sampling_rate)
    driven = np.convolve(
        np.pad(u, 2 * HALF_WIDTH, "reflect", reflect_type="odd"), weights, mode="valid"
    )
    at_rest = driven[0] / (1 - pole)
    return np.asarray(
        scipy.signal.lfilter([1.0], [1.0, -pole], driven, zi=[pole * at_rest])[0][
            HALF_WIDTH:-HALF_WIDTH
        ]
    )
