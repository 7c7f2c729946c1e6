"""Methods for a joint whose properties follow a measured variable.

One estimates impulse responses, the other stiffness, viscosity and inertia.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from functools import partial
from operator import itemgetter

import attrs
import numpy as np

from tvsysid.methods import base
from tvsysid.methods.cascade.columns import second_order_fit
from tvsysid.methods.cascade.pathways import DIRECTIONS
from tvsysid.methods.scheduled.model import (
    GRID,
    Design,
    ScheduledModel,
    Term,
    derivatives,
    filtered_stretch,
    lagged_angles,
    rest,
)
from tvsysid.methods.scheduled.regression import FOLDS, Orders, Regression, held_out
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.models import IMPEDANCE, Diagnostics, Estimate
from tvsysid.numerics.laguerre import laguerre_filters
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least, boolean, not_negative, optional, positive, text

MAX_ORDER = 10  # of the polynomials that are tried
TIME_CONSTANT_S = 0.03  # over which the Laguerre filters decay
MIN_BEYOND = 0.05  # distance of a fold's values from those of the others, relative to the range
TIED_VAF = 0.5  # points by which a free torque at rest may predict worse and still be as good


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

    differs = (
        "It follows the measured variable as a polynomial: what changes for another reason is "
        "averaged over."
    )
    cites = ("sobhani2013", "sobhani2015")
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
        """Return a reason to skip an ensemble in which the variable is constant."""
        values = self._values(ensemble)
        if np.ptp(values) > 1e-9 * np.abs(values).max():
            return None
        return (
            f"{self.variable} is {values.flat[0]:.4g} at all times; a joint can only follow what "
            "changes"
        )

    def fit(self, ensemble: Ensemble) -> ScheduledModel:
        """Return the model of an ensemble."""
        orders, reflex_orders = (
            range(MAX_ORDER + 1) if each is None else (each,)
            for each in (self.order, self.reflex_order if self.reflex else 0)
        )
        fits = []
        for direction in DIRECTIONS[: 1 + self.reflex]:
            highest = self._regression(ensemble, (orders[-1], reflex_orders[-1]), direction)
            best = highest.best_orders(orders, reflex_orders)
            fit = self._regression(ensemble, best, direction)
            fits.append((held_out(fit.moments).mean(), best, direction, fit))
        vaf_folds, best, direction, fit = max(fits, key=itemgetter(0))
        # Columns of zeros have no coefficients: subtracting the mean removes a constant torque
        parameters = np.count_nonzero(fit.coefficients)
        independent = independent_realizations(ensemble) / len(ensemble)
        freedom = max(1.0, float(fit.values[-1].sum()) * independent - parameters)
        curves = fit.curves(fit.covariance(ensemble.sampling_rate, freedom), freedom)
        grid = np.linspace(*fit.design.limits, GRID)
        estimates = {}
        for name, curve in curves.items():
            estimates[name] = curve.at(self._values(ensemble), ("realization", "time"))
            estimates[f"scheduled_{name}"] = curve.at(grid, (self.variable,))
        details = {
            "vaf": fit.vaf("rest", "intrinsic", "reflex"),
            "vaf_intrinsic": fit.vaf("intrinsic"),
            "vaf_folds": float(vaf_folds),
            "order": float(best[0]),
        }
        if self.reflex:
            details |= {"vaf_reflex": fit.vaf("reflex"), "reflex_order": float(best[1])}
            details["direction"] = float(direction)
        warnings = [*self._warnings_of_folds(ensemble)]
        if self.order is None and best[0] >= MAX_ORDER - 1:
            warnings.append(
                f"the orders tried end at {MAX_ORDER}, and {best[0]} predicts best: the joint may "
                f"change faster with {self.variable} than polynomials follow, and the bands do not "
                "count that"
            )
        if self.rest_order < max(best):
            free = attrs.evolve(self, rest_order=max(best))._regression(ensemble, best, direction)
            warnings += warnings_of_rest(fit, free, max(best), estimates["scheduled_stiffness"])
        return ScheduledModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=estimates,
            coordinates={self.variable: grid},
            diagnostics=Diagnostics(float(parameters), warnings=tuple(warnings), details=details),
            design=fit.design,
            coefficients=fit.coefficients,
            curves=curves,
        )

    def _values(self, ensemble: Ensemble) -> Array:
        return ensemble.signal(self.variable)[:, ensemble.core]

    def _regression(self, ensemble: Ensemble, orders: Orders, direction: int) -> Regression:
        """Return the regression with these orders and this direction of stretch."""
        terms = [Term("rest", self.rest_order, rest, {}), *self._intrinsic(ensemble, orders[0])]
        if self.reflex:
            delay, memory = (
                base.whole_samples(each, ensemble) for each in (self.delay, self.memory)
            )
            decay = TIME_CONSTANT_S * ensemble.sampling_rate
            responses = laguerre_filters(self.filters, memory, decay)
            regressors = partial(filtered_stretch, direction, delay, responses)
            quantities = {"reflex_gain": responses.sum(axis=1)}
            terms.append(Term("reflex", orders[1], regressors, quantities))
        values = self._values(ensemble)
        limits = float(values.min()), float(values.max())
        design = Design(self.variable, limits, tuple(terms))
        return Regression.of(design, ensemble)

    def _warnings_of_folds(self, ensemble: Ensemble) -> Iterator[str]:
        """Yield a warning if one fold alone has some values of the variable."""
        values = self._values(ensemble)[np.concatenate(ensemble.runs)]
        folds = np.array_split(values.ravel(), FOLDS)
        for side, sign in (("below", 1), ("above", -1)):
            extremes = np.array([np.min(sign * fold) for fold in folds])
            alone, following = np.argsort(extremes)[:2]
            if extremes[following] - extremes[alone] > MIN_BEYOND * np.ptp(values):
                yield (
                    f"{self.variable} is {side} {sign * extremes[following]:.3g} in part "
                    f"{alone + 1} of {FOLDS} of the record only: nothing else says how the joint "
                    "is there"
                )

    @abstractmethod
    def _intrinsic(self, ensemble: Ensemble, order: int) -> tuple[Term, ...]:
        """Return the terms of the intrinsic torque, with polynomials of an order."""


def mean_angle(ensemble: Ensemble) -> float:
    """Return the mean angle in rad, without context."""
    return float(ensemble.angle[:, ensemble.core].mean())


def warnings_of_rest(
    fit: Regression, free: Regression, order: int, stiffness: Estimate
) -> Iterator[str]:
    """Yield a warning if ``stiffness`` over the variable is another with a free torque at rest.

    In the regression ``free`` that torque is a polynomial of this ``order``.
    """
    name, grid = fit.design.variable, np.linspace(*fit.design.limits, GRID)
    change = free.curves(free.inverse())["stiffness"].at(grid, (name,)).values - stiffness.values
    _, upper = stiffness.limits()
    beyond = np.abs(change) / (upper - stiffness.values)
    place = int(np.argmax(beyond))
    vaf, free_vaf = held_out(fit.moments).mean(), held_out(free.moments).mean()
    if beyond[place] > 1 and free_vaf > vaf - TIED_VAF:
        yield (
            f"at {name} {grid[place]:.3g}, stiffness would be {abs(change[place]):.1f} N·m/rad "
            f"{'higher' if change[place] > 0 else 'lower'}, outside its 95 % band, if the torque "
            f"at rest followed the variable, which predicts folds as well ({free_vaf:.1f} against "
            f"{vaf:.1f} %): use rest_order={order}, unless you know that the torque at rest is "
            "constant"
        )


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
    filters
        Number of Laguerre filters. They decay over 0.03 s.
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

    def _intrinsic(self, ensemble: Ensemble, order: int) -> tuple[Term, ...]:
        lags = base.fitting_lags(type(self).__name__, self.max_lag, ensemble)
        fit = second_order_fit(np.arange(-lags, lags + 1) / ensemble.sampling_rate)
        weights = (np.ones(2 * lags + 1), *fit[1:])
        regressors = partial(lagged_angles, mean_angle(ensemble), lags)
        return (Term("intrinsic", order, regressors, dict(zip(IMPEDANCE, weights, strict=True))),)


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

    def _intrinsic(self, ensemble: Ensemble, order: int) -> tuple[Term, ...]:
        regressors = partial(derivatives, mean_angle(ensemble))
        weights = dict(zip(IMPEDANCE, np.eye(2), strict=False))
        inertia = partial(regressors, slice(2, 3))
        return (
            Term("intrinsic", order, partial(regressors, slice(2)), weights),
            Term("intrinsic", 0, inertia, {"inertia": np.ones(1)}),
        )
