"""Kernel-based regression (KBR)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any, Literal, Self

import attrs
import numpy as np

from tvsysid.methods import base, responses, shared, tuning
from tvsysid.methods.kbr import search
from tvsysid.methods.kbr.fit import KernelPosterior, fit, fit_coefficients
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel
from tvsysid.methods.kbr.record import Record, clocks_of, lagged
from tvsysid.models import Diagnostics, StandardError
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import Validator, is_number, not_negative, one_of, optional, positive

Preset = Literal["simulation", "experiment"]
Weights = Literal["white", "residual"]

# The paper's settings for its simulated study (section 3.2.5) and its experimental one (4.2).
PRESETS: dict[str, dict[str, float]] = {
    "simulation": {"length_periodic": math.exp(-2), "length_decay": ENDLESS, "gamma": 4.5},
    "experiment": {"length_periodic": math.exp(-1), "length_decay": 30.0, "gamma": 13.8},
}
DEGREE = math.degrees(1.0)  # 1 N·m/deg in N·m/rad
# modulus in N·m/rad at 1 Hz of the paper's joint, for which gamma counts in (N·m/deg)²
USUAL_MODULUS = 100.0
# times that residual weights are found; a third changes stiffness by a hundredth of its error
REWEIGHTED = 2


def _numbers(value: Any, count: int) -> bool:
    """Return whether a value is a tuple of this count of numbers."""
    return isinstance(value, tuple) and len(value) == count and all(map(is_number, value))


USUAL = PRESETS["simulation"]
GAMMA = Validator(
    "a positive number, or three: of stiffness, viscosity and inertia",
    lambda gamma: positive.is_valid(gamma) or (_numbers(gamma, 3) and min(gamma) > 0),
)
BAND = Validator(
    "two frequencies in Hz, which rise from 0 or more",
    lambda band: _numbers(band, 2) and 0 <= band[0] < band[1],
)
ORDER = Validator(
    "0 (a spring), 1 (with viscosity) or 2 (with inertia too)",
    lambda order: type(order) is int and 0 <= order <= 2,
)


@attrs.frozen
class KernelRegression(shared.ByReference):
    r"""Impedance that changes smoothly and almost periodically, fitted in the frequency domain.

    .. math:: y(t) + a_1\,\dot y(t) = \sum_{m=0}^{N_b} b_m(t)\,\theta^{(m)} - f_{ext}(t), \qquad
              b_m = \bar b_m + \tilde b_m, \quad \tilde b_m \sim GP(0, K)

    .. math:: \min_{b} \sum_{k} \frac{|E(k)|^2}{\hat\sigma_E^2}
              + \sum_m \tilde b_m^T K^{-1} \tilde b_m, \qquad
              K(t, t') = \gamma\, e^{-\sin^2(\pi (t - t') / p) / l_1}\, e^{-(t - t')^2 / l_2^2}

    (equations 13 to 17 of van de Ruit et al. 2021; Cavallo et al. 2020, Lataire et al. 2017). The b
    are stiffness, viscosity and inertia: Na = 0 and Nb = 2, unless ``lag`` and ``order`` say
    otherwise. E is the spectrum of the equation error over each unbroken run of realizations. The
    kernel K says how fast the b may change; ``tuned`` chooses it by maximum evidence.

    Parameters
    ----------
    period
        Period p of the behaviour in s; None takes the duration of a realization.
    length_periodic
        l1: smoothness within a period; larger is smoother. It has no unit, although the paper
        prints seconds.
    length_decay
        l2 in s: time over which the periods become different. From 20 record lengths on, the kernel
        is strictly periodic.
    gamma
        Prior variance about their means of stiffness, viscosity and inertia, or one number for all
        three, in units of the ``scale`` squared. The paper gives one, without a unit.
    band
        Lowest and highest frequency in Hz of the equation error that is fitted.
    order
        Nb: 2 for inertia, viscosity and stiffness; 1 for a joint without inertia, which then is 0
        and has no band; 0 for a spring. With a lower order, the gammas of the missing terms have no
        effect.
    lag
        a_1 in s: a constant first-order lag of the torque behind the joint, for example of a sensor
        or a filter; 0 for none (Na = 0).
    scale
        Unit of gamma: a gamma of 1 stands for this, in N·m/rad (N·m·s/rad of viscosity, kg·m² of
        inertia). If None, it is 0.573 of the modulus at 1 Hz of the constant impedance that fits
        the data best. The units of torque and angle then scale the estimates, and change nothing
        else. For the paper's joint, with a mean of 100 N·m/rad, the scale is 57.3 N·m/rad, or 1
        N·m/deg. ``scale=57.29578`` fixes this value: gamma is then in (N·m/deg)² for any joint.
    reference
        Channel with the disturbance that was applied, for a joint in closed loop, where torque
        noise also moves the angle. The angle that the reference predicts
        (:mod:`tvsysid.methods.shared.instrument`) then replaces the angle in the left factor of the
        normal equations.
    weighting
        ``"white"``: all frequencies have the same weight, as in the paper. ``"residual"``: the
        weight is the inverse of the residual's power (averaged over ±0.5 Hz, in two iterations).
        This is best where the noise is not white in the band. With slow noise it reduces the random
        error by a third to three quarters, in open and in closed loop.

    Notes
    -----
    The unit of gamma is a convention, not a reconstruction. With 1 N·m/rad, the paper's 4.5 would
    hold stiffness within 2 N·m/rad of a constant. With 1 N·m/deg it allows some 120 N·m/rad, and
    gives figures like the paper's.

    The lag is fitted as output error, since an equation error with the derivative of a noisy torque
    is biased: the angle passes the lag (:func:`tvsysid.numerics.lowpass.low_pass`), and the
    impedance of what comes out is that of the joint. This takes the lag and the change of b in the
    other order, which errs by about :math:`a_1 \dot b_m / b_m` as a share of each term.

    The kernel is used in a low-rank form: Fourier series with known variances times eigenfunctions
    of the decay (:mod:`tvsysid.methods.kbr.kernel`), which makes the problem a ridge regression
    with some 110 unknowns. The cost grows with the cube of the record where the decay is short
    against it: 600 s at 30 s take 3800 coefficients and some 10 s. The paper's decay of 120 000 s
    is meant as none.

    The external term is a sum of five half-cosines over a run, with the torque's variance as prior
    variance each.

    Features whose torque cannot reach a small share of the noise are left out, for each coefficient
    by its own signal. They keep their prior. This changes stiffness by some 1e-3 N·m/rad.

    The noise variance is estimated from the residual, with the effective number of parameters
    subtracted from the degrees of freedom. The diagnostics' ``second_order_agreement`` is the share
    of the angle-dependent torque that order 2 explains.

    The bands are those of the posterior, which assumes white noise within the band, times a factor
    for the noise's colour (:func:`tvsysid.numerics.noise.colour_factors`). They cover smoothing
    bias only if the behaviour is as smooth as the kernel says: near a switch, the truth lies
    outside the bands.
    """

    period: float | None = attrs.field(default=None, validator=optional(positive))
    length_periodic: float = attrs.field(default=USUAL["length_periodic"], validator=positive)
    length_decay: float = attrs.field(default=USUAL["length_decay"], validator=positive)
    gamma: float | tuple[float, float, float] = attrs.field(default=USUAL["gamma"], validator=GAMMA)
    band: tuple[float, float] = attrs.field(default=(0.0, 20.0), validator=BAND)
    order: int = attrs.field(default=2, validator=ORDER)
    lag: float = attrs.field(default=0.0, validator=not_negative)
    scale: float | None = attrs.field(default=None, validator=optional(positive))
    reference: str | None = None
    weighting: Weights = attrs.field(default="white", validator=one_of(Weights))

    key = "kbr"
    contiguous = True
    title = "Kernel-based regression"
    assumptions = (
        "Stiffness, viscosity and inertia change smoothly and nearly periodically, as the kernel "
        "says.",
        "The joint is of second order (or of the order given), with at most one lag of the torque, "
        "whose coefficient is constant (Na > 0).",
        "The record is continuous; one realization is enough, more are better.",
    )
    differs = (
        "Its kernel says beforehand how smooth and how periodic stiffness is: a switch comes out "
        "smooth, with ripples beside it."
    )
    cites = ("lataire2017", "cavallo2020", "vanderuit2021")
    bands_need_strength = False

    @classmethod
    def preset(cls, name: Preset, **settings: Any) -> Self:
        """Return a method with the paper's settings, changed where ``settings`` say otherwise.

        ``"simulation"`` has the settings of the paper's simulated study, and the method's default
        values. ``"experiment"`` has those of the experimental study.
        """
        one_of(Preset).check("KernelRegression", "preset", name)
        return cls(**(PRESETS[name] | settings))

    @property
    def least_share(self) -> float:
        """Return the least share that the reference must explain; residual weights need less."""
        return shared.HARDLY_MOVED if self.weighting == "white" else shared.LEAST

    def _fit(self, ensemble: Ensemble, moved: Ensemble) -> KernelModel:
        record = Record.of(moved, self.band)
        variances = self._variances(self._scale(record))[: self.order + 1]
        if self.lag:  # an impedance behind a lag is the impedance of the lagged angle
            ensemble, moved = (lagged(each, self.lag) for each in (ensemble, moved))
            record = Record.of(moved, self.band)
        if self.reference is not None:
            record = Record.of(ensemble, self.band).with_instrument(record)
        kernel = record.kernel(self._period(ensemble), self.length_periodic, self.length_decay)
        reweighted = REWEIGHTED * (self.weighting == "residual")
        posterior = fit_coefficients(record, kernel, variances, reweighted)
        each = impedance_over(ensemble, kernel, posterior.mean)
        # Where the derivatives lack samples at the ends of every run, nothing was identified.
        edge = base.missing_edge(shared.HALF_WIDTH, ensemble)
        missing = edge if all(len(run) == 1 for run in ensemble.runs) else 0
        impedance = each.mean(axis=0)
        known = impedance[missing : len(impedance) - missing]
        inner = slice(edge, ensemble.samples - edge)
        filters = shared.derivative_filters(shared.HALF_WIDTH, ensemble.sampling_rate)
        filters = filters[: self.order + 1]
        # What the impedance leaves of the torque, and what its mean over realizations leaves.
        mean_left = left = shared.residual(ensemble, impedance[inner, : self.order + 1] @ filters)
        if len(each) > 1:
            torque = ensemble.torque[:, ensemble.core]
            left = (torque - shared.second_order_torque(ensemble, each))[:, inner]
        found = posterior.fit
        # The error E is complex: its variance is that of two numbers.
        details = {"noise_variance": 2 * found.noise_variance, "iterations": found.iterations}
        if self.order == 2:
            details["second_order_agreement"] = shared.residual_agreement(
                ensemble, moved, left, edge
            )
        low, high = (min(frequency / ensemble.sampling_rate, 0.5) for frequency in self.band)
        colour = None
        # The posterior assumes that the noise is as strong as its mean over the fitted band.
        if self.weighting == "white":
            share = found.effective / left.size
            colour = shared.Colour.of(moved, mean_left, share, _in_band(filters, low, high))
        errors = partial(
            standard_errors,
            posterior,
            times_of(ensemble, kernel),
            colour=colour,
            band=(low, high),
            # The posterior does not know that a mean over realizations was subtracted.
            stronger=len(ensemble) / shared.independent_realizations(ensemble),
            freedom=max(1.0, 2 * left.size * (high - low) - found.effective),
            times=ensemble.samples,
            missing=missing,
        )
        names = shared.IMPEDANCE[: self.order + 1]
        return KernelModel(
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(base.padded(known, missing), errors),
            posterior=posterior,
            labels=tuple(f"{name} {j}" for name in names for j in range(kernel.columns)),
            kernel=kernel,
            lag=self.lag,
            diagnostics=Diagnostics(found.effective, details=details),
        )

    def _scale(self, record: Record) -> float:
        """Return the stiffness in N·m/rad that corresponds to a gamma of 1, without a lag.

        Unlike the torque over the angle, the modulus at 1 Hz does not depend on the perturbation or
        the noise. A joint without stiffness also has one.
        """
        if self.scale is not None:
            return self.scale
        constant = Kernel.of(1.0, math.inf, math.inf, 0.0, 1.0, 1.0)
        found = fit(record.sums(constant, np.ones((3, 1), dtype=bool)), np.zeros(3))
        modulus = abs(np.polynomial.polynomial.polyval(2j * np.pi, found.mean))
        # of a torque that does not answer at all
        least = 1e-6 * math.sqrt(record.powers[-1] / record.powers[0])
        return DEGREE / USUAL_MODULUS * max(float(modulus), least)

    def _variances(self, scale: float) -> Array:
        """Return the prior variances of stiffness, viscosity and inertia about their means."""
        return np.broadcast_to(np.asarray(self.gamma, dtype=np.float64), 3) * scale**2

    def _period(self, ensemble: Ensemble) -> float:
        return ensemble.duration if self.period is None else self.period

    def _open_loop_evidence(self, ensemble: Ensemble, seed: int) -> tuning.Evidence:
        """Compare settings by marginal likelihood: l1 and gammas, orders and lags, then decays.

        The search is deterministic. Noise that is not white in the band lowers the number of
        independent samples. The residual of the given settings, without decay, shows by how much.
        """
        if self.weighting != "white":
            return attrs.evolve(self, weighting="white")._evidence(ensemble, seed)
        endless = attrs.evolve(self, length_decay=ENDLESS).fit(ensemble)
        noise = endless.diagnostics.details["noise_variance"]
        share = shared.independent_share(ensemble, endless.predict(ensemble), self.band)
        scale = self._scale(Record.of(ensemble, self.band))
        theta = np.log([self.length_periodic, *self._variances(scale), noise])
        given = search.Candidate(self.order, self.lag, self.length_decay, theta, "as given")
        searched = search.Search(ensemble, self._period(ensemble), self.band, noise, share)
        evidence = search.evidence_of(*searched.candidates(given), self, scale)
        if evidence.chosen:
            chosen = attrs.evolve(self, **evidence.settings)
            tuning.warn_if_worse(self, chosen, ensemble)
        return evidence

    def _own_warnings(self, ensemble: Ensemble) -> Iterator[str]:
        period = self._period(ensemble)
        periods = ensemble.duration / period
        if abs(periods - round(periods)) > 1e-6:
            yield (
                f"a realization of {ensemble.duration:g} s is not a whole number of periods of "
                f"{period:g} s: the stiffness over a realization is a mean over different phases "
                "of the behaviour"
            )


@attrs.frozen(eq=False, repr=False, kw_only=True)
class KernelModel(responses.SecondOrderModel):
    """Impedance as a function of time that can be evaluated at any time.

    ``stiffness``, ``viscosity`` and ``inertia`` are means over the realizations that it was
    identified from. A prediction uses the impedance at the time of each realization. The
    coefficients multiply the features of the ``kernel``. The torque lags behind what the joint
    does, with the time constant ``lag`` in s.
    """

    kernel: Kernel
    lag: float = 0.0

    def impedance(self, ensemble: Ensemble) -> tuple[Array, Array, Array]:
        """Return stiffness, viscosity, inertia in an ensemble, (time,) or (realization, time)."""
        each = impedance_over(ensemble, self.kernel, self.coefficients)
        stiffness, viscosity, inertia = np.moveaxis(each if len(each) > 1 else each[0], -1, 0)
        return stiffness, viscosity, inertia

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        derivatives = lagged(ensemble, self.lag).derivatives()
        parts = map(np.multiply, self.impedance(ensemble), derivatives)
        return {"intrinsic": np.asarray(sum(parts))}


def times_of(ensemble: Ensemble, kernel: Kernel) -> Array:
    """Return the times in s of each realization, shape (realization, 2, time).

    The first row counts from the trial's time 0, the second is the record's clock. Where all
    realizations have the same impedance, only the first is returned.
    """
    phases = np.round(ensemble.onsets % kernel.period, 9) % kernel.period
    starts = np.stack([ensemble.onsets, clocks_of(ensemble)], axis=1)
    some = starts[:1] if not kernel.slow.any() and np.ptp(phases) < 1e-9 else starts
    return np.asarray(some[..., None] + ensemble.time)


def impedance_over(ensemble: Ensemble, kernel: Kernel, coefficients: Array) -> Array:
    """Return stiffness, viscosity and inertia at :func:`times_of`, shape (realization, time, 3).

    A model of an order below 2 has zeros for its missing quantities.
    """
    phase, clock = np.moveaxis(times_of(ensemble, kernel), 1, 0)
    periodic, slow = kernel.periodic_features(phase), kernel.slow_features(clock)
    weights = np.zeros((slow.shape[-1], periodic.shape[-1], 3))
    for signal, of_signal in enumerate(coefficients.reshape(-1, kernel.columns)):
        weights[kernel.slow, kernel.place, signal] = of_signal
    return np.asarray(np.einsum("...h,...hm->...m", periodic, np.tensordot(slow, weights, 1)))


def standard_errors(
    posterior: KernelPosterior, times: Array, /, **noise: Any
) -> dict[str, StandardError]:
    """Return the standard errors of impedances averaged over realizations.

    ``times`` are those of :func:`times_of`, ``noise`` the settings of
    :func:`tvsysid.methods.shared.residuals.posterior_errors`.
    """
    kernel, covariance = posterior.kernel, posterior.covariance
    features = np.asarray(sum(kernel(*each) for each in times)) / len(times)
    count, columns = len(posterior.variances), kernel.columns
    blocks = covariance.reshape(count, columns, count, columns)
    covariances = [blocks[number, :, number] for number in range(count)]
    return shared.posterior_errors([features] * count, covariances, **noise)


def _in_band(filters: Array, low: float, high: float) -> Array:
    """Return filters followed by a band-pass filter; the band is in cycles per sample."""
    if high - low >= 0.5:
        return filters
    lags = np.arange(-shared.HALF_WIDTH, shared.HALF_WIDTH + 1)
    passing = np.hamming(len(lags)) * (
        2 * high * np.sinc(2 * high * lags) - 2 * low * np.sinc(2 * low * lags)
    )
    return np.stack([np.convolve(row, passing) for row in filters])
