"""Find by evidence how smooth a joint's impedance is, and where it switches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.methods import base, shared
from tvsysid.methods.adaptive.averaging import Hypothesis, Mixture, ModelAverage, average
from tvsysid.methods.adaptive.model import AdaptiveModel, MixtureError, switches_of
from tvsysid.methods.adaptive.regression import A, FreeRegression, Regressors, V
from tvsysid.methods.adaptive.search import CurveModel
from tvsysid.methods.cascade.cascade import JointCascade, limit_warnings
from tvsysid.methods.cascade.method import TwoPathwayMethod
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS, reflex_test_of
from tvsysid.methods.cascade.search import Selection, fit_again
from tvsysid.models import IMPEDANCE, Diagnostics, Estimate, Model, StandardError
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.whitening import pooling_reach
from tvsysid.signals import Ensemble

MIN_REALIZATIONS = 4
MIN_SAMPLES, MAX_SAMPLES = 16, 3000  # of a realization, without ends that lack derivatives
MAX_TURNS = 3  # estimates of stiffness, each followed by one of viscosity

Hypotheses = Mapping[str, Sequence[Hypothesis]]  # by quantity


@attrs.frozen
class AdaptiveRegression(base.Method):
    r"""Stiffness that changes smoothly, suddenly, or not at all: the data decide.

    The method has no settings to tune.

    .. math:: y(t) = k(t)\,\theta + b(t)\,\dot\theta + I\,\ddot\theta + e(t), \qquad
              k(t) = c + f(t) + \sum_j \Delta_j\, h_{s_j}(t)

    Stiffness is a constant c plus a smooth part f plus a few switches. A switch of the size
    :math:`\Delta_j` is a unit step h at :math:`s_j`, also between samples. The smooth part may be
    absent, a Gaussian process (squared-exponential, or Matérn 3/2 for corners) of some standard
    deviation and length, or a sum of few cosines and sines. All these models are averaged, weighted
    by their evidence, with any number, size and time of the switches.

    Parameters
    ----------
    emg
        Channel of EMG that drives the reflex instead of the velocity, as in
        :class:`tvsysid.JointCascade`.

    Notes
    -----
    Stiffness is first estimated at each time by itself. With W the inverse covariance (time, time)
    of the noise within a realization, this free estimate is the solution z of

    .. math:: \sum_s \left(W \circ \sum_r \theta_r \theta_r^T\right)_{ts} z(s) =
              \sum_r \theta_r(t)\, \bigl(W (y_r - b\,\dot\theta_r - I\,\ddot\theta_r)\bigr)(t)

    over realizations r. The inverse of the matrix on the left is the covariance of z. W is
    estimated from the residual of a first fit: an autoregressive model, whose order the Bayesian
    information criterion selects, and the variance of its prediction error over time. At least 1 %
    of the noise variance is assumed white. If the residual's products with velocity vary more than
    1.5 times as much as W predicts, the residual is misfit, not noise. Whitening would amplify it.
    White noise of 30 times the noise power is then added before W is computed. The covariance of z
    is then a sandwich estimator, scaled to explain the residual of the most probable smooth part.

    Viscosity and inertia come from the same regression, restricted to frequencies below 60 % of the
    Nyquist frequency. Above it, the aliased acceleration of a decimated angle would make the
    inertia 3 % too large. Where the residual is misfit, the covariance of z also includes the part
    of it that is the same in all realizations.

    All further steps use the free estimate and small matrices. With G the products of switches with
    each other, g those with the free estimate, both after the smooth part is regressed out, and
    :math:`\tau^2` the prior variance of the switches, the log evidence for the switches is

    .. math:: -\tfrac12 \log|1 + \tau^2 G| + \tfrac12\, g^T (G + \tau^{-2})^{-1} g

    A search finds sets of switches beside every plausible smooth part. Each switch is then located
    to 1/16 sample, and its other possible positions are averaged. If realizations follow each other
    in the record, stiffness is periodic: the end of a realization continues at its beginning. Steps
    are smeared by the low-pass filter of a decimation. If there are steps, two other models are
    tried: no low-pass filter, and realizations that switch at different times. The better of them
    is averaged with the usual filter, unless the data exclude it.

    Viscosity, reflex gain and their bands are limited to 0 or more. A warning says so if negative
    values would explain 1 % more of the torque. Stiffness is estimated beside the viscosity without
    this limit.

    The bands are quantiles of the mixture of all plausible models. Its components are Student's t,
    with the degrees of freedom of the noise estimate. Near a switch whose time is undecided, the
    estimate lies between the levels, which has the least mean square error, and the band spans
    both. Bands cover noise only; see :class:`tvsysid.Estimate`.

    Where held-out realizations show a stretch reflex, its columns are regressors too, as in
    :class:`tvsysid.JointCascade`. Stiffness is then estimated beside the viscosity of that method,
    and the model has ``reflex_gain`` and two pathways. All estimates except stiffness are those of
    :class:`tvsysid.JointCascade`.

    It is not the right method in closed loop, for movements that do not repeat, and for fewer
    than four realizations.

    The diagnostics' ``details`` hold the probabilities that stiffness and viscosity are constant or
    have a smooth part. ``periodic`` is 1 if stiffness was periodic, ``reflex_detected`` is 1 if the
    data show a reflex, and otherwise 0.

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
        "The movement is the same in all realizations, of which there are at least four.",
        "The joint is of second order (inertia, viscosity, stiffness); its inertia is constant.",
        "Stiffness and viscosity are smooth except for a few switches. How smooth is found from "
        "the data; birf is more exact where the right basis functions are known.",
        "Noise of the torque does not move the angle (no closed loop).",
    )
    differs = (
        "How fast stiffness changes is found from the data, and the band covers how uncertain that "
        "is; the torque of a reflex that is detected is not included in the stiffness."
    )

    inputs = TwoPathwayMethod.inputs

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return why the method skips an ensemble: its realizations are too few, short or long."""
        known = ensemble.samples - 2 * base.missing_edge(HALF_WIDTH, ensemble)
        if len(ensemble) < MIN_REALIZATIONS:
            return (
                f"it needs at least {MIN_REALIZATIONS} realizations, got {len(ensemble)}; kbr does "
                "with one"
            )
        if not MIN_SAMPLES <= known <= MAX_SAMPLES:
            return (
                f"it needs realizations of {MIN_SAMPLES} to {MAX_SAMPLES} samples with derivatives,"
                f" got {max(known, 0)} of {ensemble.samples} with {ensemble.context} of context; "
                "give longer ones, cut with more context, or decimate them"
            )
        return None

    def fit(self, ensemble: Ensemble) -> AdaptiveModel:
        """Return the model of an ensemble."""
        return self._fit_in_turn(ensemble, select_reflex(ensemble, self.emg), {})

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Fit with the hypotheses of a model: its reflex, smooth parts and numbers of switches.

        No other hypotheses are searched for.
        """
        if not isinstance(model, AdaptiveModel) or self.skip(ensemble):
            return self.identify(ensemble)
        selection = None
        if model.reflex is not None:
            selection = fit_again(ensemble, model.reflex.hyperparameters)
        return self._fit_in_turn(ensemble, selection, model.hypotheses)

    def _fit_in_turn(
        self, ensemble: Ensemble, selection: Selection | None, known: Hypotheses
    ) -> AdaptiveModel:
        """Return the model. If there are known hypotheses, no others are searched for.

        Stiffness is estimated beside a constant viscosity, then viscosity beside this stiffness.
        While viscosity probably changes, both are estimated again, each beside the other, in at
        most three turns. The third turn searches for no further hypotheses. With a reflex, only
        stiffness is estimated: the viscosity is that of the reflex's model.
        """
        signals = Regressors.of_second_order(ensemble)
        if selection is not None:
            signals = Regressors.with_reflex(ensemble, selection)
        free = FreeRegression(ensemble, signals)
        found = dict[str, ModelAverage]()
        for turn in range(1, MAX_TURNS + 1):
            if turn == MAX_TURNS:
                known = known or {quantity: each.hypotheses for quantity, each in found.items()}
            viscosity = found["viscosity"].mixture if found else None
            found["stiffness"] = average(free.stiffness(viscosity), known.get("stiffness", ()))
            if selection is not None:
                break
            free_viscosity = free.viscosity(found["stiffness"].mixture)
            found["viscosity"] = average(free_viscosity, known.get("viscosity", ()))
            if found["viscosity"].probability(CurveModel.is_constant) > 0.5:
                break
        return model_of(free, found)


def select_reflex(ensemble: Ensemble, emg: str | None) -> Selection | None:
    """Return the fit with a reflex if held-out realizations show one, else None.

    A channel of EMG may drive the reflex.
    """
    if len(ensemble) < MIN_TESTED_REALIZATIONS:
        return None
    try:
        if emg is None and not reflex_test_of(ensemble).shown:
            return None
        return JointCascade(emg=emg).select(ensemble)
    except InputError:  # realizations are too short
        return None


def model_of(free: FreeRegression, found: Mapping[str, ModelAverage]) -> AdaptiveModel:
    """Return the model with the posterior of stiffness, and of viscosity if there is no reflex."""
    ensemble = free.ensemble
    signals = free.signals
    times = free.axis.times
    rate = ensemble.sampling_rate
    reflex = signals.reflex
    # Degrees of freedom: the samples over which the noise variance is pooled, less two for
    # viscosity and inertia.
    pooled = min(2 * pooling_reach(signals.independent, rate) + 1, times)
    freedom = (signals.independent - 1.0) * pooled - 2
    estimates = {} if reflex is None else dict(reflex.estimates)
    details = {"periodic": float(free.axis.periodic), "reflex_detected": float(reflex is not None)}
    for quantity, posterior in found.items():
        weights, means, variances = posterior.mixture
        means = np.maximum(means, 0.0) if quantity == "viscosity" else means
        over_time = (base.padded(each, *signals.edges) for each in (means, variances))
        mixture = Mixture(weights, *over_time)
        error = MixtureError(np.sqrt(mixture.variance()), freedom, posterior.arc(), mixture=mixture)
        estimates[quantity] = Estimate(mixture.mean(), UNITS[quantity], error=error)
        details[f"constant_{quantity}"] = posterior.probability(CurveModel.is_constant)
        details[f"smooth_{quantity}"] = posterior.probability(CurveModel.is_smooth)
    if reflex is None:
        # The constants are the coefficients of the signals from V on.
        inertia = free.constants[A - V], np.sqrt(free.covariance[A - V, A - V])
        values, errors = base.padded(np.full((times, 2), inertia), *signals.edges).T
        total_freedom = (signals.independent - 1.0) * times - 2  # for a constant
        estimates["inertia"] = Estimate(
            values, UNITS["inertia"], error=StandardError(errors, total_freedom, arc=0.0)
        )
        impedance = np.stack([estimates[each].values for each in IMPEDANCE], axis=1)
        residual, first = shared.second_order_residual(ensemble, impedance)
        details["second_order_agreement"] = shared.residual_agreement(ensemble, residual, first)
    missing = signals.edges[0]
    return AdaptiveModel(
        sampling_rate=rate,
        time=ensemble.time,
        estimates=estimates,
        switches=tuple(
            switch
            for quantity, posterior in found.items()
            for switch in switches_of(quantity, posterior, missing, rate)
        ),
        reflex=reflex,
        hypotheses={quantity: each.hypotheses for quantity, each in found.items()},
        diagnostics=Diagnostics(
            sum(each.parameters() for each in found.values()) + 1,
            warnings=tuple(warnings_of(free, found)),
            details=details,
        ),
    )


def warnings_of(free: FreeRegression, found: Mapping[str, ModelAverage]) -> Iterator[str]:
    """Yield what the data do not determine, and what the fit does not explain."""
    undetermined = []
    if len(free.ensemble) < MIN_TESTED_REALIZATIONS:
        undetermined.append(
            f"whether there is a stretch reflex (the test needs {MIN_TESTED_REALIZATIONS} "
            f"realizations, got {len(free.ensemble)}; the stiffness includes any reflex)"
        )
    if not free.identifiable:
        undetermined.append(
            "viscosity and inertia (angle, velocity and acceleration are collinear)"
        )
    if undetermined:
        yield f"the data do not determine {', nor '.join(undetermined)}"
    if free.signals.reflex is not None:
        yield from free.signals.reflex.diagnostics.warnings
        return
    viscosity = found["viscosity"].mixture
    upper = viscosity.mean() + 1.96 * np.sqrt(viscosity.variance())
    negative = np.minimum(upper, 0.0)  # 0 where it is above 0
    yield from limit_warnings(
        float(np.sum(free.products[:, V, V] * negative**2) / np.sum(free.products[:, -1, -1]))
    )
