"""Kernel-based regression (KBR)."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Literal

import attrs
import numpy as np

from tvsysid.methods import base, responses, shared
from tvsysid.methods.kbr import search
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel, clocks_of
from tvsysid.methods.kbr.record import moments_of, runs_of, whitened
from tvsysid.methods.tuning import Evidence
from tvsysid.models import IMPEDANCE, Diagnostics, StandardError
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_filters
from tvsysid.numerics.gaussian import (
    SMALLEST_RESIDUAL,
    FittedWeights,
    Moments,
    Posterior,
    by_instruments,
    solve,
)
from tvsysid.numerics.instrument import MIN_PREDICTED
from tvsysid.numerics.noise import power_in_band
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import Validator, is_number, one_of, optional, positive

Weights = Literal["white", "residual"]

NM_PER_DEG = math.degrees(1.0)  # 1 N·m/deg in N·m/rad
# Modulus of the paper's joint at 1 Hz in N·m/rad, for which ``scale`` is 1 N·m/deg by convention.
PAPER_MODULUS = 100.0
# iterations of the residual weights; one more changes stiffness by 1 % of its standard error
REWEIGHTED = 2
CONVERGED = 1e-5  # relative change of the noise variance at which iterations stop
ITERATIONS = 50  # maximum number of noise variances tried
INITIAL_NOISE = 1e-2  # initial noise variance, as a share of the torque's power


def _numbers(value: Any, count: int) -> bool:
    """Return whether a value is a tuple of this count of numbers."""
    return isinstance(value, tuple) and len(value) == count and all(map(is_number, value))


GAMMA = Validator(
    "a positive number, or three: of stiffness, viscosity and inertia",
    lambda gamma: positive.is_valid(gamma) or (_numbers(gamma, 3) and min(gamma) > 0),
)
BAND = Validator(
    "two increasing frequencies in Hz, none below 0",
    lambda band: _numbers(band, 2) and 0 <= band[0] < band[1],
)


@attrs.frozen
class KernelRegression(shared.ReferenceMethod):
    r"""Impedance that changes smoothly and almost periodically, fitted in the frequency domain.

    .. math:: y(t) = \sum_{m=0}^{2} b_m(t)\,\theta^{(m)} - f_{ext}(t), \qquad
              b_m = \bar b_m + \tilde b_m, \quad \tilde b_m \sim GP(0, K / 2)

    .. math:: \min_{b} \sum_{k} \frac{|E(k)|^2}{\hat\sigma_E^2}
              + \sum_m \tilde b_m^T K^{-1} \tilde b_m, \qquad
              K(t, t') = \gamma\, e^{-\sin^2(\pi (t - t') / p) / l_1}\, e^{-(t - t')^2 / l_2^2}

    (equations 13 to 17 of van de Ruit et al. 2021; Cavallo et al. 2020, Lataire et al. 2017). The b
    are stiffness, viscosity and inertia: the paper's Na = 0 and Nb = 2. E is the spectrum of the
    equation error over each unbroken run of realizations. Its variance is that of a complex number,
    so the first term of the cost is minus a log density. The second is twice a minus log density,
    so the paper's prior covariance is K / 2. The kernel K says how fast the b may change.
    Its period p is the duration of a realization. ``tuned`` chooses gamma, l1 and l2 by maximum
    evidence, with white weights even if the ``weighting`` is ``"residual"``.

    Parameters
    ----------
    length_periodic
        l1: smoothness within a period; larger is smoother. It has no unit, although the paper
        prints seconds.
    length_decay
        l2 in s: time over which the periods become different. From 20 record lengths on, the kernel
        is strictly periodic.
    gamma
        Of stiffness, viscosity and inertia, or one number for all three, in units of the ``scale``
        squared: twice the prior variance about the mean. The paper gives one, without a unit.
    band
        Lowest and highest frequency in Hz of the equation error that is fitted.
    scale
        Unit of the root of gamma in N·m/rad (of viscosity in N·m·s/rad, of inertia in kg·m²). If
        None, it is 0.573 times the modulus at 1 Hz of the constant impedance that fits the data
        best, so that gamma has no unit. For the paper's joint, with a mean of 100 N·m/rad, this is
        57.3 N·m/rad, or 1 N·m/deg. ``scale=57.29578`` fixes that value.
    reference
        Channel with the disturbance that was applied, for a joint in closed loop, where torque
        noise also moves the angle. The angle that the reference predicts
        (:mod:`tvsysid.methods.shared.instrument`) then replaces the angle in the left factor of the
        normal equations.
    weighting
        ``"white"``: all frequencies have the same weight, as in the paper. ``"residual"``: the
        weight is the inverse of the residual's power (a smooth spectrum, in two iterations).
        This is best where the noise is not white in the band. With slow noise it reduces the random
        error by a third to three quarters, in open and in closed loop.

    Notes
    -----
    The unit of gamma is a convention, not a reconstruction. With 1 N·m/rad, the paper's 4.5 is a
    prior standard deviation of stiffness of 1.5 N·m/rad, which keeps it almost constant. With
    1 N·m/deg it is 86 N·m/rad, which gives figures like the paper's.

    The kernel is used in a low-rank form: Fourier series with known variances times eigenfunctions
    of the decay (:mod:`tvsysid.methods.kbr.kernel`), which makes the problem a ridge regression
    with some 110 unknowns. If the decay is much shorter than the record, the cost grows with the
    cube of the record's length: 600 s with a decay of 30 s take 3800 unknowns and some 10 s.
    The paper's decay of 120 000 s means no decay.

    The external term is a sum of five half-cosines over a run, without a prior.

    The noise variance is estimated from the residual, with the effective number of parameters
    subtracted from the degrees of freedom. The diagnostics' ``second_order_agreement`` is the share
    of the angle-dependent torque that order 2 explains.

    The bands are those of the posterior, which assumes white noise within the band, times a factor
    for the noise's colour if the weighting is ``"white"``
    (:func:`tvsysid.numerics.noise.colour_factors`). They cover smoothing bias only if stiffness is
    as smooth as the kernel says: near a switch, the truth lies outside the bands.
    """

    # The paper's settings for its simulated study (section 3.2.5).
    length_periodic: float = attrs.field(default=math.exp(-2), validator=positive)
    length_decay: float = attrs.field(default=ENDLESS, validator=positive)
    gamma: float | tuple[float, float, float] = attrs.field(default=4.5, validator=GAMMA)
    band: tuple[float, float] = attrs.field(default=(0.0, 20.0), validator=BAND)
    scale: float | None = attrs.field(default=None, validator=optional(positive))
    reference: str | None = None
    weighting: Weights = attrs.field(default="white", validator=one_of(Weights))

    key = "kbr"
    contiguous = True
    title = "Kernel-based regression"
    can_be_tuned = True
    assumptions = (
        "Stiffness, viscosity and inertia change smoothly and nearly periodically, as the kernel "
        "says.",
        "The joint is of second order.",
        "The record is continuous; one realization is enough, more are better.",
    )
    differs = (
        "Its kernel says beforehand how smooth and how periodic stiffness is: a switch comes out "
        "smooth, with ripples beside it."
    )
    cites = ("lataire2017", "cavallo2020", "vanderuit2021")

    @property
    def least_share(self) -> float:
        """Return the smallest share of the angle that the reference must predict.

        With residual weights, less is enough.
        """
        return MIN_PREDICTED if self.weighting == "white" else shared.MIN_SHARE

    def _fit(self, ensemble: Ensemble, instrument: Ensemble) -> KernelModel:
        ensembles = [ensemble] if self.reference is None else [ensemble, instrument]
        kernel = Kernel.of(ensemble, self.length_periodic, self.length_decay)
        runs = runs_of(ensembles, kernel, self.band)
        moments = moments_of(runs, kernel)
        scale = self.scale or fitted_scale(moments, kernel)
        variances = np.broadcast_to(self.gamma, 3) * scale**2 / 2
        precision = np.outer(1 / variances, kernel.precision).ravel()
        posterior = fitted_weights(moments, precision)
        impedances = impedance_over(ensemble, kernel, posterior.mean)
        for _ in range(REWEIGHTED * (self.weighting == "residual")):
            runs = whitened(runs, residuals_of(ensemble, impedances))
            posterior = fitted_weights(moments_of(runs, kernel), precision)
            impedances = impedance_over(ensemble, kernel, posterior.mean)
        residuals = residuals_of(ensemble, impedances)
        edge = base.missing_edge(HALF_WIDTH, ensemble)
        # If each run is a single realization, none has derivatives at its ends.
        missing = edge if all(len(run) == 1 for run in ensemble.runs) else 0
        known = slice(missing, ensemble.samples - missing)
        impedance = base.padded(impedances.mean(axis=0)[known], missing)
        errors = partial(self._errors, posterior, kernel, known, residuals, instrument)
        details = {
            "noise_variance": 2 * posterior.noise_variance,  # of the complex error
            "second_order_agreement": shared.residual_agreement(instrument, residuals, edge),
        }
        return KernelModel(
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(impedance, errors),
            posterior=posterior,
            labels=tuple(f"{name} {j}" for name in IMPEDANCE for j in range(kernel.column_count)),
            kernel=kernel,
            scale=scale,
            diagnostics=Diagnostics(posterior.effective, details=details),
        )

    def _errors(
        self,
        posterior: Posterior | FittedWeights,
        kernel: Kernel,
        known: slice,
        residuals: Array,
        instrument: Ensemble,
    ) -> dict[str, StandardError]:
        """Return the standard errors of means over realizations, at ``known`` times."""
        columns = kernel.means(*times_of(instrument, kernel))[known]
        low, high = (min(frequency / instrument.sampling_rate, 0.5) for frequency in self.band)
        # The posterior does not know that a mean over realizations was subtracted.
        factors = len(instrument) / shared.independent_realizations(instrument) * np.ones(3)
        # The posterior assumes that the noise is white in the band.
        if self.weighting == "white":
            filters = derivative_filters(HALF_WIDTH, instrument.sampling_rate)
            share, filters = posterior.effective / residuals.size, _in_band(filters, low, high)
            noise, coloured = shared.noise_colour(instrument, residuals, share, filters)
            factors *= coloured / power_in_band(noise, low, high)
        blocks = posterior.covariance.reshape((3, kernel.column_count) * 2)
        return shared.posterior_errors(
            np.stack([columns] * 3),
            np.einsum("qiqj->qij", blocks),  # covariance of each quantity with itself
            max(1.0, 2 * residuals.size * (high - low) - posterior.effective),
            instrument.samples,
            factors,
        )

    def _open_loop_evidence(self, ensemble: Ensemble) -> Evidence:
        """Compare settings by marginal likelihood: l1 and gammas, then decays.

        The search is deterministic, with white weights. Noise that is not white in the band lowers
        the number of independent samples. The residual of the given settings, without decay, shows
        by how much.
        """
        method = attrs.evolve(self, weighting="white", length_decay=ENDLESS)
        endless = method._fit(ensemble, ensemble)
        gammas = np.broadcast_to(self.gamma, 3) * endless.scale**2
        given = np.array([self.length_periodic, *gammas, 2 * endless.posterior.noise_variance])
        share = shared.independent_share(ensemble, endless.predict(ensemble), self.band)
        tried = search.tried_settings(self.length_decay, given, ensemble, self.band, share)
        return search.evidence_of(tried, self, endless.scale)


def fitted_weights(moments: Moments, precision: Array) -> Posterior | FittedWeights:
    r"""Fit the weights under a prior precision (column,) and find the noise variance they leave.

    .. math:: y = X w + e, \qquad e \sim N(0, \sigma^2 I), \qquad w \sim N(0, P^{-1}), \qquad
              \sigma^2 = \frac{\|\hat e\|^2}{N - N_{eff}}

    At this fixed point the derivative of the evidence by the noise variance vanishes. The numbers
    of y are real and imaginary parts, so :math:`\sigma^2` is half the variance of complex noise.

    If the moments have twice as many columns as the prior, the second half are instruments
    (:func:`weights_by_instruments`).
    """
    has_instruments = len(moments.cross) > len(precision)
    power = moments.square / moments.number
    noise = INITIAL_NOISE * power
    found: Posterior | FittedWeights
    for _ in range(ITERATIONS):
        if has_instruments:
            found = weights_by_instruments(moments, precision, noise)
            variance = found.noise_variance
        else:
            found = posterior = solve(moments, precision, noise)
            variance = posterior.residual / max(moments.number - posterior.effective, 1.0)
        wanted = max(variance, SMALLEST_RESIDUAL * power)
        if abs(wanted - noise) <= CONVERGED * noise:
            break
        noise = wanted
    if isinstance(found, Posterior):  # its covariance is computed only where it is needed
        return found
    covariance = found.covariance * (noise / found.noise_variance)
    return found._replace(covariance=covariance, noise_variance=noise)


def weights_by_instruments(moments: Moments, precision: Array, noise: float) -> FittedWeights:
    """Fit the weights by instruments, under a prior and for an assumed noise variance.

    The ``moments`` are those of the columns, then of the instruments. The returned noise variance
    is that of the residual (:func:`tvsysid.numerics.gaussian.by_instruments`).
    """
    gram, cross, square, number = moments
    gram = np.tril(gram) + np.tril(gram, -1).T
    count = len(precision)
    x, z = slice(count), slice(count, None)
    posterior = solve(moments.take(np.arange(count, 2 * count)), precision, noise)

    def residual(mean: Array) -> float:
        return square - float(mean @ (2 * cross[x] - gram[x, x] @ mean))

    fit = FittedWeights(posterior.mean, posterior.covariance, noise, posterior.effective)
    return by_instruments(fit, gram[z, x] - gram[z, z], residual, number)


def fitted_scale(moments: Moments, kernel: Kernel) -> float:
    """Return the ``scale`` in N·m/rad of the constant impedance that fits the data best.

    It follows from the modulus at 1 Hz, which does not depend on the perturbation or the noise,
    and is not 0 for a joint without stiffness.
    """
    # The first column of each signal is the constant. The last three signals before the torque are
    # the angle, or the one predicted from a reference, and its derivatives.
    constants = np.arange(0, len(moments.cross), kernel.column_count)[-3:]
    impedance = solve(moments.take(constants), np.zeros(3)).mean
    modulus = abs(np.polynomial.polynomial.polyval(2j * np.pi, impedance))
    return NM_PER_DEG / PAPER_MODULUS * float(modulus)


@attrs.frozen(eq=False, repr=False, kw_only=True)
class KernelModel(responses.SecondOrderModel):
    """Impedance as a function of time that can be evaluated at any time.

    ``stiffness``, ``viscosity`` and ``inertia`` are means over the realizations that it was
    identified from. A prediction uses the impedance at the time of each realization. The
    coefficients multiply the columns of the ``kernel``. ``scale`` is the stiffness in N·m/rad whose
    square is the unit of gamma.
    """

    kernel: Kernel
    scale: float

    def impedance(self, ensemble: Ensemble) -> Array:
        """Return stiffness, viscosity and inertia of each realization, (realization, time, 3).

        The first axis has length 1 if all realizations have the same impedance.
        """
        return impedance_over(ensemble, self.kernel, self.coefficients)

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        return {"intrinsic": shared.second_order_torque(ensemble, self.impedance(ensemble))}


def times_of(ensemble: Ensemble, kernel: Kernel) -> tuple[Array, Array]:
    """Return the times in s of each realization from the trial's time 0, and on the record's clock.

    Both have shape (realization, time), or (1, time) where all realizations have the same features.
    """
    onsets, clocks = ensemble.onsets, clocks_of(ensemble)
    # Rounding may turn a phase just below the period into the period, which is phase 0.
    if np.ptp(np.round(onsets % kernel.period, 9) % kernel.period) < 1e-9:
        onsets = onsets[:1]
    if not kernel.slow.any():
        clocks = clocks[:1]
    return onsets[:, None] + ensemble.time, clocks[:, None] + ensemble.time


def impedance_over(ensemble: Ensemble, kernel: Kernel, coefficients: Array) -> Array:
    """Return stiffness, viscosity and inertia at :func:`times_of`, shape (realization, time, 3)."""
    return kernel.sums(*times_of(ensemble, kernel), coefficients.reshape(3, -1))


def residuals_of(ensemble: Ensemble, impedances: Array) -> Array:
    """Return the residual torque (realization, time) where the angle's derivatives are known."""
    edge = base.missing_edge(HALF_WIDTH, ensemble)
    residuals = ensemble.torque[:, ensemble.core] - shared.second_order_torque(ensemble, impedances)
    return residuals[:, edge : ensemble.samples - edge]


def _in_band(filters: Array, low: float, high: float) -> Array:
    """Return filters followed by a band-pass filter; the band is in cycles per sample."""
    if high - low >= 0.5:
        return filters
    lags = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
    passing = np.hamming(len(lags)) * (
        2 * high * np.sinc(2 * high * lags) - 2 * low * np.sinc(2 * low * lags)
    )
    return np.stack([np.convolve(row, passing) for row in filters])
