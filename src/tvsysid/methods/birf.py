"""Basis impulse response function (bIRF)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.estimates import StandardError, impedance_estimates, standard_errors
from tvsysid.impedance import agreement, derivative_filters, second_order_fit
from tvsysid.methods.base import (
    EXCITED_ABOVE,
    Method,
    check_choice,
    check_positive,
    check_window,
    fitting_lags,
    missing_edge,
    padded,
)
from tvsysid.methods.shared.correlations import impulse_response_model
from tvsysid.methods.shared.residuals import (
    colour,
    independent_realizations,
    independent_share,
    residual,
    second_order_agreement,
)
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.models import Diagnostics, ImpulseResponseModel, Model, SecondOrderModel
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.bases import Basis, CubicBSplines, FourierSeries, HaarWavelets, evaluate
from tvsysid.numerics.bayes import PRIORS, Posterior
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.moments import lagged_moments, time_chunks
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]
Prior = Literal["ard", "ridge", "none"]
Structure = Literal["parametric", "irf"]

BASES: tuple[Basis, ...] = (
    *(CubicBSplines(functions) for functions in (4, 6, 8, 10, 12, 16, 20, 28, 40)),
    *(CubicBSplines(functions, periodic=True) for functions in (6, 8, 10, 12, 16, 20, 28, 40)),
    *(FourierSeries(harmonics) for harmonics in (0, 1, 2, 3, 4, 6, 8, 12, 16)),
    *(HaarWavelets(functions) for functions in (2, 4, 8, 16, 32)),
)
"""Bases of which a tuned one is the best."""
MOST = 500
"""Coefficients of the largest model that is tried."""
CLEARLY = 3.0
"""Log evidence by which a basis must be better than the one given to be chosen: 20 to 1."""


@dataclass(frozen=True)
class BasisIRF(Method):
    r"""Time variation as a sum of basis functions, with sparse Bayesian coefficients.

    .. math:: h(t, \tau) = \sum_j \lambda_{\tau j} \Lambda_j(t) \qquad\text{or}\qquad
              y(t) = \sum_j \left[ c_j \Lambda_j(t)\, \theta + d_j \Lambda_j(t)\, \dot\theta \right] + I\,\ddot\theta

    (equation 8 of van de Ruit et al. 2021; Guarin & Kearney 2017, 2018). The paper takes stiffness from the second,
    parametric, model.

    Parameters
    ----------
    max_lag
        Lags to either side in s, of the impulse response.
    basis
        Basis functions of normalised time; see :mod:`tvsysid.numerics.bases`, or any callable from (time,) to
        (time, function).
    model
        ``"parametric"``: stiffness and viscosity by the basis, constant inertia. ``"irf"``: impulse response by the
        basis, stiffness its area.
    prior
        ``"ard"``: one precision for each coefficient (relevance vector machine); ``"ridge"``: one for all, the
        signals being scaled to unit RMS; ``"none"``: least squares.

    Notes
    -----
    Everything follows from the correlations of lagged inputs at each time: the Gram matrix of all coefficients
    is :math:`\sum_i \Phi(i) \otimes \Lambda(i)\Lambda(i)^T`, and velocity and acceleration are sums of lagged angles
    (:mod:`tvsysid.numerics.differentiation`). The regressor, with a row for each sample of each realization, is never
    built.

    The bands are those of the posterior, which takes the noise as white, times a factor for its colour
    (:func:`tvsysid.numerics.noise.colour_factors`; for ``"irf"``, too, that of the parametric model). They take noise
    and angle as equally strong at all times, and do not count what the basis cannot follow; where ``"ard"`` prunes a
    coefficient, they count it as known to be zero.

    Viscosity and inertia of ``"irf"`` are those of a second-order fit to the impulse response, weighted by the
    angle's mean correlations. The diagnostics' ``second_order_agreement`` says how well that, or the parametric model,
    explains the torque that answers to the angle.
    """

    max_lag: float = 0.12
    basis: Basis = field(default_factory=CubicBSplines)
    model: Structure = "parametric"
    prior: Prior = "ard"

    key: ClassVar[str] = "birf"
    title: ClassVar[str] = "Basis impulse response function"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Behaviour is the same in all realizations.",
        "Its change in time is a sum of the basis functions chosen, which limits what is seen.",
        "For stiffness: inertia, viscosity and stiffness are all there is (second order).",
    )

    def __post_init__(self) -> None:
        check_positive(self, max_lag=self.max_lag)
        check_choice(self, "model", Structure)
        check_choice(self, "prior", Prior)
        if not callable(self.basis):
            raise InputError(
                f"BasisIRF: basis must be a callable from normalised time to values, got {self.basis!r}; "
                "for example CubicBSplines(10)"
            )

    def _identify(self, ensemble: Ensemble) -> Model:
        return self._from_share(ensemble, 1.0)

    def _from_share(self, ensemble: Ensemble, share: float) -> Model:
        """Model identified as if only a share of the samples were there; all of them are, but weigh less."""
        functions = evaluate(self.basis, ensemble.samples)
        identify = self._parametric if self.model == "parametric" else self._irf
        return identify(ensemble, functions, share)

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        """Evidence of bases, less the number of precisions that were fitted to the data.

        Noise that is not white makes samples worth less than as many independent ones, and is told by the residual.
        ``seed`` is not needed: nothing is drawn at random.
        """
        if self.prior == "none":
            raise InputError(
                "BasisIRF: least squares has no evidence to choose a basis by; set prior to 'ard' or 'ridge'"
            )
        per_function = 2 if self.model == "parametric" else 2 * fitting_lags("BasisIRF", self.max_lag, ensemble) + 1
        nyquist = ensemble.sampling_rate / 2
        share = independent_share(ensemble, self._identify(ensemble).predict(ensemble), (0.0, nyquist))
        tried: list[Basis] = []
        values, counts = [], []
        for basis in (self.basis, *(basis for basis in BASES if basis != self.basis)):
            functions = evaluate(basis, ensemble.samples).shape[1]
            if tried and per_function * functions > MOST:
                continue
            model = replace(self, basis=basis)._from_share(ensemble, share)
            # Each precision that was fitted raises the evidence, even of a function that is not there.
            fitted = per_function * functions if self.prior == "ard" else 1
            tried.append(basis)
            counts.append(functions)
            values.append(model.diagnostics.details["log_evidence"] - fitted)
        best = int(np.argmax(values))
        return Evidence(
            criterion="log evidence less precisions fitted",
            unit="nat",
            better="higher",
            tried=tuple({"basis": basis} for basis in tried),
            values=np.array(values),
            standard_errors=np.full(len(values), np.nan),
            chosen=best if values[best] > values[0] + CLEARLY else 0,
            axis="functions",
            positions=np.array(counts, dtype=np.float64),
            lines=tuple(_kind(basis) for basis in tried),
        )

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return 1 / (2 * self.max_lag), EXCITED_ABOVE

    def _irf(self, ensemble: Ensemble, functions: Array, share: float) -> ImpulseResponseModel:
        lags = fitting_lags("BasisIRF", self.max_lag, ensemble)
        missing = missing_edge(lags, ensemble)
        inner = functions[missing : len(functions) - missing]
        unknowns, count = 2 * lags + 1, inner.shape[1]
        gram, cross, square = np.zeros((unknowns**2, count**2)), np.zeros((unknowns, count)), 0.0
        moments_over_time = np.zeros((unknowns, unknowns))
        for chunk, phi_uu, phi_uy, squares in _moments(ensemble, lags):
            at = inner[chunk]
            gram += phi_uu.reshape(len(at), -1).T @ (at[:, :, None] * at[:, None, :]).reshape(len(at), -1)
            cross += phi_uy.T @ at
            square += float(squares.sum())
            moments_over_time += phi_uu.sum(axis=0)
        gram = gram.reshape(unknowns, unknowns, count, count).transpose(0, 2, 1, 3).reshape(unknowns * count, -1)
        # To unit RMS, so that one prior has no unit.
        power = float(np.trace(moments_over_time)) / (unknowns * len(inner))
        posterior = self._solve(gram / power, cross.ravel() / np.sqrt(power), square, ensemble, missing, share)
        weights = inner @ posterior.mean.reshape(unknowns, count).T / np.sqrt(power)
        covariance = posterior.covariance.reshape(unknowns, count, unknowns, count) / power
        # A second-order fit, weighted by the angle's mean correlations.
        mean_moments = moments_over_time / len(inner)
        derivative = derivative_filters(lags, ensemble.sampling_rate)
        projected = derivative @ mean_moments
        fit = second_order_fit((projected @ derivative.T)[None], np.zeros((1, 3))).inverse[0] @ projected
        impedance = weights @ fit.T
        beyond = mean_moments - projected.T @ fit
        shared = np.einsum("ajbk,jk->ab", covariance, inner.T @ inner / len(inner))
        details = {
            "second_order_agreement": agreement(
                np.einsum("ta,ab,tb->t", weights, mean_moments - beyond, weights),
                np.einsum("ta,ab,tb->t", weights, beyond, weights),
                np.full(len(weights), np.sum(beyond * shared)),
            )
        }
        readout = np.stack([np.ones(unknowns), fit[1], fit[2]])
        spreads = np.einsum("ma,ajbk,mb->mjk", readout, covariance, readout, optimize=True)
        left = residual(ensemble, weights, lags)
        errors = _errors(ensemble, (inner,) * 3, tuple(spreads), left, posterior.effective, missing)
        diagnostics = _diagnostics(posterior, details)
        return impulse_response_model(repr(self), ensemble, weights, impedance, lags, diagnostics, errors)

    def _parametric(self, ensemble: Ensemble, functions: Array, share: float) -> SecondOrderModel:
        check_window("BasisIRF: the derivatives of the angle", 2 * HALF_WIDTH + 1, ensemble)
        missing = missing_edge(HALF_WIDTH, ensemble)
        # Angle, velocity and acceleration are sums of lagged angles, so their moments follow.
        derivative = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
        parts, lagged = [], np.zeros((derivative.shape[1],) * 2)
        for _, phi_uu, phi_uy, squares in _moments(ensemble, HALF_WIDTH):
            parts.append((phi_uu @ derivative.T, phi_uy, squares))
            lagged += phi_uu.sum(axis=0)
        mixed, answers, squares = (np.concatenate(values) for values in zip(*parts, strict=True))
        moments, cross = derivative @ mixed, answers @ derivative.T
        square = float(squares.sum())
        rms = np.sqrt(np.maximum(np.mean(np.diagonal(moments, axis1=1, axis2=2), axis=0), np.finfo(float).tiny))
        moments, cross = moments / np.outer(rms, rms), cross / rms
        inner = functions[missing : len(functions) - missing]
        count = inner.shape[1]
        expansions = (inner, inner, np.ones((len(inner), 1)))
        gram = np.block(
            [
                [(left * moments[:, a, b, None]).T @ right for b, right in enumerate(expansions)]
                for a, left in enumerate(expansions)
            ]
        )
        right = np.concatenate([expansion.T @ cross[:, a] for a, expansion in enumerate(expansions)])
        posterior = self._solve(gram, right, square, ensemble, missing, share)
        unit = 1 / np.repeat(rms, (count, count, 1))
        coefficients, covariance = posterior.mean * unit, posterior.covariance * np.outer(unit, unit)
        places = np.split(np.arange(len(coefficients)), (count, 2 * count))
        impedance = np.stack([e @ coefficients[at] for e, at in zip(expansions, places, strict=True)])
        explained = float(np.sum((cross * rms).T * impedance))
        fitted = float(np.einsum("mt,tmk,kt->", impedance, moments * np.outer(rms, rms), impedance))
        details = {
            "second_order_agreement": second_order_agreement(
                fitted / len(inner),
                np.mean(answers - np.einsum("tlm,mt->tl", mixed, impedance), axis=0),
                lagged / len(inner),
                (square - 2 * explained + fitted) / len(inner),
                len(ensemble) * len(inner),
            )
        }

        left = residual(ensemble, impedance.T @ derivative, HALF_WIDTH)
        covariances = tuple(covariance[np.ix_(at, at)] for at in places)
        errors = _errors(ensemble, expansions, covariances, left, posterior.effective, missing)

        stiffness, viscosity, inertia = (padded(values, missing) for values in impedance)
        names = [f"{name} {j}" for name in ("stiffness", "viscosity") for j in range(count)]
        return SecondOrderModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=impedance_estimates(stiffness, viscosity, inertia, errors),
            coefficients=coefficients,
            covariance=covariance,
            labels=(*names, "inertia"),
            diagnostics=_diagnostics(posterior, details),
        )

    def _solve(
        self, gram: Array, cross: Array, square: float, ensemble: Ensemble, missing: int, share: float
    ) -> Posterior:
        """Coefficients from moments that were averaged over realizations and summed over time."""
        count = len(ensemble) * share
        samples = round(count * (ensemble.samples - 2 * missing))
        return PRIORS[self.prior](gram * count, cross * count, square * count, samples)


def _kind(basis: Basis) -> str:
    """Name of a basis, without the number of its functions."""
    name = getattr(type(basis), "__name__", "basis")
    return f"periodic {name}" if isinstance(basis, CubicBSplines) and basis.periodic else name


def _moments(ensemble: Ensemble, lags: int) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Lagged moments and the torque's mean square, for a few times after another where the context has the lags."""
    first = max(0, ensemble.context - lags)
    angle, torque = (values[:, first : values.shape[1] - first] for values in (ensemble.angle, ensemble.torque))
    for chunk in time_chunks(angle.shape[1] - 2 * lags, 2 * lags + 1):
        within = slice(chunk.start, chunk.stop + 2 * lags)
        phi_uu, phi_uy, square, _ = lagged_moments(angle[:, within], torque[:, within], lags)
        yield chunk, phi_uu, phi_uy, square


def _errors(
    ensemble: Ensemble,
    expansions: tuple[Array, ...],
    covariances: tuple[Array, ...],
    left: Array,
    effective: float,
    missing: int,
) -> dict[str, StandardError]:
    """Standard errors of stiffness, viscosity and inertia from the posterior, corrected for the noise's colour.

    ``expansions`` (time, function) and their coefficients' ``covariances`` are those of the three; ``left`` is the
    residual.
    """
    filters = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
    factors = colour(ensemble, left, effective / left.size, filters).factors()
    # The posterior counts all samples; where the mean over realizations was subtracted, there is less noise in them.
    freedom = left.size * independent_realizations(ensemble) / len(ensemble) - effective
    stronger = (left.size - effective) / max(freedom, 1.0)
    variances = [
        stronger * factor * np.einsum("tj,jk,tk->t", expansion, covariance, expansion)
        for factor, expansion, covariance in zip(factors, expansions, covariances, strict=True)
    ]
    deviation = np.stack([padded(np.sqrt(np.maximum(variance, 0.0)), missing) for variance in variances], axis=1)
    arcs = [arc_length(*pair) for pair in zip(expansions, covariances, strict=True)]
    return standard_errors(deviation, np.full(deviation.shape, freedom), arcs)


def _diagnostics(posterior: Posterior, details: dict[str, float]) -> Diagnostics:
    return Diagnostics(
        posterior.effective,
        details={
            "noise_variance": posterior.noise_variance,
            "log_evidence": posterior.log_evidence,
            "iterations": posterior.iterations,
            "converged": float(posterior.converged),
            **details,
        },
    )
