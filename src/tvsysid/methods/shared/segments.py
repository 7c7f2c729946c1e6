r"""Second-order fits to short segments about each time, from moments of the signals.

With :math:`u^{(m)}` the angle's derivatives, taken before the window, segments obey

.. math:: S_{y u^{(m)}}(f) = k S_{u u^{(m)}}(f) + b S_{\dot u u^{(m)}}(f)
          + I S_{\ddot u u^{(m)}}(f), \qquad m = 0, 1, 2

at every frequency, without leakage. Least squares sum over frequency. By Parseval's theorem, this
is a sum over samples with the squared window as weights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.methods.shared.residuals import Colour, colour_lags, independent_realizations
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.second_order import derivative_filters, second_order_fit
from tvsysid.signals import Array, Ensemble


def segment_signals(ensemble: Ensemble, within: slice) -> tuple[Array, slice]:
    """Return angle, velocity, acceleration and torque, and the samples at which they are known.

    The samples ``within`` count the context. The signals (4, realization, sample) are 0 where the
    derivatives lack samples.
    """
    begin, end = within.start, within.stop
    first, last = max(HALF_WIDTH, begin), min(ensemble.angle.shape[1] - HALF_WIDTH, end)
    known = slice(first - begin, last - begin)
    signals = np.zeros((4, len(ensemble), end - begin))
    angle = ensemble.angle[:, first - HALF_WIDTH : last + HALF_WIDTH]
    signals[:3, :, known] = differentiate(angle, ensemble.sampling_rate)
    signals[3, :, known] = ensemble.torque[:, first:last]
    return signals, known


class InstrumentalFit(NamedTuple):
    """Impedance (time, 3) of segments, its ``variances`` and the instrument's ``strength``.

    ``strength`` has shape (time,).
    """

    impedance: Array
    variances: Array
    strength: Array


def instrumental_fit(
    ensemble: Ensemble, moved: Ensemble, power: Array, within: slice
) -> InstrumentalFit:
    r"""Fit the impedance of segments by instruments z, from the angle of the ensemble ``moved``.

    .. math:: A_r = \sum_i w_i z_r(i)\, x_r(i)^T, \quad c_r = \sum_i w_i z_r(i)\, y_r(i), \quad
              \hat\theta = \left(\sum_r A_r\right)^{-1} \sum_r c_r, \quad
              V = A^{-1} \sum_r s_r s_r^T A^{-T} \frac{R}{R - 3}, \quad s_r = c_r - A_r \hat\theta

    The realizations are the independent samples, so that the noise may have any colour and
    strength. ``power`` (sample,) is the squared window w.
    """
    (z, _), (x, _) = (segment_signals(each, within) for each in (moved, ensemble))
    weights = np.broadcast_to(power[::-1], (z.shape[2] - len(power) + 1, len(power)))
    products = convolve_lags((z[:3, None] * x).reshape(-1, z.shape[2]), weights)
    products = products.reshape(3, 4, len(ensemble), -1).transpose(2, 3, 0, 1)
    sums = products.sum(axis=0)
    impedance, inverse = second_order_fit(sums[..., :3], sums[..., 3])
    scores = products[..., 3] - np.einsum("rtij,tj->rti", products[..., :3], impedance)
    effects = np.einsum("tij,rtj->rti", inverse, scores)
    independent = independent_realizations(ensemble)
    share = len(ensemble) / (independent - 3) if independent > 3 else np.nan
    own = np.einsum("ti,rtij,tj->rt", inverse[:, 0], products[..., :3], inverse[:, :, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        strength = own.sum(axis=0) ** 2 / np.sum(own**2, axis=0)
    return InstrumentalFit(impedance, share * np.sum(effects**2, axis=0), strength)


class SegmentFit(NamedTuple):
    """Least-squares fit to segments.

    ``impedance`` has shape (time, 3), ``inverse`` (time, 3, 3) is that of the regressors' moments.
    ``moments`` (sample, 4, 4) of angle, velocity, acceleration and torque are sums over
    realizations, of which ``realizations`` are independent. They are 0 but at the ``known``
    samples. ``power`` (sample,) is the squared window.
    """

    impedance: Array
    inverse: Array
    moments: Array
    known: slice
    power: Array
    realizations: int

    @classmethod
    def of(cls, ensemble: Ensemble, power: Array, within: slice) -> SegmentFit:
        """Fit segments within samples that count the context."""
        signals, known = segment_signals(ensemble, within)
        by_sample = signals.transpose(2, 0, 1)
        moments = by_sample @ by_sample.transpose(0, 2, 1)
        sums = window_sums(moments, power)
        impedance, inverse = second_order_fit(sums[:, :3, :3], sums[:, :3, 3])
        realizations = independent_realizations(ensemble)
        return cls(impedance, inverse, moments, known, power, realizations)

    def variances(self, colour: Colour) -> Array:
        """Return the variances (time, 3) of stiffness, viscosity and inertia."""
        sums, fourth = (window_sums(self.moments, self.power**n) for n in (1, 2))
        fourth, inverse = fourth[:, :3, :3], self.inverse
        known = np.zeros(len(self.moments))
        known[self.known] = self.realizations
        freedom = sliding_window_view(known, len(self.power)) @ self.power
        freedom -= np.einsum("tmk,tkm->t", inverse, fourth)
        fitted = np.einsum("tm,tm->t", self.impedance, sums[:, :3, 3])
        left = np.maximum(sums[:, 3, 3] - fitted, 0.0)
        noise = np.where(freedom > 0, left / np.where(freedom > 0, freedom, 1.0), np.nan)
        white = noise[:, None] * np.diagonal(inverse @ fourth @ inverse, axis1=1, axis2=2)
        overlap = _overlap(self.power, len(colour.covariance))
        _, factors = colour.noise_and_factors(overlap / overlap[0])
        return np.asarray(factors * white)

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the variances."""
        return float(self.realizations * self.power.sum() ** 2 / np.sum(self.power**2) - 3)


def window_sums(moments: Array, weights: Array) -> Array:
    """Return weighted sums (time, 4, 4) of moments (sample, 4, 4) over each segment."""
    return np.asarray(sliding_window_view(moments, len(weights), axis=0) @ weights)


def _overlap(power: Array, lags: int) -> Array:
    """Return the sum over a segment of the products of lagged weights, shape (lag,)."""
    products = np.correlate(np.pad(power, (0, lags)), power)
    return np.asarray(products[:lags])


def segment_colour(ensemble: Ensemble, power: Array, left: Array, products: Array) -> Colour:
    """Return the colour of what a second-order fit of segments leaves (realization, time).

    The fit explains a share of the noise's autocovariance: it has three regressors, and segments
    are weighted by ``power``. ``products`` are the :func:`colour_products` of the angle.
    """
    lags = colour_lags(ensemble) + 1
    own = np.pad(power[len(power) // 2 :], (0, lags))[:lags]
    total = float(power.sum())
    taken = 3 / len(ensemble) * (2 * own / total - _overlap(power, lags) / total**2)
    filters = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
    return Colour.of(ensemble, left, taken, filters, products)
