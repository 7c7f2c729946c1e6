"""Basis impulse response function (bIRF)."""

from __future__ import annotations

from functools import partial
from typing import Literal, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods import base, shared
from tvsysid.methods.responses import SecondOrderModel
from tvsysid.methods.tuning import Evidence
from tvsysid.models import Diagnostics, Model, StandardError
from tvsysid.numerics.bases import (
    A_BASIS,
    Basis,
    CubicBSplines,
    FourierSeries,
    HaarWavelets,
    evaluate,
)
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_filters
from tvsysid.numerics.gaussian import PRIORS, FittedWeights, Moments, by_instruments
from tvsysid.numerics.moments import expanded, lagged_moments
from tvsysid.numerics.second_order import second_order_fit
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import one_of, positive

Prior = Literal["ard", "ridge", "none"]
Structure = Literal["parametric", "irf"]

# Bases that are tried.
BASES: tuple[Basis, ...] = (
    *(CubicBSplines(functions) for functions in (4, 6, 8, 10, 12, 16, 20, 28, 40)),
    *(CubicBSplines(functions, periodic=True) for functions in (6, 8, 10, 12, 16, 20, 28, 40)),
    *(FourierSeries(harmonics) for harmonics in (0, 1, 2, 3, 4, 6, 8, 12, 16)),
    *(HaarWavelets(functions) for functions in (2, 4, 8, 16, 32)),
)
MIN_GAIN_NAT = 3.0  # log evidence by which another basis must be better: 20 to 1


@attrs.frozen
class BasisIRF(shared.ReferenceMethod):
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
        Channel with the disturbance that was applied, for a joint in closed loop, where torque
        noise also moves the angle. Only for the parametric model. The angle predicted from it is
        the instrument (:mod:`tvsysid.methods.shared.instrument`).

    Notes
    -----
    Everything follows from the correlations of lagged inputs at each time. The Gram matrix of all
    coefficients is :math:`\sum_i \Phi(i) \otimes \Lambda(i)\Lambda(i)^T`. Velocity and
    acceleration are sums of lagged angles (:mod:`tvsysid.numerics.differentiation`). The
    regressor, with a row for each sample of each realization, is never built.

    The bands are those of the posterior, which takes the noise as white, times a factor for its
    colour (:func:`tvsysid.numerics.noise.colour_factors`). For ``"irf"``, it is the factor of the
    parametric model. Noise and angle are taken as equally strong at all times. The bands do not
    count changes that the basis cannot follow. They take coefficients that ``"ard"`` prunes as 0.

    Viscosity and inertia of ``"irf"`` are those of a second-order fit to the impulse response,
    weighted by the angle's mean correlations. The diagnostics' ``second_order_agreement`` says
    how well that fit, or the parametric model, explains the torque linear in the angle.
    """

    max_lag: float = attrs.field(default=0.12, validator=positive)
    basis: Basis = attrs.field(factory=CubicBSplines, validator=A_BASIS)
    model: Structure = attrs.field(default="parametric", validator=one_of(Structure))
    prior: Prior = attrs.field(default="ard", validator=one_of(Prior))
    reference: str | None = None

    key = "birf"
    title = "Basis impulse response function"
    can_be_tuned = True
    assumptions = (
        "The movement is the same in all realizations.",
        "The joint's change over time is a sum of the basis functions chosen; faster changes are "
        "missed.",
        "For stiffness: the joint is of second order (inertia, viscosity, stiffness).",
    )
    differs = (
        "It changes as its basis functions can: what changes faster comes out slower, with ripples "
        "about a switch."
    )
    cites = ("guarin2017", "guarin2018", "vanderuit2021")

    def __attrs_post_init__(self) -> None:
        if self.reference is not None and self.model != "parametric":
            raise InputError("BasisIRF: with a reference, model must be 'parametric'")

    def _fit(self, ensemble: Ensemble, instrument: Ensemble) -> Model:
        rate = ensemble.sampling_rate
        signals, columns, posterior = self.regression(instrument)
        if self.reference is not None:
            missing = base.missing_edge(HALF_WIDTH, ensemble)
            at = slice(missing, ensemble.samples - missing)
            z, x = (each.derivatives()[:, :, at] for each in (instrument, ensemble))
            torque = ensemble.torque[:, ensemble.core][:, at]

            def residual(mean: Array) -> float:
                left = torque - np.einsum("ti,irt->rt", columns.weights(mean), x)
                return float(np.vdot(left, left))

            surplus = columns.gram(np.einsum("irt,jrt->tij", z, x - z))
            posterior = by_instruments(posterior, surplus, residual, torque.size)
        weights = columns.weights(posterior.mean)
        readout, impedance = np.eye(3), weights
        if self.model == "irf":  # a second-order fit, weighted by the angle's mean correlations
            derivative = derivative_filters(weights.shape[1] // 2, rate)
            projected = derivative @ signals.gram.mean(axis=0)
            _, inverse = second_order_fit((projected @ derivative.T)[None], np.zeros((1, 3)))
            readout = inverse[0] @ projected
            impedance = weights @ readout.T
            readout[0] = 1.0  # stiffness is the area under the response
        over_time = base.padded(impedance, (ensemble.samples - len(weights)) // 2)
        left, first = shared.second_order_residual(ensemble, over_time)
        details = {
            "noise_variance": posterior.noise_variance,
            "log_evidence": posterior.log_evidence,
            "second_order_agreement": shared.residual_agreement(instrument, left, first),
        }
        diagnostics = Diagnostics(posterior.effective, details=details)
        if self.model == "irf":
            left = shared.residual(ensemble, weights)
        errors = partial(self._errors, posterior, columns, readout, left, instrument)
        if self.model == "irf":
            return shared.impulse_response_model(ensemble, weights, impedance, diagnostics, errors)
        names = (
            f"{name} {j}"
            for name in ("stiffness", "viscosity")
            for j in range(columns.functions.shape[1] - 1)
        )
        return SecondOrderModel(
            sampling_rate=rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(over_time, errors),
            posterior=posterior,
            labels=(*names, "inertia"),
            diagnostics=diagnostics,
        )

    def regression(self, ensemble: Ensemble) -> tuple[Signals, Columns, FittedWeights]:
        """Return the moments of the signals, the columns of the basis, and the posterior."""
        signals = self._signals(ensemble)
        columns = self._columns(signals, self.basis, ensemble)
        return signals, columns, self._posterior(signals, columns, ensemble)

    def _signals(self, ensemble: Ensemble) -> Signals:
        """Return the moments of angle, velocity and acceleration, or of lagged angles."""
        is_irf, lags = self.model == "irf", HALF_WIDTH
        if is_irf:
            lags = base.fitting_lags("BasisIRF", self.max_lag, ensemble)
        base.check_window("BasisIRF: the derivatives of the angle", 2 * lags + 1, ensemble)
        first = max(0, ensemble.context - lags)
        reach = slice(first, ensemble.angle.shape[1] - first)
        angle, torque = ensemble.angle[:, reach], ensemble.torque[:, reach]
        gram, cross, square, _ = lagged_moments(angle, torque, lags)
        if not is_irf:
            filters = derivative_filters(lags, ensemble.sampling_rate)
            gram, cross = filters @ (gram @ filters.T), cross @ filters.T
        power = np.mean(np.diagonal(gram, axis1=1, axis2=2), axis=0)
        if is_irf:  # lags have one unit
            power[:] = power.mean()
        return Signals(gram, cross, square, np.sqrt(np.maximum(power, np.finfo(float).tiny)))

    def _columns(self, signals: Signals, basis: Basis, ensemble: Ensemble) -> Columns:
        """Return the columns of a basis. The inertia of the parametric model is constant."""
        functions = evaluate(basis, ensemble.samples)
        missing = (len(functions) - len(signals.square)) // 2
        functions = functions[missing : len(functions) - missing]
        chosen = np.ones((len(signals.rms), functions.shape[1]), dtype=bool)
        if self.model == "parametric":
            functions = np.column_stack([functions, np.ones(len(functions))])
            chosen = np.pad(chosen, ((0, 0), (0, 1)))
            chosen[2] = ~chosen[2]
        return Columns(functions, *np.nonzero(chosen))

    def _posterior(
        self, signals: Signals, columns: Columns, ensemble: Ensemble, share: float = 1.0
    ) -> FittedWeights:
        """Return the posterior if a ``share`` of the samples is independent.

        The prior is that of coefficients of signals scaled to unit RMS.
        """
        scale = 1 / signals.rms[columns.signal]
        units = np.outer(scale, scale)
        cross = np.sum(signals.cross[:, columns.signal] * columns.factors, axis=0) * scale
        gram = columns.gram(signals.gram) * units
        moments = Moments(gram, cross, float(signals.square.sum()), len(signals.square))
        found = PRIORS[self.prior](moments.times(len(ensemble) * share))
        return found._replace(mean=scale * found.mean, covariance=units * found.covariance)

    def _errors(
        self,
        posterior: FittedWeights,
        columns: Columns,
        readout: Array,
        left: Array,
        instrument: Ensemble,
    ) -> dict[str, StandardError]:
        """Return the standard errors from the posterior and the colour of the residual ``left``."""
        effective = posterior.effective
        filters = derivative_filters(HALF_WIDTH, instrument.sampling_rate)
        _, factors = shared.noise_colour(instrument, left, effective / left.size, filters)
        # The posterior counts all samples; where their mean was subtracted, there is less noise in
        # them.
        freedom = left.size * shared.independent_realizations(instrument) / len(left) - effective
        stronger = (left.size - effective) / max(freedom, 1.0)
        return shared.posterior_errors(
            columns.factors * readout[:, None, columns.signal],
            posterior.covariance,
            freedom,
            instrument.samples,
            stronger * factors,
        )

    def _open_loop_evidence(self, ensemble: Ensemble) -> Evidence:
        """Compare bases by their log evidence, less the number of precisions that were fitted.

        Each of these raises the evidence, even of a function that is not there.
        """
        if self.prior == "none" or self.model == "irf":
            raise InputError(
                "BasisIRF: a basis is chosen by the evidence of the parametric model; set model to "
                "'parametric', and prior to 'ard' or 'ridge'"
            )
        predicted = self.fit(ensemble).predict(ensemble)
        share = shared.independent_share(ensemble, predicted, (0.0, ensemble.sampling_rate / 2))
        signals, tried = self._signals(ensemble), [*dict.fromkeys((self.basis, *BASES))]
        functions, values = [], []
        for basis in tried:
            columns = self._columns(signals, basis, ensemble)
            count = columns.functions.shape[1] - 1
            evidence = self._posterior(signals, columns, ensemble, share).log_evidence
            functions.append(count)
            values.append(evidence - (2 * count if self.prior == "ard" else 1))
        best = int(np.argmax(values))
        return Evidence(
            criterion="log evidence less precisions fitted",
            tried=tuple({"basis": basis} for basis in tried),
            values=np.array(values),
            chosen=best if values[best] > values[0] + MIN_GAIN_NAT else 0,
            axis="functions",
            positions=np.array(functions),
            lines=tuple(map(_kind, tried)),
        )


def _kind(basis: Basis) -> str:
    """Return the name of a basis, without the number of its functions."""
    name = getattr(type(basis), "__name__", "basis")
    return f"periodic {name}" if isinstance(basis, CubicBSplines) and basis.periodic else name


class Signals(NamedTuple):
    """Means over realizations at each time: moments of signals, and those with the torque.

    ``gram`` (time, signal, signal), ``cross`` (time, signal), ``square`` (time,) of the torque, and
    the ``rms`` (signal,) of each signal over time.
    """

    gram: Array
    cross: Array
    square: Array
    rms: Array


class Columns(NamedTuple):
    """Columns of the regression: signals times functions of time (time, function).

    ``signal`` and ``function`` (column,) say which signal is multiplied by which function.
    """

    functions: Array
    signal: NDArray[np.int64]
    function: NDArray[np.int64]

    @property
    def factors(self) -> Array:
        """Return the function of time of each column, shape (time, column)."""
        return self.functions[:, self.function]

    def gram(self, products: Array) -> Array:
        """Return the Gram matrix from products of signals at each time (time, signal, signal)."""
        place = self.signal * self.functions.shape[1] + self.function
        return expanded(products, self.functions)[np.ix_(place, place)]

    def weights(self, coefficients: Array) -> Array:
        """Return the weight of each signal over time, shape (time, signal)."""
        return (self.factors * coefficients) @ np.eye(self.signal[-1] + 1)[self.signal]
