"""Basis impulse response function (bIRF)."""

from __future__ import annotations

from typing import Literal

import attrs
import numpy as np
from scipy.fft import next_fast_len, rfft

from tvsysid.errors import InputError
from tvsysid.methods import base, shared, tuning
from tvsysid.methods.responses import ImpulseResponseModel, SecondOrderModel
from tvsysid.models import Diagnostics, Model
from tvsysid.numerics.bases import Basis, CubicBSplines, check_basis, evaluate
from tvsysid.numerics.moments import expanded
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import one_of, positive

Prior = Literal["ard", "ridge", "none"]
Structure = Literal["parametric", "irf"]

COLOUR = 0.6  # s over which the noise's autocorrelation counts with a reference


@attrs.frozen
class BasisIRF(shared.ByReference):
    r"""Model the change over time as a sum of basis functions, with sparse Bayesian coefficients.

    .. math:: h(t, \tau) = \sum_j \lambda_{\tau j} \Lambda_j(t) \qquad\text{or}\qquad
              y(t) = \sum_j \left[ c_j \Lambda_j(t)\, \theta
              + d_j \Lambda_j(t)\, \dot\theta \right] + I\,\ddot\theta

    (equation 8 of van de Ruit et al. 2021; Guarin & Kearney 2017, 2018). The paper takes stiffness
    from the second, parametric, model.

    Parameters
    ----------
    max_lag
        Lags to either side in s, of the impulse response.
    basis
        Basis functions of normalised time; see :mod:`tvsysid.numerics.bases`, or any callable from
        (time,) to (time, function).
    model
        ``"parametric"``: stiffness and viscosity by the basis, constant inertia. ``"irf"``: impulse
        response by the basis, stiffness its area.
    prior
        ``"ard"``: one precision for each coefficient (relevance vector machine); ``"ridge"``: one
        for all, the signals being scaled to unit RMS; ``"none"``: least squares.
    reference
        Channel with the disturbance that was applied, for a joint in closed loop, whose angle the
        noise of the torque moves too; of the parametric model. What it predicts of the angle is the
        instrument (:mod:`tvsysid.methods.shared.instrument`), and the coefficients are given their
        prior by a fit to it.

    Notes
    -----
    Everything follows from the correlations of lagged inputs at each time. The Gram matrix of all
    coefficients is :math:`\sum_i \Phi(i) \otimes \Lambda(i)\Lambda(i)^T`. Velocity and
    acceleration are sums of lagged angles (:mod:`tvsysid.numerics.differentiation`). The
    regressor, with a row for each sample of each realization, is never built.

    The bands are those of the posterior, which takes the noise as white, times a factor for its
    colour (:func:`tvsysid.numerics.noise.colour_factors`; for ``"irf"``, too, that of the
    parametric model). They take noise and angle as equally strong at all times. They do not count
    changes that the basis cannot follow. Where ``"ard"`` prunes a coefficient, they count it as
    known to be zero. With a reference they count the noise's autocorrelation itself.

    Viscosity and inertia of ``"irf"`` are those of a second-order fit to the impulse response,
    weighted by the angle's mean correlations. The diagnostics' ``second_order_agreement`` says
    how well that fit, or the parametric model, explains the torque linear in the angle.
    """

    max_lag: float = attrs.field(default=0.12, validator=positive)
    basis: Basis = attrs.field(
        factory=CubicBSplines, validator=lambda method, _, basis: check_basis(method, basis)
    )
    model: Structure = attrs.field(default="parametric", validator=one_of(Structure))
    prior: Prior = attrs.field(default="ard", validator=one_of(Prior))
    reference: str | None = None

    key = "birf"
    title = "Basis impulse response function"
    assumptions = (
        "Behaviour is the same in all realizations.",
        "Its change over time is a sum of the basis functions chosen; faster changes are missed.",
        "For stiffness: the joint is of second order (inertia, viscosity, stiffness).",
    )
    differs = (
        "It changes as its basis functions can: what changes faster comes out slower, with ripples "
        "about a switch."
    )
    cites = ("guarin2017", "guarin2018", "vanderuit2021")

    def __attrs_post_init__(self) -> None:
        if self.reference is not None and self.model != "parametric":
            raise InputError(
                "BasisIRF: with a reference, model must be 'parametric', of which the fit is known"
            )

    def fit(self, ensemble: Ensemble) -> Model:
        """Return the model of an ensemble."""
        functions = evaluate(self.basis, ensemble.samples)
        return (
            self._parametric(ensemble, functions)
            if self.model == "parametric"
            else self._irf(ensemble, functions)
        )

    def _parametric(self, ensemble: Ensemble, functions: Array) -> SecondOrderModel:
        instrument = self.instrument(ensemble)
        moved = ensemble if instrument is None else instrument.moved
        products = shared.colour_products(moved)  # which the bands need too
        moments = self._derivative_moments(moved, products)
        missing = (len(functions) - len(moments.square)) // 2
        expansions = _expansions(functions[missing : len(functions) - missing])
        sums, scale = _parametric_moments(moments, expansions)
        posterior = self._posterior(sums, ensemble)
        if instrument is not None:
            posterior = _instrumental(posterior, expansions, scale, ensemble, moved)
        coefficients = posterior.mean * scale
        covariance = posterior.covariance * np.outer(scale, scale)
        count = functions.shape[1]
        places = np.split(np.arange(len(coefficients)), (count, 2 * count))
        impedance = np.stack(
            [e @ coefficients[at] for e, at in zip(expansions, places, strict=True)], axis=1
        )
        filters = shared.derivative_filters(shared.HALF_WIDTH, ensemble.sampling_rate)
        left = shared.residual(ensemble, impedance @ filters)
        if instrument is None:
            agreement = moments.second_order_agreement(impedance, len(ensemble))
        else:
            agreement = shared.residual_agreement(ensemble, moved, left, missing)
        covariances = tuple(covariance[np.ix_(at, at)] for at in places)
        coloured = products if instrument is None else None
        errors = self._errors(
            ensemble, coloured, expansions, covariances, left, posterior.effective
        )
        diagnostics = _diagnostics(posterior, agreement)
        banded: shared.PosteriorErrors | shared.WhereStrong = errors
        if instrument is not None:
            banded, diagnostics = instrument.banded(errors), instrument.annotate(diagnostics)
        stiffness, viscosity, inertia = base.padded(impedance, missing).T
        names = [f"{name} {j}" for name in ("stiffness", "viscosity") for j in range(count)]
        return SecondOrderModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(stiffness, viscosity, inertia, banded),
            posterior=posterior._replace(mean=coefficients, covariance=covariance),
            labels=(*names, "inertia"),
            diagnostics=diagnostics,
        )

    def _irf(self, ensemble: Ensemble, functions: Array) -> ImpulseResponseModel:
        lags = base.fitting_lags("BasisIRF", self.max_lag, ensemble)
        missing = base.missing_edge(lags, ensemble)
        inner = functions[missing : len(functions) - missing]
        sums, scale, moments = _irf_moments(ensemble, inner, lags)
        posterior = self._posterior(sums, ensemble)
        unknowns, count = 2 * lags + 1, inner.shape[1]
        weights = inner @ posterior.mean.reshape(unknowns, count).T * scale
        covariance = posterior.covariance.reshape(unknowns, count, unknowns, count) * scale**2
        # A second-order fit, weighted by the angle's mean correlations.
        derivative = shared.derivative_filters(lags, ensemble.sampling_rate)
        projected = derivative @ moments
        fit = (
            shared.second_order_fit((projected @ derivative.T)[None], np.zeros((1, 3))).inverse[0]
            @ projected
        )
        beyond = moments - projected.T @ fit
        uncertain = np.einsum("ajbk,jk->ab", covariance, inner.T @ inner / len(inner))
        found = shared.agreement(
            np.einsum("ta,ab,tb->t", weights, moments - beyond, weights, optimize=True),
            np.einsum("ta,ab,tb->t", weights, beyond, weights, optimize=True),
            np.full(len(weights), np.sum(beyond * uncertain)),
        )
        readout = np.stack([np.ones(unknowns), fit[1], fit[2]])
        covariances = tuple(
            np.einsum("ma,ajbk,mb->mjk", readout, covariance, readout, optimize=True)
        )
        left, products = shared.residual(ensemble, weights), shared.colour_products(ensemble)
        errors = self._errors(
            ensemble, products, (inner,) * 3, covariances, left, posterior.effective
        )
        diagnostics = _diagnostics(posterior, found)
        return shared.impulse_response_model(
            repr(self), ensemble, weights, weights @ fit.T, diagnostics, errors
        )

    def _posterior(
        self, moments: shared.Moments, ensemble: Ensemble, share: float = 1.0
    ) -> shared.Regression:
        """Return the posterior from moments that are means over realizations.

        Samples count only as a ``share`` of independent ones.
        """
        return shared.PRIORS[self.prior](moments.times(len(ensemble) * share))

    def _derivative_moments(self, ensemble: Ensemble, products: Array) -> shared.DerivativeMoments:
        base.check_window(
            "BasisIRF: the derivatives of the angle", 2 * shared.HALF_WIDTH + 1, ensemble
        )
        first = max(0, ensemble.context - shared.HALF_WIDTH)
        angle, torque = (
            x[:, first : x.shape[1] - first] for x in (ensemble.angle, ensemble.torque)
        )
        return shared.derivative_moments(products, angle, torque, ensemble.sampling_rate)

    def _errors(
        self,
        ensemble: Ensemble,
        products: Array | None,
        expansions: tuple[Array, ...],
        covariances: tuple[Array, ...],
        left: Array,
        effective: float,
    ) -> shared.PosteriorErrors:
        """Return the standard errors of sums of coefficients times expansions (time, function).

        Without ``products`` of the angle, the covariances count the noise's colour already.
        """
        filters, colour = shared.derivative_filters(shared.HALF_WIDTH, ensemble.sampling_rate), None
        if products is not None:
            colour = shared.Colour.of(ensemble, left, effective / left.size, filters, products)
        # The posterior counts all samples; where their mean was subtracted, there is less noise in
        # them.
        freedom = left.size * shared.independent_realizations(ensemble) / len(ensemble) - effective
        return shared.PosteriorErrors(
            expansions,
            covariances,
            colour,
            band=(0.0, 0.5),
            stronger=(left.size - effective) / max(freedom, 1.0),
            freedom=freedom,
            times=ensemble.samples,
            missing=0,
        )

    def _open_loop_evidence(self, ensemble: Ensemble, seed: int) -> tuning.Evidence:
        """Return the log evidence of bases. The ``seed`` is not used: nothing is random."""
        parametric = self.model == "parametric"
        per_function = (
            2 if parametric else 2 * base.fitting_lags("BasisIRF", self.max_lag, ensemble) + 1
        )
        predicted = self.fit(ensemble).predict(ensemble)
        share = shared.independent_share(ensemble, predicted, (0.0, ensemble.sampling_rate / 2))
        moments = (
            self._derivative_moments(ensemble, shared.colour_products(ensemble))
            if parametric
            else None
        )

        def log_evidence(basis: Basis) -> float:
            functions = evaluate(basis, ensemble.samples)
            if moments is None:
                lags = per_function // 2
                missing = base.missing_edge(lags, ensemble)
                inner = functions[missing : len(functions) - missing]
                sums, _, _ = _irf_moments(ensemble, inner, lags)
            else:
                missing = (len(functions) - len(moments.square)) // 2
                expansions = _expansions(functions[missing : len(functions) - missing])
                sums, _ = _parametric_moments(moments, expansions)
            return self._posterior(sums, ensemble, share).log_evidence

        return tuning.evidence_of_bases(
            self.basis, self.prior, ensemble.samples, log_evidence, per_function
        )


def _expansions(functions: Array) -> tuple[Array, Array, Array]:
    """Return the functions (time, function) of stiffness, viscosity and constant inertia."""
    return functions, functions, np.ones((len(functions), 1))


def _parametric_moments(
    moments: shared.DerivativeMoments, expansions: tuple[Array, ...]
) -> tuple[shared.Moments, Array]:
    """Return the moments of columns of unit RMS, and the scale of their coefficients.

    Coefficients times the scale are those of the columns in their own units.
    """
    power = np.mean(np.diagonal(moments.regressors, axis1=1, axis2=2), axis=0)
    rms = np.sqrt(np.maximum(power, np.finfo(float).tiny))
    gram = _expanded(moments.regressors / np.outer(rms, rms), expansions)
    parts = zip(expansions, (moments.cross / rms).T, strict=True)
    cross = np.concatenate([expansion.T @ own for expansion, own in parts])
    scale = 1 / np.repeat(rms, [expansion.shape[1] for expansion in expansions])
    square, times = float(moments.square.sum()), len(moments.cross)
    return shared.Moments(gram, cross, square, times), scale


def _expanded(moments: Array, expansions: tuple[Array, ...]) -> Array:
    """Return the products of signals times functions of time, summed over time.

    ``moments`` (time, 3, 3) are those of the signals.
    """
    return np.block(
        [
            [(left * moments[:, a, b, None]).T @ right for b, right in enumerate(expansions)]
            for a, left in enumerate(expansions)
        ]
    )


def _instrumental(
    posterior: shared.Regression,
    expansions: tuple[Array, ...],
    scale: Array,
    ensemble: Ensemble,
    moved: Ensemble,
) -> shared.Regression:
    r"""Return the coefficients with instruments Z in the left factor.

    They follow from their posterior m, C in a fit to the instruments alone:

    .. math:: (Z^T X + \sigma^2 P)\, \hat w = Z^T y \iff \hat w = M m, \qquad
              M = (1 + C\, Z^T (X - Z) / \sigma^2)^{-1}

    whatever the prior. The covariance is :math:`A^{-1} Z^T R Z A^{-T}` with :math:`A^{-1} = M C
    / \sigma^2`. R is the covariance of the noise, of any colour, from the residual of the measured
    angle. Coefficients that the prior pruned stay 0.
    """
    missing = (ensemble.samples - len(expansions[0])) // 2
    at = slice(missing, ensemble.samples - missing)
    z, x = (each.derivatives()[:, :, at] for each in (moved, ensemble))
    surplus = _expanded(np.einsum("irt,jrt->tij", z, x - z), expansions) * np.outer(scale, scale)
    transform = np.linalg.inv(
        np.eye(len(scale)) + posterior.covariance @ surplus / posterior.noise_variance
    )
    mean = transform @ posterior.mean
    places = np.cumsum([each.shape[1] for each in expansions])[:-1]
    parts = zip(expansions, np.split(mean * scale, places), x, strict=True)
    fit = sum(expansion @ part * signal for expansion, part, signal in parts)
    left = ensemble.torque[:, ensemble.core][:, at] - fit
    freedom = max(left.size - posterior.effective, 1.0)
    spread = _noise_through(expansions, scale, z, left, round(COLOUR * ensemble.sampling_rate)) * (
        left.size / freedom
    )
    inverse = transform @ posterior.covariance / posterior.noise_variance
    noise = float(np.vdot(left, left)) / freedom
    return posterior._replace(
        mean=mean, covariance=inverse @ spread @ inverse.T, noise_variance=noise
    )


def _noise_through(
    expansions: tuple[Array, ...], scale: Array, signals: Array, left: Array, lags: int
) -> Array:
    r"""Return the variance (coefficient, coefficient) of :math:`Z^T e` for the noise e.

    The noise has the autocorrelation of the residual ``left`` within each realization, up to
    ``lags`` samples apart, under half a Hann window.
    """
    samples = left.shape[1]
    lags = min(lags, samples - 1)
    covariance = shared.autocovariance(left, lags) * (
        0.5 + 0.5 * np.cos(np.pi * np.arange(lags + 1) / (lags + 1))
    )
    size = next_fast_len(samples + lags, real=True)
    power = np.maximum(2 * rfft(covariance, size).real - covariance[0], 0.0) / size
    power[1 : (size + 1) // 2] *= 2  # of both signs of frequency
    found = np.zeros((len(scale), len(scale)))
    for each in signals.transpose(1, 0, 2):
        spectra = rfft(
            np.concatenate([e.T * own for e, own in zip(expansions, each, strict=True)]), size
        )
        found += ((spectra * power) @ spectra.conj().T).real
    return found * np.outer(scale, scale)


def _irf_moments(
    ensemble: Ensemble, functions: Array, lags: int
) -> tuple[shared.Moments, float, Array]:
    """Return the moments of the impulse response's columns, scaled to unit RMS, and the scale.

    The third value is the mean correlation of lagged angles (lag, lag).
    """
    first = max(0, ensemble.context - lags)
    angle, torque = (x[:, first : x.shape[1] - first] for x in (ensemble.angle, ensemble.torque))
    phi_uu, phi_uy, square, _ = shared.lagged_moments(angle, torque, lags)
    mean = phi_uu.mean(axis=0)
    rms = np.sqrt(np.trace(mean) / len(mean))
    gram, cross = expanded(phi_uu, functions) / rms**2, (phi_uy.T @ functions).ravel() / rms
    moments = shared.Moments(gram, cross, float(square.sum()), len(functions))
    return moments, 1 / float(rms), mean


def _diagnostics(posterior: shared.Regression, agreement: float) -> Diagnostics:
    details = {
        "noise_variance": posterior.noise_variance,
        "log_evidence": posterior.log_evidence,
        "iterations": posterior.iterations,
        "converged": float(posterior.converged),
        "second_order_agreement": agreement,
    }
    return Diagnostics(posterior.effective, details=details)
