"""Adaptive smoothing with switches.

The method finds by evidence how smooth a joint's impedance is, and where it switches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

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


Hypotheses = Mapping[str, Sequence[Hypothesis]]  # by quantity


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
        return self._identified(FreeEstimates(ensemble, Signals.of(ensemble, self.emg)), {})

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
        free, known = FreeEstimates(ensemble, signals), model.hypotheses
        axes = {each.axis[:2] for some in known.values() for each in some}
        return self._identified(free, known if axes == {free.axis[:2]} else {})

    def _identified(self, free: FreeEstimates, known: Hypotheses) -> AdaptiveModel:
        """Return the model. If there are known hypotheses, no others are searched for.

        Stiffness is estimated beside a constant viscosity. Where viscosity changes, each is
        estimated again beside the other, at last without a search.
        """
        found: dict[str, Posterior] = {}
        for turn in range(1 + MAX_ROUNDS):
            if turn == MAX_ROUNDS:
                known = known or {name: each.hypotheses for name, each in found.items()}
            beside = found["viscosity"].mixture if found else None
            stiffness = average(free.stiffness(beside), known.get("stiffness", ()))
            viscosity = average_beside(
                free.viscosity(stiffness.mixture), stiffness, known.get("viscosity", ())
            )
            found = {"stiffness": stiffness, "viscosity": viscosity}
            if viscosity.probability(Candidate.is_constant) > 0.5:
                break
        return free.model(repr(self), found)


class FreeEstimates:
    """Stiffness and viscosity of an ensemble, free at each time, and the constants beside them.

    ``coefficients`` (regressor, time) are the latest ones, which give the noise.
    """

    constants: Constants
    misfit: Array
    of_viscosity: FreeCoefficient

    def __init__(self, ensemble: Ensemble, signals: Signals) -> None:
        self.ensemble, self.signals, self.whitens = ensemble, signals, True
        self.products = products_at_times(signals.columns)
        realizations, times = signals.columns.shape[1:]
        recorded = ensemble.recorded_angle
        self.axis = Axis(
            times,
            periodic=2 * len(ensemble.runs) <= len(ensemble) and not any(signals.edges),
            taps=USUAL_TAPS if recorded is None else DECIMATOR_REACH / recorded.shape[-1],
            realizations=realizations,
        )
        products, power = without_angle(self.products), np.einsum("tii->i", self.products)
        prior = signals.prior_precision, signals.positive
        self.constants = fit_constants(products.sum(axis=0)[:-1], power[1:-1], *prior)
        mixed = self.products[:, U, 1:] @ np.append(-self.constants.values, 1.0)
        self._update(mixed / floored(self.products[:, U, U]))

    def _update(self, stiffness: Array) -> None:
        constants = np.repeat(self.constants.values[:, None], self.axis.times, axis=1)
        self.coefficients = np.vstack([stiffness, constants])

    def stiffness(self, viscosity: Mixture | None) -> FreeEstimate:
        """Estimate stiffness beside a viscosity, which is a constant if it is None."""
        signals = self.signals
        known, variance = np.zeros((2, self.axis.times))
        if viscosity is not None:
            self.coefficients[V] = known = viscosity.mean()
            variance = viscosity.variance()
        weighted, sandwich, noise = self._weighted()
        free = FreeCoefficient.of(U, weighted, sandwich)
        self.of_viscosity = FreeCoefficient.of(V, weighted, sandwich)
        power, true_power = (np.diag(each.constants) for each in (weighted, sandwich))
        precision = signals.prior_precision / noise
        precision[0] += (viscosity is not None) * UNKNOWN**2 * power[0]
        products = weighted.constants - weighted.low[U] @ free.solved
        products[:, -1] -= weighted.low[V] @ known + weighted.low[U] @ free.moved(known)
        found = fit_constants(products, power, precision, signals.positive)
        stronger = np.sqrt(true_power / np.maximum(power, np.finfo(float).tiny))
        covariance = found.covariance * np.outer(stronger, stronger)
        self.constants = found._replace(covariance=covariance)
        values = free.values(found.values, known)
        self._update(values)
        self.coefficients[V] += known
        self.misfit = misfit_variances(self.products, self.coefficients, signals.independent)
        alike = misfit_correlation(self.axis.times, self.ensemble.sampling_rate)
        changes = self.misfit[0] * alike + np.diag(variance)
        return self._estimate(U, values, free.error(covariance, changes, self.misfit[1] * alike))

    def viscosity(self, stiffness: Mixture) -> FreeEstimate:
        """Estimate viscosity beside the stiffness that was estimated last."""
        constants = self.constants
        alike = misfit_correlation(self.axis.times, self.ensemble.sampling_rate)
        values = self.of_viscosity.values(constants.values[1:], stiffness.mean())
        error = self.of_viscosity.error(
            constants.covariance[1:, 1:], np.diag(stiffness.variance()), self.misfit[1] * alike
        )
        return self._estimate(V, values, error)

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

    def model(self, name: str, found: Mapping[str, Posterior]) -> AdaptiveModel:
        """Return the model with these posteriors, in its units."""
        ensemble, signals, rate = self.ensemble, self.signals, self.ensemble.sampling_rate
        edges, times, unit = signals.edges, self.axis.times, signals.scale[1] / signals.scale[0]
        # what the constants add to the read-out stiffness, viscosity and inertia
        weights = np.zeros((3, len(self.constants.values)))
        weights[:, : signals.readout.shape[1] - 1] = signals.readout[:, 1:]
        weights[V, 0] = 0.0
        added = weights @ self.constants.values
        variances = np.einsum("ic,cd,id->i", weights, self.constants.covariance, weights)
        viscosity = found["viscosity"].mixture.transformed(
            signals.readout[V, V], added[V], variances[V]
        )
        mixtures = found["stiffness"].mixture, viscosity.above_zero()
        freedom, total_freedom = (
            np.array(max(1.0, (signals.independent - 1) * min(each, times) - 2))
            for each in (2 * pooling_reach(signals.independent, rate) + 1, times)
        )

        def over_time(values: Array | float) -> Array:
            return base.padded(np.broadcast_to(unit * values, times), *edges)

        errors: dict[str, StandardError] = {
            quantity: MixtureError(
                over_time(np.sqrt(mixture.variance())),
                freedom,
                posterior.arc(),
                mixture=mixture.transformed(unit),
            )
            for (quantity, posterior), mixture in zip(found.items(), mixtures, strict=True)
        }
        inertia_error = over_time(math.sqrt(max(variances[A], 0.0)))
        errors["inertia"] = StandardError(inertia_error, total_freedom, 0.0)
        impedance = [over_time(each) for each in (mixtures[0].mean(), mixtures[1].mean(), added[A])]
        estimates = shared.impedance_estimates(impedance[0], impedance[1], impedance[2], errors)
        details = {
            f"constant_{quantity}": posterior.probability(Candidate.is_constant)
            for quantity, posterior in found.items()
        }
        details["periodic"] = float(self.axis.periodic)
        details["reflex_shown"] = float(signals.reflex is not None)
        if signals.reflex is None:
            details["second_order_agreement"] = shared.second_order_agreement(
                ensemble, ensemble, np.stack(impedance, axis=1)
            )
        else:
            estimates["reflex_gain"] = signals.reflex.estimates["reflex_gain"]
        mean = float(mixtures[0].mean().mean())
        fitted = float(signals.readout[U, U] * mean + added[U])
        below = np.minimum(viscosity.mean() + 1.96 * np.sqrt(viscosity.variance()), 0.0)
        lost = np.sum(self.products[:, V, V] * below**2) / np.sum(self.products[:, -1, -1])
        return AdaptiveModel(
            method=name,
            sampling_rate=rate,
            time=ensemble.time,
            estimates=estimates,
            switches=tuple(
                row for each in found.items() for row in switches_of(*each, unit, edges[0], rate)
            ),
            smoothness=tuple(
                row for each in found.items() for row in smoothness_of(*each, unit, rate)
            ),
            beside=signals.reflex,
            hypotheses={quantity: each.hypotheses for quantity, each in found.items()},
            diagnostics=Diagnostics(
                sum(each.parameters() for each in found.values()) + 1,
                warnings=(*self._warnings(mean, fitted), *contradicted(lost)),
                details=details,
            ),
        )

    def _warnings(self, mean: float, fitted: float) -> Iterator[str]:
        """Yield what the data do not determine, and what a second-order joint does not explain."""
        undetermined = []
        if len(self.ensemble) < MIN_TESTED_REALIZATIONS:
            undetermined.append(
                f"whether there is a stretch reflex, which takes {MIN_TESTED_REALIZATIONS} "
                f"realizations (got {len(self.ensemble)}): the stiffness holds what it adds"
            )
        if not self.constants.identifiable:
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
