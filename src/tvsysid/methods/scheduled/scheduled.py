"""Methods for a joint whose properties follow a measured variable.

One estimates impulse responses, the other stiffness, viscosity and inertia.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial

import attrs
import numpy as np

from tvsysid.methods import base
from tvsysid.methods.cascade.columns import second_order_fit
from tvsysid.methods.cascade.pathways import DIRECTIONS, Stretch, history
from tvsysid.methods.scheduled.fit_warnings import (
    warnings_of_folds,
    warnings_of_orders,
    warnings_of_rest,
)
from tvsysid.methods.scheduled.model import GRID, ScheduledModel, curves_of
from tvsysid.methods.scheduled.regression import FOLDS, Fit, details_of, fit_best_orders
from tvsysid.methods.scheduled.terms import (
    Reflex,
    Schedule,
    Term,
    acceleration,
    angle_and_velocity,
    at_rest,
    lagged_angles,
)
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.models import IMPEDANCE, Diagnostics
from tvsysid.numerics.laguerre import laguerre_filters
from tvsysid.signals import Ensemble
from tvsysid.validators import at_least, boolean, not_negative, optional, positive, text

ORDERS = range(11)  # of the polynomials, that are tried
MAX_MISSING = 0.5  # share of the samples that may have no past


@attrs.frozen
class Scheduled(base.Method):
    """Settings and steps that both methods share; see :class:`ScheduledIRF`."""

    variable: str = attrs.field(default="scheduling", validator=text)
    order: int | None = attrs.field(default=None, validator=optional(at_least(0)))
    reflex: bool = attrs.field(default=True, validator=boolean)
    reflex_order: int | None = attrs.field(default=None, validator=optional(at_least(0)))
    rest_order: int = attrs.field(default=0, validator=at_least(0))
    delay: float = attrs.field(default=0.05, validator=not_negative)
    memory: float = attrs.field(default=0.76, validator=positive)
    filters: int = attrs.field(default=9, validator=at_least(1))
    time_constant: float = attrs.field(default=0.03, validator=positive)
    threshold: float = attrs.field(default=0.0, validator=not_negative)

    uses_recorded_angle = True

    @property
    def inputs(self) -> tuple[base.Input, ...]:  # type: ignore[override]
        """Return the input with the scheduling variable."""
        return (base.Input(self.variable, "scheduling", "any unit"),)

    @property
    def quantities(self) -> tuple[str, ...]:  # type: ignore[override]
        """Return the reflex gain, if there is a reflex."""
        return ("reflex_gain",) * self.reflex

    @property
    def scheduled_quantities(self) -> dict[str, int]:  # type: ignore[override]
        """Return all quantities over the scheduling variable."""
        return {f"scheduled_{name}": GRID for name in (*IMPEDANCE, *self.quantities)}

    @property
    def pathway_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Return the names of the pathways, if there are two."""
        return ("intrinsic", "reflex") if self.reflex else ()

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return why the method skips an ensemble: a constant variable, or too little history."""
        values = ensemble.signal(self.variable)[:, ensemble.core]
        if np.ptp(values) <= 1e-9 * np.abs(values).max():
            return (
                f"{self.variable} is {values.flat[0]:.4g} at all times; a joint can only follow "
                "what changes"
            )
        if not self.reflex:
            return None
        before = sum(base.whole_samples(each, ensemble) for each in (self.delay, self.memory))
        past = history(ensemble, ensemble.angle, before)[:, : ensemble.samples]
        if np.isnan(past).mean() > MAX_MISSING:
            return (
                f"less than half of the samples have {self.delay + self.memory:g} s recorded "
                "before them, as long as the reflex's response; cut with more context (--context), "
                "or shorten memory"
            )
        return None

    def fit(self, ensemble: Ensemble) -> ScheduledModel:
        """Return the model of an ensemble."""
        fits = self._fits(ensemble)
        fit = max(fits, key=lambda each: each.vaf)
        terms, schedule = fit.rows.terms, fit.rows.schedule
        # Columns of zeros have no coefficients: subtracting the mean removes a constant torque
        parameters = np.count_nonzero(fit.coefficients)
        independent = independent_realizations(ensemble) / len(ensemble)
        freedom = max(1.0, len(fit.rows.torque) * independent - parameters)
        curves = curves_of(fit, fit.covariance(ensemble.sampling_rate, freedom), freedom)
        variable = ensemble.signal(self.variable)[:, ensemble.core]
        grid = np.linspace(*schedule.limits, GRID)
        estimates = {}
        for name, curve in curves.items():
            estimates[name] = curve.at(variable, ("realization", "time"))
            estimates[f"scheduled_{name}"] = curve.at(grid, (self.variable,))
        details = details_of(fit)
        if not isinstance(terms[-1], Reflex):
            del details["vaf_reflex"], details["reflex_order"]
        else:
            details["direction"] = float(terms[-1].drive.direction)
            details["vaf_folds_other_direction"] = min(each.vaf for each in fits)
        texts = (
            *warnings_of_folds(fit.rows),
            *warnings_of_orders(self.variable, details, {order for order, _ in fit.tried}),
            *warnings_of_rest(fit, estimates["scheduled_stiffness"], grid, ensemble),
        )
        return ScheduledModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=estimates,
            coordinates={self.variable: grid},
            diagnostics=Diagnostics(float(parameters), warnings=texts, details=details),
            schedule=schedule,
            terms=terms,
            coefficients=fit.coefficients,
            curves=curves,
        )

    def _fits(self, ensemble: Ensemble) -> list[Fit]:
        """Return the fit of the best orders for each direction of stretch."""
        schedule = Schedule.of(ensemble, self.variable)
        rate, given = ensemble.sampling_rate, (self.order, self.reflex_order if self.reflex else 0)
        orders, reflex_orders = (ORDERS if each is None else (each,) for each in given)
        terms = Term("rest", at_rest, self.rest_order, {}), *self._intrinsic(ensemble, orders[-1])
        delay, memory = (base.whole_samples(each, ensemble) for each in (self.delay, self.memory))
        responses = laguerre_filters(self.filters, max(1, memory), self.time_constant * rate)
        reflexes = [
            Reflex(Stretch(self.threshold, each), delay, responses, reflex_orders[-1])
            for each in DIRECTIONS
        ]
        return [
            fit_best_orders((*terms, *each), schedule, ensemble, (orders, reflex_orders))
            for each in ([(reflex,) for reflex in reflexes] if self.reflex else [()])
        ]

    @abstractmethod
    def _intrinsic(self, ensemble: Ensemble, order: int) -> tuple[Term, ...]:
        """Return the terms of the intrinsic torque, with polynomials of an order."""

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        """Compare orders by their prediction of folds of consecutive time."""
        free = attrs.evolve(self, order=None, reflex_order=None)
        # The two are equal if no order is given
        fits = [
            max(each._fits(ensemble), key=lambda fit: fit.vaf)
            for each in dict.fromkeys((self, free))
        ]
        given, best = fits[0], fits[-1]
        tried = {given.orders: given.held_out} | best.tried
        reflex = "reflex of order {}" if self.reflex else ""
        return Evidence(
            criterion=f"variance accounted for in {FOLDS} folds of consecutive time",
            unit="%",
            better="higher",
            tried=tuple({"order": order, "reflex_order": reflexes} for order, reflexes in tried),
            values=np.mean(list(tried.values()), axis=1),
            chosen=list(tried).index(best.orders),
            axis="order",
            positions=np.array([float(order) for order, _ in tried]),
            lines=tuple(reflex.format(reflexes) for _, reflexes in tried),
        )


def _mean_angle(ensemble: Ensemble) -> float:
    return float(ensemble.angle[:, ensemble.core].mean())


@attrs.frozen
class ScheduledIRF(Scheduled):
    r"""Impulse response and reflex that follow a measured variable, such as a slow movement.

    .. math:: y(t) = \sum_{|k| \le n} \sum_{j=0}^{p} c_{kj} T_j(x(t))\, \theta(t - k)
              + \sum_{i} \sum_{j=0}^{q} g_{ij} \sum_{k \ge 0}
              \ell_i(k)\, T_j(x(t - k - d))\, f(t - k - d) + y_0

    with T the Chebyshev polynomials, x the variable mapped to -1 to 1, :math:`\ell` orthonormal
    Laguerre filters and f the velocity of stretch: rectified at the rate at which the angle was
    recorded, then decimated as the torque was. All coefficients are those of one least-squares fit.
    Neither a period nor more than one realization is needed.

    Parameters
    ----------
    variable
        Channel with the scheduling variable, in any unit.
    order
        Degree p of the polynomials. If None, the degree from 0 to 10 that predicts folds best;
        ``order`` in the diagnostics' details is the chosen one. Too low an order is biased, which
        no band covers. Too high an order fits the record, but fails at other values of the
        variable.
    reflex, reflex_order
        Whether there is a reflex pathway, and its degree q, chosen like p. Without the pathway,
        stiffness includes the torque of a reflex.
    rest_order
        Degree of the polynomial for the torque at rest, :math:`y_0`. This torque follows the
        variable for two reasons. The variable may cause a torque by itself. And the angle may not
        count from the joint's rest position, which adds stiffness times the difference. If the
        degree is at least ``order``, no offset of the angle matters. But then the reflex's mean
        torque does not help to estimate its gain. A warning says where that matters to stiffness.
    delay, memory
        Delay d of the reflex, and the duration of its response after the delay, in s.
    filters, time_constant
        Number of Laguerre filters, and the time in s over which they decay.
    threshold
        Velocity in rad/s above which stretch counts.
    max_lag
        Lags of the intrinsic response to either side in s.

    Notes
    -----
    ``model.estimates`` has stiffness, viscosity, inertia and reflex gain for each realization and
    time. ``scheduled_stiffness`` and so on are the same quantities over the variable.
    :meth:`ScheduledModel.at` returns them at any values of the variable. Stiffness is the sum of
    the weights. Viscosity and inertia are those of a second-order fit from 0.5 to 15 Hz. The reflex
    gain is the area under the reflex's response, in N·m·s/rad.

    The method chooses the direction of stretch that better predicts five folds of consecutive time,
    each from the others. ``vaf_folds`` in the diagnostics' details is the mean over the folds of
    the variance accounted for, in per cent of the torque's variance in each. A warning says which
    values of the variable occur in one fold only.

    The bands are those of least squares with noise of the residual's autocorrelation, up to 0.4 s.
    They are slightly narrow (docs/scheduling.md has the measured coverage). They do not cover the
    error of the polynomials.

    References
    ----------
    Sobhani Tehrani, Jalaleddini & Kearney 2013, Linear parameter varying identification of ankle
    joint intrinsic stiffness during imposed walking movements, IEEE EMBC; the two pathways in one:
    Sobhani Tehrani, Golkar, Guarin, Jalaleddini & Kearney 2015, Methods for the identification of
    time-varying hammerstein systems with applications to the study of dynamic joint stiffness,
    IFAC-PapersOnLine 48.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)

    key = "lpv"
    title = "Impulse response that follows a measured variable (LPV)"
    assumptions = (
        "The joint depends on the measured variable, and not otherwise on time.",
        "It does so as a polynomial.",
        "The intrinsic response ends before the reflex's delay does.",
    )
    differs = (
        "It follows the measured variable as a polynomial: what changes for another reason is "
        "averaged over."
    )
    cites = ("sobhani2013", "sobhani2015")

    def _intrinsic(self, ensemble: Ensemble, order: int) -> tuple[Term, ...]:
        lags = base.fitting_lags(type(self).__name__, self.max_lag, ensemble)
        fit = second_order_fit(np.arange(-lags, lags + 1) / ensemble.sampling_rate)
        weights = (np.ones(2 * lags + 1), *fit[1:])
        signals = partial(lagged_angles, centre=_mean_angle(ensemble), lags=lags)
        return (Term("intrinsic", signals, order, dict(zip(IMPEDANCE, weights, strict=True))),)


@attrs.frozen
class ScheduledImpedance(Scheduled):
    r"""Stiffness, viscosity and reflex that follow a measured variable; inertia is constant.

    .. math:: y(t) = \sum_{j=0}^{p} T_j(x(t)) \left[ K_j\, \theta(t) + B_j\, \dot\theta(t) \right]
              + I\, \ddot\theta(t) + r(t) + y_0

    with the reflex r, the settings, the folds and the bands of :class:`ScheduledIRF`, and the
    derivatives of :meth:`tvsysid.Ensemble.derivatives`. It has fewer coefficients, and is therefore
    more precise where the joint is of second order.
    """

    key = "lpvkbi"
    title = "Impedance that follows a measured variable"
    assumptions = (
        "The joint depends on the measured variable, and not otherwise on time.",
        "Stiffness, viscosity and reflex do so as polynomials; inertia is constant.",
        "The joint is of second order (inertia, viscosity, stiffness).",
    )
    differs = (
        "It follows the measured variable as a polynomial: what changes for another reason is "
        "averaged over."
    )
    cites = ("sobhani2013", "sobhani2015")

    def _intrinsic(self, ensemble: Ensemble, order: int) -> tuple[Term, ...]:
        signals = partial(angle_and_velocity, centre=_mean_angle(ensemble))
        weights = {"stiffness": np.array([1.0, 0.0]), "viscosity": np.array([0.0, 1.0])}
        inertia = Term("intrinsic", acceleration, 0, {"inertia": np.ones(1)})
        return Term("intrinsic", signals, order, weights), inertia
