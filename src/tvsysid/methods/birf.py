"""Basis impulse response function (bIRF)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
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
from tvsysid.methods.correlations import impulse_response_model
from tvsysid.methods.evidence import Evidence
from tvsysid.models import Diagnostics, ImpulseResponseModel, Model, SecondOrderModel
from tvsysid.numerics.bases import Basis, CubicBSplines, FourierSeries, HaarWavelets, evaluate
from tvsysid.numerics.bayes import PRIORS, Posterior
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
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
PIECE = 0.5
"""Duration in s over which noise may be alike."""
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
        share = _independent_share(ensemble, self._identify(ensemble))
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
        gram, cross, square, power = np.zeros((unknowns**2, count**2)), np.zeros((unknowns, count)), 0.0, 0.0
        for chunk, phi_uu, phi_uy, squares in _moments(ensemble, lags):
            at = inner[chunk]
            gram += phi_uu.reshape(len(at), -1).T @ (at[:, :, None] * at[:, None, :]).reshape(len(at), -1)
            cross += phi_uy.T @ at
            square += float(squares.sum())
            power += float(np.trace(phi_uu.sum(axis=0)))
        gram = gram.reshape(unknowns, unknowns, count, count).transpose(0, 2, 1, 3).reshape(unknowns * count, -1)
        power /= unknowns * len(inner)  # to unit RMS, so that one prior has no unit
        posterior = self._solve(gram / power, cross.ravel() / np.sqrt(power), square, ensemble, missing, share)
        weights = inner @ posterior.mean.reshape(unknowns, count).T / np.sqrt(power)
        return impulse_response_model(repr(self), ensemble, weights, lags, _diagnostics(posterior))

    def _parametric(self, ensemble: Ensemble, functions: Array, share: float) -> SecondOrderModel:
        check_window("BasisIRF: the derivatives of the angle", 2 * HALF_WIDTH + 1, ensemble)
        missing = missing_edge(HALF_WIDTH, ensemble)
        # Angle, velocity and acceleration are sums of lagged angles, so their moments follow.
        derivative = derivative_weights() * ensemble.sampling_rate ** np.arange(3.0)[:, None]
        parts = [
            (derivative @ phi_uu @ derivative.T, phi_uy @ derivative.T, squares)
            for _, phi_uu, phi_uy, squares in _moments(ensemble, HALF_WIDTH)
        ]
        moments, cross, squares = (np.concatenate(values) for values in zip(*parts, strict=True))
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
        coefficients = posterior.mean * unit

        def over_time(values: Array) -> Array:
            return padded(values[missing : len(values) - missing], missing)

        names = [f"{name} {j}" for name in ("stiffness", "viscosity") for j in range(count)]
        return SecondOrderModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            stiffness=over_time(functions @ coefficients[:count]),
            viscosity=over_time(functions @ coefficients[count : 2 * count]),
            inertia=over_time(np.full(ensemble.samples, coefficients[-1])),
            coefficients=coefficients,
            covariance=posterior.covariance * np.outer(unit, unit),
            labels=(*names, "inertia"),
            diagnostics=_diagnostics(posterior),
        )

    def _solve(
        self, gram: Array, cross: Array, square: float, ensemble: Ensemble, missing: int, share: float
    ) -> Posterior:
        """Coefficients from moments that were averaged over realizations and summed over time."""
        count = len(ensemble) * share
        samples = round(count * (ensemble.samples - 2 * missing))
        return PRIORS[self.prior](gram * count, cross * count, square * count, samples)


def _independent_share(ensemble: Ensemble, model: Model) -> float:
    """How many independent samples one sample is worth for stiffness, at most 1.

    The variance of the angle times the residual, over that of its sums over pieces of a realization: what an estimate
    of stiffness from a piece takes from the noise.
    """
    product = ensemble.angle[:, ensemble.core] * (ensemble.torque[:, ensemble.core] - model.predict(ensemble))
    length = min(max(2, round(PIECE * ensemble.sampling_rate)), ensemble.samples)
    pieces = product[:, : ensemble.samples // length * length].reshape(-1, length)
    pieces = pieces[np.isfinite(pieces).all(axis=1)]
    sums = float(np.mean(pieces.sum(axis=1) ** 2)) if len(pieces) else 0.0
    return min(1.0, length * float(np.mean(pieces**2)) / sums) if sums > 0 else 1.0


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


def _diagnostics(posterior: Posterior) -> Diagnostics:
    return Diagnostics(
        posterior.effective,
        details={
            "noise_variance": posterior.noise_variance,
            "log_evidence": posterior.log_evidence,
            "iterations": posterior.iterations,
            "converged": float(posterior.converged),
        },
    )
