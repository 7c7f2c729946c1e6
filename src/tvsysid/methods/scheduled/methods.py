"""Methods for a joint whose properties follow a measured variable.

One estimates impulse responses, the other stiffness, viscosity and inertia.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import attrs
import numpy as np

from tvsysid.methods import base
from tvsysid.methods.cascade.pathways import Stretch, history
from tvsysid.methods.scheduled.doubts import fit_warnings, rest_warnings
from tvsysid.methods.scheduled.fit import FOLDS, Fit, covariance_of, fitted
from tvsysid.methods.scheduled.model import GRID, Curves, ScheduledModel
from tvsysid.methods.scheduled.structure import Reflex, Structure
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.models import IMPEDANCE, Diagnostics
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least, boolean, not_negative, optional, positive, text

ORDERS = range(11)  # of the polynomials, that are tried
MISSING = 0.5  # share of the samples that may have no past


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
        before = base.whole_samples(self.delay, ensemble) + base.whole_samples(
            self.memory, ensemble
        )
        if (
            self.reflex
            and np.isnan(history(ensemble, ensemble.angle, before)[:, : ensemble.samples]).mean()
            > MISSING
        ):
            return (
                f"less than half of the samples have {self.delay + self.memory:g} s recorded "
                "before them, as long as the reflex's response; cut with more context (--context), "
                "or shorten memory"
            )
        return None

    def fit(self, ensemble: Ensemble) -> ScheduledModel:
        """Return the model of an ensemble."""
        fit, shares = self._fit(ensemble)
        rate = ensemble.sampling_rate
        # Subtracting the mean over realizations also removes a part of the noise.
        freedom = (
            len(fit.rows.torque) * independent_realizations(ensemble) / len(ensemble)
            - fit.parameters
        )
        covariance = covariance_of(fit, rate, max(freedom, 1.0))
        curves = Curves.of(fit.structure, fit.coefficients, covariance, rate, max(freedom, 1.0))
        grid = np.linspace(*fit.structure.limits, GRID)
        over_time = curves.at(
            ensemble.signal(self.variable)[:, ensemble.core], ("realization", "time")
        )
        over_variable = {
            f"scheduled_{name}": each for name, each in curves.at(grid, (self.variable,)).items()
        }
        details = _details(fit, shares)
        texts = (
            *fit_warnings(fit, details),
            *rest_warnings(fit, ensemble, grid, over_variable["scheduled_stiffness"]),
        )
        return ScheduledModel(
            method=repr(self),
            sampling_rate=rate,
            time=ensemble.time,
            estimates=over_time | over_variable,
            coordinates={self.variable: grid},
            diagnostics=Diagnostics(fit.parameters, warnings=texts, details=details),
            structure=fit.structure,
            curves=curves,
            coefficients=fit.coefficients,
        )

    def _fit(self, ensemble: Ensemble) -> tuple[Fit, dict[int, float]]:
        """Fit with the best orders and direction of stretch; return each direction's share, too."""
        structure = self._structure(ensemble)
        orders = [
            ORDERS if each is None else (each,)
            for each in (self.order, self.reflex_order if self.reflex else 0)
        ]
        fits = {
            direction: fitted(structure.stretched(direction), ensemble, *orders)
            for direction in ((1, -1) if self.reflex else (1,))
        }
        shares = {direction: float(fit.held_out.mean()) for direction, fit in fits.items()}
        return fits[max(shares, key=shares.__getitem__)], shares

    def _structure(self, ensemble: Ensemble) -> Structure:
        values, angle = (
            ensemble.signal(name)[:, ensemble.core] for name in (self.variable, "angle")
        )
        reflex = None
        if self.reflex:
            delay, memory = (
                base.whole_samples(each, ensemble) for each in (self.delay, self.memory)
            )
            decay = self.time_constant * ensemble.sampling_rate
            drive = Stretch(self.threshold)
            degrees = 1 + (ORDERS[-1] if self.reflex_order is None else self.reflex_order)
            reflex = Reflex(delay, max(1, memory), self.filters, decay, degrees, drive)
        limits = float(values.min()), float(values.max())
        degrees = 1 + (ORDERS[-1] if self.order is None else self.order)
        sizes = self._lags(ensemble), degrees, self.rest_order + 1
        return Structure(self.variable, limits, float(angle.mean()), *sizes, reflex)

    @abstractmethod
    def _lags(self, ensemble: Ensemble) -> int:
        """Return the lags of the intrinsic response to either side, in samples.

        0 stands for angle, velocity and acceleration.
        """

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        return evidence_by_folds(self, ensemble)


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

    def _lags(self, ensemble: Ensemble) -> int:
        return base.fitting_lags(type(self).__name__, self.max_lag, ensemble)


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

    def _lags(self, ensemble: Ensemble) -> int:
        return 0


def evidence_by_folds(method: Scheduled, ensemble: Ensemble) -> Evidence:
    """Compare the orders of the polynomials by their prediction of folds of consecutive time."""
    # The two are equal if no order is given
    every = dict.fromkeys((method, attrs.evolve(method, order=None, reflex_order=None)))
    fits = [each._fit(ensemble)[0] for each in every]
    given, best = fits[0].structure.orders, fits[-1].structure.orders
    tried = {given: fits[0].held_out} | fits[-1].tried
    folds = np.array(list(tried.values()))
    return Evidence(
        criterion=f"variance accounted for in {FOLDS} folds of consecutive time",
        unit="%",
        better="higher",
        tried=tuple(
            {"order": order, "reflex_order": reflex_order} for order, reflex_order in tried
        ),
        values=folds.mean(axis=1),
        chosen=list(tried).index(best),
        axis="order",
        positions=np.array([order for order, _ in tried], dtype=np.float64),
        lines=tuple(f"reflex of order {reflex_order}" for _, reflex_order in tried)
        if method.reflex
        else ("",) * len(tried),
    )


def _details(fit: Fit, shares: Mapping[int, float]) -> dict[str, float]:
    rows = fit.rows
    ends = np.cumsum(rows.parts)[:-1]
    pairs = zip(np.split(fit.coefficients, ends), np.split(rows.columns, ends), strict=True)
    torques = [weights @ columns for weights, columns in pairs]
    names = ("intrinsic", "reflex")[: len(torques) - 1]
    details = {"vaf": _explained(rows.torque, fit.coefficients @ rows.columns)}
    details |= {
        f"vaf_{name}": _explained(rows.torque, torque)
        for name, torque in zip(names, torques[1:], strict=True)
    }
    details |= {
        "vaf_folds": float(fit.held_out.mean()),
        "vaf_worst_fold": float(fit.held_out.min()),
    }
    details |= dict(zip(("scheduling_low", "scheduling_high"), fit.structure.limits, strict=True))
    order, reflex_order = map(float, fit.structure.orders)
    details |= {"order": order}
    if fit.structure.reflex is not None:
        direction = fit.structure.reflex.drive.direction
        details |= {
            "reflex_order": reflex_order,
            "direction": float(direction),
            "vaf_folds_other_direction": shares[-direction],
        }
    return details


def _explained(torque: Array, part: Array) -> float:
    return 100 * (1 - float(np.var(torque - part) / np.var(torque)))
