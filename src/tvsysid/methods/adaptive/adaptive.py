"""Adaptive smoothing with switches.

The method finds by evidence how smooth a joint's impedance is, and where it switches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.methods import base, shared
from tvsysid.methods.adaptive.evidence import FreeEstimate, inverse_of
from tvsysid.methods.adaptive.model import AdaptiveModel, MixtureError, smoothness_of, switches_of
from tvsysid.methods.adaptive.posterior import (
    Candidate,
    Hypothesis,
    Mixture,
    Posterior,
    average,
    average_beside,
)
from tvsysid.methods.adaptive.prior import DECIMATOR_REACH, USUAL_TAPS, Axis
from tvsysid.methods.adaptive.regression import (
    MIN_REALIZATIONS,
    MIN_SAMPLES,
    A,
    Constants,
    FreeCoefficient,
    Signals,
    U,
    V,
    Weighted,
    fit_constants,
    floored,
    misfit_correlation,
    misfit_variances,
    pooling_reach,
    products_at_times,
    whitening_filters,
    without_angle,
)
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.methods.cascade.result import contradicted, doubtful_gain, not_of_second_order
from tvsysid.models import Diagnostics, Model, StandardError
from tvsysid.signals import Array, Ensemble

MAX_SAMPLES = 3000  # of a realization
MAX_ROUNDS = 2  # of stiffness beside a viscosity that changes
WHITE_SHARE = 0.01  # of the noise's variance that is white at least: the rest may be misfit
MIN_NOISE = 1e-8  # share of the torque's power that is taken as noise
MAX_EXCESS = 1.5  # of the variance of the products with velocity up to which noise is whitened
UNKNOWN = 1e4  # standard error, in sizes, of the coefficient of a signal that is still


@attrs.frozen
class AdaptiveRegression(base.Method):
    r"""Stiffness that changes smoothly, suddenly, or not at all: the data decide.

    The method has no settings to tune.

    .. math:: y(t) = k(t)\,\theta + b(t)\,\dot\theta + I\,\ddot\theta + e(t), \qquad
              k(t) = c + f(t) + \sum_j \Delta_j\, h_{s_j}(t)

    with c a constant, f none, a Gaussian process of some standard deviation and length
    (squared-exponential, or Matérn 3/2 for corners) or a sum of few cosines and sines, and a few
    switches :math:`\Delta_j` at times :math:`s_j`, also between samples. All models are averaged by
    their evidence: with and without a smooth part, with any roughness, and with any number, size
    and time of the switches.

    Parameters
    ----------
    emg
        Channel that drives the reflex in the velocity's place, as in :class:`tvsysid.JointCascade`.

    Notes
    -----
    Stiffness is first estimated freely at every time, which leaves a problem of one dimension. With
    W the inverse covariance (time, time) of the noise within a realization, this estimate is the
    solution z of

    .. math:: \sum_s \left(W \circ \sum_r \theta_r \theta_r^T\right)_{ts} z(s) =
              \sum_r \theta_r(t)\, \bigl(W (y_r - b\,\dot\theta_r - I\,\ddot\theta_r)\bigr)(t)

    over realizations r. The inverse of the matrix on the left is the covariance of z. W comes from
    the residual of a first fit: a prediction from the samples before, of the most probable order,
    and the strength of the prediction error over time. At least 1 % of the noise is taken as white.
    Where the residual's scores with velocity are more than 1.5 times as strong as W predicts, the
    residual is misfit, not noise, and whitening would amplify it. W is then the identity, and the
    covariance a sandwich.

    Viscosity and inertia come from the same regression, weighted below 60 % of the Nyquist
    frequency. Decimation folds acceleration back, which would make an inertia of the whole band 3 %
    too large. The error also includes the misfit of second order that all realizations share.

    All further steps use small matrices. With A and b the products of switches beside the smooth
    part, and :math:`\tau^2` the variance of the switches, the log evidence for the switches is

    .. math:: -\tfrac12 \log|1 + \tau^2 A| + \tfrac12\, b^T (A + \tau^{-2})^{-1} b

    A search finds sets of switches beside every plausible smooth part. Each switch is then placed
    to 1/16 sample, and its other possible positions are averaged. Where realizations follow each
    other in the record, the end of one is taken as the beginning of the next. Steps are modelled as
    decimation smears them. Where there are steps, two more models are tried, and averaged if the
    data do not decide: no low-pass, and realizations that switch at different times.

    Neither viscosity nor reflex gain is negative at any time, nor are their bands. A warning says
    so where this costs 1 % of the torque. Stiffness is estimated beside the free viscosity.

    The bands are quantiles of the mixture of all plausible models, with Student's t of the
    scatter's degrees of freedom. Near a switch whose time is undecided, the estimate lies between
    the levels, which has the least mean square error, and the band spans both. Bands cover noise
    only; see :class:`tvsysid.Estimate`.

    Where held-out realizations show a stretch reflex, its columns stand beside stiffness, as in
    :class:`tvsysid.JointCascade`. The model then has ``reflex_gain`` and two pathways.

    It is not the right method in closed loop, for behaviour that does not repeat, and for fewer
    than four realizations.

    The diagnostics' ``details`` hold the probabilities that stiffness and viscosity are constant,
    and whether the realization was taken as ``periodic`` and a reflex is shown, 1 or 0.

    References
    ----------
    Evidence of adding a column in closed form: Tipping & Faul 2003. Positions of single effects,
    one at a time given the others: Wang, Sarkar, Carbonetto & Stephens 2020, J. R. Statist. Soc. B
    82, 1273-1300. The method is our own.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.methods.parse("adaptive")
    AdaptiveRegression(emg=None)
    """

    emg: str | None = None

    key = "adaptive"
    title = "Adaptive smoothing with switches"
    assumptions = (
        "Behaviour is the same in all realizations, of which there are at least four.",
        "The joint is of second order (inertia, viscosity, stiffness); its inertia is constant.",
        "Stiffness and viscosity are smooth but for a few switches; how smooth is found from the "
        "data. Where the "
        "functions of time that stiffness is a sum of are known, birf with these is more exact.",
        "Noise of the torque does not move the angle (no closed loop).",
    )
    sometimes = ("reflex_gain, and the torque of each pathway, where a reflex is shown",)
    differs = (
        "How fast stiffness changes is found from the data, and the band counts how unsure that "
        "is; where a "
        "reflex is shown, its torque is no stiffness."
    )

    @property
    def inputs(self) -> tuple[base.Input, ...]:  # type: ignore[override]
        """Return the EMG input, if its channel is named."""
        return () if self.emg is None else (base.Input(self.emg, "input", "V"),)

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return why the method skips an ensemble: its realizations are too few, short or long."""
        known = ensemble.samples - 2 * base.missing_edge(shared.HALF_WIDTH, ensemble)
        if len(ensemble) < MIN_REALIZATIONS:
            return (
                f"it needs at least {MIN_REALIZATIONS} realizations, got {len(ensemble)}; kbr "
                "does with one"
            )
        if known < MIN_SAMPLES:
            return (
                f"it needs realizations of at least {MIN_SAMPLES} samples with derivatives, got "
                f"{max(known, 0)} of {ensemble.samples} with {ensemble.context} of context; give "
                "longer ones, cut with more context"
            )
        if ensemble.samples > MAX_SAMPLES:
            return (
                f"it needs realizations of at most {MAX_SAMPLES} samples, got {ensemble.samples}; "
                "decimate them"
            )
        return None

    def fit(self, ensemble: Ensemble) -> AdaptiveModel:
        """Return the model of an ensemble."""
        return Identification(ensemble, Signals.of(ensemble, self.emg)).model(repr(self))

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Fit with the hypotheses of a model: its reflex, smooth parts and numbers of switches.

        No other hypotheses are searched for.
        """
        if not isinstance(model, AdaptiveModel) or self.skip(ensemble):
            return self.identify(ensemble)
        if model.beside is None:
            signals = Signals.of_second_order(ensemble)
        else:
            signals = Signals.of(ensemble, self.emg, model.beside)
        found = Identification(ensemble, signals)
        known = [each.axis[:2] for some in model.hypotheses.values() for each in some]
        if all(axis == found.axis[:2] for axis in known):
            found.known.update(model.hypotheses)
        return found.model(repr(self))


class Stiffness(NamedTuple):
    """Posterior of stiffness, the constants beside it, and the products that they come from."""

    posterior: Posterior
    constants: Constants
    misfit: Array
    weighted: Weighted
    sandwich: Weighted


class Identification:
    """Identification of an ensemble.

    ``coefficients`` (regressor, time) are the latest ones. If there are ``known`` hypotheses of a
    quantity, no others are searched for.
    """

    def __init__(self, ensemble: Ensemble, signals: Signals) -> None:
        self.ensemble, self.signals = ensemble, signals
        self.known: dict[str, Sequence[Hypothesis]] = {}
        self.whitens = True
        self.products = products_at_times(signals.columns)
        realizations, times = signals.columns.shape[1:]
        recorded = ensemble.recorded_angle
        self.axis = Axis(
            times,
            periodic=2 * len(ensemble.runs) <= len(ensemble) and not any(signals.edges),
            taps=USUAL_TAPS if recorded is None else DECIMATOR_REACH / recorded.shape[-1],
            realizations=realizations,
        )
        constants = fit_constants(
            without_angle(self.products).sum(axis=0)[:-1],
            np.einsum("tii->i", self.products)[1:-1],
            signals.prior_precision,
            signals.positive,
        ).values
        free = self.products[:, U, -1] - self.products[:, U, 1:-1] @ constants
        self._update(free / floored(self.products[:, U, U]), constants)

    def _update(self, stiffness: Array, constants: Array) -> None:
        over_time = np.repeat(constants[:, None], self.axis.times, axis=1)
        self.coefficients = np.vstack([stiffness, over_time])

    def model(self, name: str) -> AdaptiveModel:
        """Identify the model.

        The last round searches for no switches other than those of the round before.
        """
        stiffness = self.stiffness()
        viscosity = self.viscosity(stiffness)
        for turn in range(MAX_ROUNDS):
            if viscosity.probability(Candidate.is_constant) > 0.5:
                break
            if turn and not self.known:
                self.known["stiffness"] = stiffness.posterior.hypotheses
                self.known["viscosity"] = viscosity.hypotheses
            stiffness = self.stiffness(viscosity.mixture)
            viscosity = self.viscosity(stiffness)
        return self._model(name, stiffness, viscosity)

    def stiffness(self, viscosity: Mixture | None = None) -> Stiffness:
        """Estimate stiffness beside a viscosity, which is a constant if it is None."""
        signals, rate = self.signals, self.ensemble.sampling_rate
        over_time, variance = np.zeros((2, self.axis.times))
        if viscosity is not None:
            over_time, variance = viscosity.mean(), viscosity.variance()
            self.coefficients[V] = over_time
        weighted, sandwich, noise = self._weighted()
        free = FreeCoefficient.of(U, weighted, sandwich)
        power, true_power = (np.diag(each.constants) for each in (weighted, sandwich))
        precision = signals.prior_precision / noise
        if viscosity is not None:
            precision[0] += UNKNOWN**2 * power[0]
        products = weighted.constants - weighted.low[U] @ free.solved
        products[:, -1] -= (weighted.low[V] - weighted.low[U] @ free.moved) @ over_time
        constants = fit_constants(products, power, precision, signals.positive)
        stronger = np.sqrt(true_power / np.maximum(power, np.finfo(float).tiny))
        covariance = constants.covariance * np.outer(stronger, stronger)
        values = free.values(constants.values, over_time)
        self._update(values, constants.values)
        self.coefficients[V] += over_time
        misfit = misfit_variances(self.products, self.coefficients, signals.independent)
        changes = misfit[0] * misfit_correlation(self.axis.times, rate) + np.diag(variance)
        error = free.error(covariance, changes, misfit[1], rate)
        posterior = average(self._estimate(U, values, error), self.known.get("stiffness", ()))
        constants = constants._replace(covariance=covariance)
        return Stiffness(posterior, constants, misfit, weighted, sandwich)

    def viscosity(self, beside: Stiffness) -> Posterior:
        """Estimate viscosity beside a stiffness."""
        free = FreeCoefficient.of(V, beside.weighted, beside.sandwich)
        stiffness, constants = beside.posterior.mixture, beside.constants
        error = free.error(
            constants.covariance[1:, 1:],
            np.diag(stiffness.variance()),
            beside.misfit[1],
            self.ensemble.sampling_rate,
        )
        estimate = self._estimate(V, free.values(constants.values[1:], stiffness.mean()), error)
        return average_beside(estimate, beside.posterior, self.known.get("viscosity", ()))

    def _weighted(self) -> tuple[Weighted, Weighted, float]:
        """Return products that give the estimates and products that give their covariance.

        The third is the mean variance of the noise. The inverse of the first products around the
        second, a sandwich, gives the covariance. Both are the same where the noise is whitened. It
        is not whitened where the residual's products with velocity show that it is misfit, not
        noise, which whitening would amplify.
        """
        signals, times = self.signals, self.axis.times
        residual = signals.residual(self.coefficients)
        covariance = residual.T @ residual / max(signals.independent - 1, 1)
        torque_power = float(self.products[:, -1, -1].mean()) / len(self.ensemble)
        noise = float(np.mean(np.diag(covariance))) + MIN_NOISE * torque_power
        covariance.flat[:: times + 1] += WHITE_SHARE * noise
        filters = whitening_filters(
            covariance, signals.independent, self.ensemble.sampling_rate, self.axis.periodic
        )
        if self.whitens:
            weighted = Weighted.by(signals, filters, residual)
            self.whitens = weighted.excess[V] < MAX_EXCESS
            if self.whitens:
                return weighted, weighted, noise
        white = Weighted.by(signals, np.eye(times) / math.sqrt(noise), residual)
        colouring = np.asarray(np.linalg.inv(filters).T / noise, dtype=np.float64)
        return white, Weighted.by(signals, colouring, residual), noise

    def _estimate(self, signal: int, values: Array, error: Array) -> FreeEstimate:
        """Return the free estimate of a signal's coefficient, with its error.

        Its size is the mean weighted by the signal's power, and never 0. Where the signal does not
        move, the error is very large, however small the noise.
        """
        own = self.products[:, signal, signal]
        power = floored(own)
        mean = float(np.sum(values * power) / np.sum(power))
        least = 1e-6 * float(np.sqrt(np.mean(self.products[:, -1, -1]) / np.mean(power)))
        size, still = max(abs(mean), least), own < power
        precision = inverse_of(error + np.diag(still * (UNKNOWN * size) ** 2)) * size**2
        return FreeEstimate(self.axis, np.where(still, mean, values) / size, precision, size)

    def _model(self, name: str, stiffness: Stiffness, viscosity: Posterior) -> AdaptiveModel:
        ensemble, signals, rate = self.ensemble, self.signals, self.ensemble.sampling_rate
        edges, times, scale = signals.edges, self.axis.times, signals.scale
        unit, both = scale[1] / scale[0], {"stiffness": stiffness.posterior, "viscosity": viscosity}
        # what the constants add to the read-out stiffness, viscosity and inertia
        weights = np.zeros((3, len(stiffness.constants.values)))
        weights[:, : signals.readout.shape[1] - 1] = signals.readout[:, 1:]
        weights[V, 0] = 0.0
        added = weights @ stiffness.constants.values
        variances = np.einsum("ic,cd,id->i", weights, stiffness.constants.covariance, weights)
        free_viscosity = viscosity.mixture.transformed(
            signals.readout[V, V], added[V], variances[V]
        )
        mixtures = {
            "stiffness": stiffness.posterior.mixture,
            "viscosity": free_viscosity._replace(means=np.maximum(free_viscosity.means, 0.0)),
        }
        pooled = min(2 * pooling_reach(signals.independent, rate) + 1, times)
        freedom, total_freedom = (
            np.array(max(1.0, (signals.independent - 1) * each - 2)) for each in (pooled, times)
        )
        inertia_error = np.full(times, unit * math.sqrt(max(variances[A], 0.0)))
        errors: dict[str, StandardError] = {
            "inertia": StandardError(base.padded(inertia_error, *edges), total_freedom, 0.0)
        }
        for quantity, mixture in mixtures.items():
            scaled = mixture.transformed(unit)
            spread = base.padded(np.sqrt(scaled.variance()), *edges)
            errors[quantity] = MixtureError(spread, freedom, both[quantity].arc(), mixture=scaled)
        means = *(each.mean() for each in mixtures.values()), np.full(times, added[A])
        impedance = unit * np.stack(means, axis=1)
        over_time = base.padded(impedance, *edges).T
        estimates = shared.impedance_estimates(over_time[0], over_time[1], over_time[2], errors)
        details = {
            f"constant_{key}": each.probability(Candidate.is_constant) for key, each in both.items()
        }
        details["periodic"] = float(self.axis.periodic)
        details["reflex_shown"] = float(signals.reflex is not None)
        if signals.reflex is None:
            details["second_order_agreement"] = self._agreement(impedance)
        else:
            estimates["reflex_gain"] = signals.reflex.estimates["reflex_gain"]
        below = np.minimum(free_viscosity.mean() + 1.96 * np.sqrt(free_viscosity.variance()), 0.0)
        lost = np.sum(self.products[:, V, V] * below**2) / np.sum(self.products[:, -1, -1])
        mean = float(np.mean(means[U]))
        fitted = float(signals.readout[U, U] * mean + added[U])
        warnings = *self._warnings(stiffness, mean, fitted), *contradicted(lost)
        return AdaptiveModel(
            method=name,
            sampling_rate=rate,
            time=ensemble.time,
            estimates=estimates,
            switches=tuple(
                row for each in both.items() for row in switches_of(*each, unit, edges[0], rate)
            ),
            smoothness=tuple(
                row for each in both.items() for row in smoothness_of(*each, unit, rate)
            ),
            beside=signals.reflex,
            hypotheses={key: each.hypotheses for key, each in both.items()},
            diagnostics=Diagnostics(
                sum(each.parameters() for each in both.values()) + 1,
                warnings=warnings,
                details=details,
            ),
        )

    def _agreement(self, impedance: Array) -> float:
        """Return the share of the angle-dependent torque that the model explains, in per cent."""
        ensemble = self.ensemble
        first = max(0, ensemble.context - shared.HALF_WIDTH)
        angle, torque = (
            x[:, first : x.shape[1] - first] for x in (ensemble.angle, ensemble.torque)
        )
        products = shared.colour_products(ensemble)
        moments = shared.derivative_moments(products, angle, torque, ensemble.sampling_rate)
        return moments.second_order_agreement(impedance, len(ensemble))

    def _warnings(self, stiffness: Stiffness, mean: float, fitted: float) -> Iterator[str]:
        """Yield what the data do not determine, and what a second-order joint does not explain."""
        undetermined = []
        if len(self.ensemble) < MIN_TESTED_REALIZATIONS:
            undetermined.append(
                f"whether there is a stretch reflex, which takes {MIN_TESTED_REALIZATIONS} "
                f"realizations (got {len(self.ensemble)}): the stiffness holds what it adds"
            )
        if not stiffness.constants.identifiable:
            undetermined.append(
                "viscosity and inertia, which the angle does not tell from stiffness in these "
                "realizations"
            )
        if undetermined:
            yield f"these data leave open {'; and '.join(undetermined)}"
        if self.signals.reflex is not None:
            yield from not_of_second_order(mean, fitted)
            gain = self.signals.reflex.estimates["reflex_gain"]
            is_steady = bool(self.signals.reflex.diagnostics.details["constant"])
            yield from doubtful_gain(gain, is_steady)
