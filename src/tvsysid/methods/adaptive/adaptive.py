"""Adaptive smoothing with switches.

The method finds by evidence how smooth a joint's impedance is, and where it switches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import attrs
import numpy as np
from scipy.ndimage import convolve1d

from tvsysid.methods import base, shared
from tvsysid.methods.adaptive import tables
from tvsysid.methods.adaptive.averaging import (
    Averaged,
    Hypotheses,
    Outcome,
    averaged,
    averaged_beside,
)
from tvsysid.methods.adaptive.evidence import Line, inverse_of
from tvsysid.methods.adaptive.mixture import Mixture
from tvsysid.methods.adaptive.model import AdaptiveModel, MixtureError
from tvsysid.methods.adaptive.moments import (
    LOW_BAND,
    MIN_REALIZATIONS,
    SHORTEST,
    A,
    Constants,
    Derived,
    Normal,
    Signals,
    U,
    V,
    constants,
    floored,
    gram_of,
    normal,
    without_angle,
)
from tvsysid.methods.adaptive.noise import (
    EXACT,
    FLOOR,
    Misfit,
    alike,
    misfit,
    reach_of,
    residual_products,
    whitened,
)
from tvsysid.methods.adaptive.prior import DECIMATOR, USUAL_TAPS, Axis
from tvsysid.methods.adaptive.reflex import WithReflex, with_reflex
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.methods.cascade.result import contradicted, doubtful_gain, not_of_second_order
from tvsysid.models import Diagnostics, Model, StandardError
from tvsysid.signals import Array, Ensemble

LONGEST = 3000  # samples of a realization at most
ROUNDS = 2  # of stiffness beside a viscosity that changes
# variance of the scores of velocity, over that of noise, above which the noise is not whitened
MISFIT = 1.5
UNSEEN = 1e4  # standard error, in sizes, of what a signal that is still says


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
        if known < SHORTEST:
            return (
                f"it needs realizations of at least {SHORTEST} samples with derivatives, got "
                f"{max(known, 0)} "
                f"of {ensemble.samples} with {ensemble.context} of context; give longer ones, cut "
                "with more context"
            )
        if ensemble.samples > LONGEST:
            return (
                f"it needs realizations of at most {LONGEST} samples, got {ensemble.samples}; "
                "decimate them"
            )
        return None

    def fit(self, ensemble: Ensemble) -> AdaptiveModel:
        """Return the model of an ensemble."""
        return Identification(
            ensemble, with_reflex(ensemble, self.emg) or Derived.of(ensemble)
        ).model(repr(self))

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Fit with the hypotheses of a model: its reflex, smooth parts and numbers of switches.

        No other hypotheses are searched for.
        """
        if not isinstance(model, AdaptiveModel) or self.skip(ensemble):
            return self.identify(ensemble)
        reflex = None if model.beside is None else with_reflex(ensemble, self.emg, model.beside)
        found = Identification(ensemble, reflex or Derived.of(ensemble), model.hypotheses)
        return found.model(repr(self))


class Stiffness(NamedTuple):
    """Estimate of stiffness (time,), its uncertainty, and the constants beside it.

    All count in units of the scaled signals. ``known`` (time,) is the viscosity that was taken as
    known, 0 if it was one of the constants.
    """

    averaged: Averaged
    values: Array
    variance: Array
    constants: Constants
    misfit: Misfit
    normal: tuple[Normal, Normal]
    known: Array


class Identification:
    """An ensemble, reduced to its moments at each time.

    If ``known`` hypotheses are given, no others are searched for.
    """

    def __init__(
        self,
        ensemble: Ensemble,
        signals: Signals,
        known: Mapping[str, Hypotheses] = MappingProxyType({}),
    ) -> None:
        self.ensemble, self.signals = ensemble, signals
        self.gram = gram = gram_of(signals)
        self.independent = signals.realizations[1]
        self.coloured = True
        followed = 1 - len(ensemble.runs) / len(ensemble)
        periodic = followed >= 0.5 and not any(signals.edges)
        recorded = ensemble.recorded_angle
        taps = USUAL_TAPS if recorded is None else DECIMATOR / recorded.shape[-1]
        self.axis = Axis(len(self.gram), periodic, taps, realizations=signals.realizations[0])
        first = constants(
            without_angle(gram).sum(axis=0)[:-1],
            np.diag(gram.sum(axis=0))[1:-1],
            signals.holds,
            signals.positive,
        ).values
        seen = (gram[:, U, -1] - gram[:, U, 1:-1] @ first) / floored(gram[:, U, U])
        self.coefficients = np.vstack([seen, np.repeat(first[:, None], self.axis.times, axis=1)])
        alike = all(each.axis[:2] == self.axis[:2] for some in known.values() for each in some)
        self.known = known if alike else {}

    def stiffness(self, viscosity: Array, variance: Array) -> Stiffness:
        """Estimate stiffness beside a viscosity (time,) that is known with a variance.

        The viscosity is a constant to be estimated if both are 0.
        """
        times, rate, signals = self.axis.times, self.signals.rate, self.signals
        known = bool(variance.any())
        if known:
            self.coefficients[V] = 0.0
        found, about, loud = self._normal(viscosity)
        spread = inverse_of(found.angle)
        solved = spread @ found.right[U].T
        power, powers = (np.diag(each.steady) for each in (found, about))
        holds = signals.holds / loud
        holds[0] += known * UNSEEN**2 * power[0]
        steady = constants(found.steady - found.low @ solved, power, holds, signals.positive)
        stronger = np.sqrt(powers / np.maximum(power, np.finfo(float).tiny))
        steady = steady._replace(covariance=steady.covariance * np.outer(stronger, stronger))
        mixed = solved[:, :-1]
        seen = solved[:, -1] - mixed @ steady.values
        self.coefficients = np.vstack([seen, np.repeat(steady.values[:, None], times, axis=1)])
        every = self.coefficients.copy()
        every[V] += viscosity
        beyond = misfit(self.gram, every, self.independent)
        error = (spread if self.coloured else spread @ about.angle @ spread) * max(
            found.excess[U], 1.0
        )
        error += mixed @ steady.covariance @ mixed.T
        if known or beyond.viscosity or beyond.inertia:
            same, moved = alike(times, rate), spread @ found.mixed
            error += moved @ (beyond.viscosity * same + np.diag(variance)) @ moved.T
            error += beyond.inertia * same * np.outer(mixed[:, 1], mixed[:, 1])
        result = averaged(self._line(U, seen, error), self.known.get("stiffness", ()))
        mean, own = result.mixture.mean(), result.mixture.variance()
        return Stiffness(result, mean, own, steady, beyond, (found, about), viscosity)

    def _normal(self, viscosity: Array) -> tuple[Normal, Normal, float]:
        """Return two normal matrices and the mean variance of the noise.

        The first gives the estimates. The inverse of the first around the second, a sandwich, gives
        the covariance. Both are the same where the noise is whitened. It is not whitened where the
        scores of velocity show that the residual is misfit, not noise, which whitening would
        amplify.
        """
        signals, times = self.signals, self.axis.times
        noise = residual_products(signals, self.coefficients, viscosity) / max(
            self.independent - 1, 1
        )
        loud = float(np.mean(np.diag(noise))) + EXACT * float(self.gram[:, -1, -1].mean()) / len(
            self.ensemble
        )
        noise.flat[:: times + 1] += FLOOR * loud
        white = whitened(noise, self.independent, signals.rate, self.axis.periodic)

        def weighed(factor: Array) -> Normal:
            whole = low = factor.T @ factor
            # A reflex's differences take up what decimation does to the acceleration.
            if not isinstance(signals, WithReflex):
                slow = convolve1d(factor, LOW_BAND, mode="constant")
                low = slow.T @ slow
            return normal(signals, (whole, low), self.coefficients, viscosity)

        if self.coloured:
            found = weighed(white)
            self.coloured = found.excess[V] < MISFIT
            if self.coloured:
                return found, found, loud
        return (
            weighed(np.eye(times) / math.sqrt(loud)),
            weighed(np.asarray(np.linalg.inv(white).T / loud, dtype=np.float64)),
            loud,
        )

    def viscosity(self, beside: Stiffness) -> Averaged:
        """Estimate viscosity beside a stiffness."""
        (found, about), steady = beside.normal, beside.constants
        spread = inverse_of(found.velocity)
        solved, moved = spread @ found.right[V].T, spread @ found.mixed.T
        mixed = solved[:, A - V : -1]
        seen = beside.known + solved[:, -1] - moved @ beside.values - mixed @ steady.values[1:]
        error = (spread if self.coloured else spread @ about.velocity @ spread) * max(
            found.excess[V], 1.0
        )
        error += (moved * beside.variance) @ moved.T + mixed @ steady.covariance[1:, 1:] @ mixed.T
        if beside.misfit.inertia:
            error += (
                beside.misfit.inertia
                * alike(len(seen), self.signals.rate)
                * np.outer(mixed[:, 0], mixed[:, 0])
            )
        line = self._line(V, seen, error)
        return averaged_beside(line, beside.averaged, self.known.get("viscosity", ()))

    def _line(self, signal: int, seen: Array, error: Array) -> Line:
        """Return the estimate of a signal's coefficient at each time, with its error.

        Its size is the mean weighted by the signal's power, and never 0. Where the signal does not
        move, the error is very large, however small the noise.
        """
        own = self.gram[:, signal, signal]
        power = floored(own)
        total = float(np.sum(seen * power) / np.sum(power))
        least = 1e-6 * float(np.sqrt(np.mean(self.gram[:, -1, -1]) / np.mean(power)))
        size, still = max(abs(total), least), own < power
        return Line.of(
            self.axis,
            np.where(still, total, seen),
            error + np.diag(still * (UNSEEN * size) ** 2),
            size,
        )

    def model(self, name: str) -> AdaptiveModel:
        """Identify the model.

        The last round searches for no switches other than those of the round before.
        """
        stiffness = self.stiffness(*np.zeros((2, self.axis.times)))
        viscosity = self.viscosity(stiffness)
        for turn in range(ROUNDS):
            if viscosity.probability(Outcome.constant) > 0.5:
                break
            if turn and not self.known:
                self.known = {
                    "stiffness": stiffness.averaged.hypotheses(),
                    "viscosity": viscosity.hypotheses(),
                }
            stiffness = self.stiffness(viscosity.mixture.mean(), viscosity.mixture.variance())
            viscosity = self.viscosity(stiffness)
        return self._model(name, stiffness, viscosity)

    def _model(self, name: str, stiffness: Stiffness, viscosity: Averaged) -> AdaptiveModel:
        ensemble, edges = self.ensemble, self.signals.edges
        unit = self.signals.scale[1] / self.signals.scale[0]
        pooled = min(2 * reach_of(self.independent, self.signals.rate) + 1, self.axis.times)
        freedom, many = (
            max(1.0, (self.independent - 1) * each - 2) for each in (pooled, self.axis.times)
        )
        seen_viscosity, inertia = viscosity.mixture, stiffness.constants.values[1]
        variance = stiffness.constants.covariance[1, 1]
        reflex = self.signals if isinstance(self.signals, WithReflex) else None
        if reflex is not None:
            seen_viscosity = reflex.viscosity(seen_viscosity, stiffness.constants)
            inertia, variance = reflex.inertia(stiffness.constants)
        physical = seen_viscosity.above(0.0)
        sure = np.full(self.axis.times, math.sqrt(max(variance, 0.0)))
        errors = {
            "stiffness": _mixture_error(
                stiffness.averaged.mixture, stiffness.averaged.arc(), edges, unit, freedom
            ),
            "viscosity": _mixture_error(physical, viscosity.arc(), edges, unit, freedom),
            "inertia": StandardError(base.padded(sure * unit, *edges), np.array(many), 0.0),
        }
        values = stiffness.values, physical.mean(), np.full(self.axis.times, inertia)
        impedance = unit * np.stack(values, axis=1)
        over_time = base.padded(impedance, *edges).T
        estimates = shared.impedance_estimates(over_time[0], over_time[1], over_time[2], errors)
        details = {
            "constant_stiffness": stiffness.averaged.probability(Outcome.constant),
            "constant_viscosity": viscosity.probability(Outcome.constant),
            "periodic": float(self.axis.periodic),
            "reflex_shown": float(reflex is not None),
        }
        if reflex is None:
            details["second_order_agreement"] = self._agreement(impedance)
        else:
            estimates["reflex_gain"] = reflex.beside.estimates["reflex_gain"]
        both = {"stiffness": stiffness.averaged, "viscosity": viscosity}
        rate = ensemble.sampling_rate
        return AdaptiveModel(
            method=name,
            sampling_rate=rate,
            time=ensemble.time,
            estimates=estimates,
            switches=tuple(
                row for each in both.items() for row in tables.switches(*each, unit, edges[0], rate)
            ),
            smoothness=tuple(
                row for each in both.items() for row in tables.smoothness(*each, unit, rate)
            ),
            beside=None if reflex is None else reflex.beside,
            hypotheses={name: found.hypotheses() for name, found in both.items()},
            diagnostics=Diagnostics(
                tables.parameters(stiffness.averaged) + tables.parameters(viscosity) + 1,
                warnings=tuple(self._warnings(stiffness, seen_viscosity)),
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

    def _warnings(self, stiffness: Stiffness, viscosity: Mixture) -> Iterator[str]:
        """Yield warnings: open decisions in one, and contradictions of second order.

        The others say that the viscosity or the inertia is not that of a second-order joint.
        """
        open_ones = []
        if len(self.ensemble) < MIN_TESTED_REALIZATIONS:
            open_ones.append(
                f"whether there is a stretch reflex, which takes {MIN_TESTED_REALIZATIONS} "
                "realizations (got "
                f"{len(self.ensemble)}): the stiffness holds what it adds"
            )
        if not stiffness.constants.told:
            open_ones.append(
                "viscosity and inertia, which the angle does not tell from stiffness in these "
                "realizations"
            )
        if open_ones:
            yield f"these data leave open {'; and '.join(open_ones)}"
        if isinstance(self.signals, WithReflex):
            mean = float(np.mean(stiffness.values))
            yield from not_of_second_order(mean, self.signals.stiffness(mean, stiffness.constants))
            beside = self.signals.beside
            yield from doubtful_gain(
                beside.estimates["reflex_gain"], bool(beside.diagnostics.details["constant"])
            )
        below = np.minimum(viscosity.mean() + 1.96 * np.sqrt(viscosity.variance()), 0.0)
        yield from contradicted(
            np.sum(self.gram[:, V, V] * below**2) / np.sum(self.gram[:, -1, -1])
        )


def _mixture_error(
    mixture: Mixture, arc: float, edges: tuple[int, int], unit: float, freedom: float
) -> MixtureError:
    scaled = mixture._replace(means=mixture.means * unit, variances=mixture.variances * unit**2)
    spread = base.padded(np.sqrt(scaled.variance()), *edges)
    return MixtureError(spread, np.array(freedom), arc, mixture=scaled)
