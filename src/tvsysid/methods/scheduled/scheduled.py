"""Methods for a joint whose properties follow a measured variable.

One estimates impulse responses, the other stiffness, viscosity and inertia.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import product
from operator import itemgetter

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import convolution_matrix

from tvsysid.methods import base
from tvsysid.methods.pathways import PATHWAYS, Stretch, history
from tvsysid.methods.scheduled.model import (
    REFLEXES,
    Curves,
    Orders,
    Part,
    Parts,
    ScheduledModel,
)
from tvsysid.methods.scheduled.regression import Regression, explained
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.models import IMPEDANCE, Diagnostics
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.laguerre import laguerre_filters
from tvsysid.numerics.second_order import response_readout
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least, boolean, not_negative, optional, positive, text

MAX_ORDER = 10  # of the polynomials that are tried
TIME_CONSTANT_S = 0.03  # over which the Laguerre filters decay
BLOCK = 32  # samples that are filtered at once
MIN_GAIN = 0.1  # points of VAF by which a free torque at rest must predict folds better

Signals = Mapping[str, tuple[Array, Mapping[str, Array]]]


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

    @property
    def inputs(self) -> tuple[base.Input, ...]:  # type: ignore[override]
        """Return the input with the scheduling variable."""
        return (base.Input(self.variable, "scheduling", "any unit"),)

    @property
    def quantities(self) -> tuple[str, ...]:  # type: ignore[override]
        """Return all quantities over the scheduling variable, and the reflex gain over time."""
        gain = ("reflex_gain",) * self.reflex
        return (*gain, *(f"scheduled_{name}" for name in (*IMPEDANCE, *gain)))

    @property
    def pathway_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Return the names of the pathways, if there are two."""
        return PATHWAYS if self.reflex else ()

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
            for each in (self.order, self.reflex_order if self.reflex else -1)
        )
        values, angle = self._values(ensemble), ensemble.angle[:, ensemble.core]
        limits, centre = (float(values.min()), float(values.max())), float(angle.mean())
        parts = partial(self._parts, limits, centre)
        rest, reflex = max(self.rest_order, orders[-1], reflex_orders[-1]), reflex_orders[-1]
        every = Orders(rest, orders[-1], reflex, reflex)
        # Folds are consecutive in time
        ordered = ensemble.select(np.concatenate(ensemble.runs))
        every_part = parts(every, ordered)
        highest = Regression.of(every_part, ordered)
        fits = []
        for name in list(REFLEXES)[: 1 + self.reflex]:
            tried = [
                Orders(self.rest_order, p)._replace(**{name: q})
                for p, q in product(orders, reflex_orders)
            ]
            fits.append(highest.best_orders(tried, name))
        best, vaf_folds = max(fits, key=itemgetter(1))
        fit = highest.subset(best)
        total, coefficients = fit.total, fit.posterior.mean
        # Columns of zeros have no coefficients: subtracting the mean removes a constant torque
        parameters = np.count_nonzero(coefficients)
        independent = independent_realizations(ensemble) / len(ensemble)
        freedom = max(1.0, total[-1, -1] * independent - parameters)
        covariance = fit.covariance(ensemble.sampling_rate, freedom)
        polynomials = {}
        for part, (_, quantities) in every_part.items():
            if getattr(best, part) < 0:
                continue
            for name, weights in quantities.items():
                readout = fit.readout(part, weights)
                polynomials[name] = readout @ coefficients, readout @ covariance @ readout.T
        curves = Curves(limits, polynomials, freedom)
        estimates = curves.at(values, ("realization", "time"))
        scheduled = curves.at(curves.grid, (self.variable,))
        details = {
            "vaf": float(explained(total, coefficients[None])[0]),
            "vaf_folds": vaf_folds,
            "order": float(best.intrinsic),
        }
        if self.reflex:
            details["reflex_order"] = float(max(best.positive, best.negative))
            details["direction"] = 1.0 if best.positive >= 0 else -1.0
        free = best._replace(rest=max(best))
        gain = highest.held_out(free, "rest")[-1].mean() - vaf_folds
        return ScheduledModel(
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=estimates | {f"scheduled_{name}": each for name, each in scheduled.items()},
            coordinates={self.variable: curves.grid},
            diagnostics=Diagnostics(
                float(parameters),
                warnings=tuple(self._warnings(best, free, gain)),
                details=details,
            ),
            parts=partial(parts, best),
            coefficients=coefficients,
            curves=curves,
        )

    def _warnings(self, best: Orders, free: Orders, gain: float) -> Iterator[str]:
        """Yield warnings of orders that are too low, for the joint or for its torque at rest.

        The VAF of folds rises by ``gain`` with the orders that leave the torque at rest free.
        """
        if self.order is None and best.intrinsic >= MAX_ORDER - 1:
            yield (
                f"the orders tried end at {MAX_ORDER}, and {best.intrinsic} predicts best: the "
                f"joint may change faster with {self.variable} than polynomials follow, and the "
                "bands do not count that"
            )
        if gain > MIN_GAIN:
            yield (
                f"the VAF of folds rises by {gain:.1f} points if the torque at rest follows "
                f"{self.variable} as well, which may change stiffness: use rest_order={free.rest}, "
                "unless you know that the torque at rest is constant"
            )

    def _values(self, ensemble: Ensemble) -> Array:
        return ensemble.signal(self.variable)[:, ensemble.core]

    def _parts(
        self,
        limits: tuple[float, float],
        centre: float,
        orders: Orders,
        ensemble: Ensemble,
    ) -> Parts:
        """Return the regressors of each part of the torque: signals times polynomials.

        They lose their mean over realizations where the ensemble has lost its own.
        """
        delay, memory = (base.whole_samples(each, ensemble) for each in (self.delay, self.memory))
        before = delay + memory - 1
        past = history(ensemble, ensemble.signal(self.variable), before)
        # With the degree first, as the regression takes them
        polynomials = np.moveaxis(chebyshev_of(past, limits, max(orders) + 1), -1, 0).copy()
        own_times = polynomials[..., before:]
        signals = {"rest": (np.ones((1, 1, 1)), {}), **self._intrinsic(ensemble, centre)}
        parts = {
            name: Part(
                np.multiply(own[:, None], own_times[: getattr(orders, name) + 1], order="C"),
                weights,
            )
            for name, (own, weights) in signals.items()
        }
        decay = TIME_CONSTANT_S * ensemble.sampling_rate
        responses = laguerre_filters(self.filters, memory, decay)
        for name, direction in REFLEXES.items():
            order = getattr(orders, name)
            if order >= 0:
                velocity = history(ensemble, Stretch(direction=direction)(ensemble), before)
                drives = polynomials[: order + 1] * velocity
                reflex = filtered(drives, responses, delay, ensemble)
                parts[name] = Part(reflex, {"reflex_gain": responses.sum(axis=1)})
        if ensemble.mean_subtracted:
            for columns, _ in parts.values():
                columns[:] -= np.expand_dims(mean_known(columns, 2), 2)
        return parts

    @abstractmethod
    def _intrinsic(self, ensemble: Ensemble, centre: float) -> Signals:
        """Return the signals of each part of the intrinsic torque, of the angle less its centre.

        Beside them are the weights (signal,) of each quantity.
        """


def filtered(drives: Array, responses: Array, delay: int, ensemble: Ensemble) -> Array:
    """Return drives behind a delay in samples and filters, (filter, drive, realization, time).

    The ``drives`` have shape (drive, realization, history + time), the ``responses`` (filter, lag).
    """
    count, earlier = len(drives), responses.shape[1] - 1
    # A block of samples and those before, times this, is a filter's output in the block.
    matrices = convolution_matrix(responses[:, ::-1], BLOCK)
    out = np.empty((len(responses), count, len(ensemble), ensemble.samples))
    for run in ensemble.runs:
        before, own = np.split(drives[:, run], [delay + earlier], axis=2)
        size = own[0].size
        line = np.append(before[:, 0], own.reshape(count, -1), axis=1)[:, : earlier + size]
        missing = np.isnan(line[0]).sum()  # from the beginning on
        line = np.pad(line, ((0, 0), (0, -size % BLOCK)))
        line[:, :missing] = 0.0
        blocks = sliding_window_view(line, earlier + BLOCK, axis=1)[:, ::BLOCK]
        blocks = blocks.reshape(-1, earlier + BLOCK)
        for filter_output, matrix in zip(out, matrices, strict=True):
            output = (blocks @ matrix).reshape(count, -1)[:, :size]
            output[:, :missing] = np.nan
            filter_output[:, run] = output.reshape(count, len(run), -1)
    return out


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
        Degree p of the polynomials. If None, the lowest from 0 to 10 that predicts folds about as
        well as the best; ``order`` in the diagnostics' details is the chosen one. Too low an order
        is biased, which no band covers. Too high an order fits the record, but fails at other
        values of the variable.
    reflex, reflex_order
        Whether there is a reflex pathway, and its degree q, chosen like p. Without the pathway,
        stiffness includes the torque of a reflex.
    rest_order
        Degree of the polynomial for the torque at rest, :math:`y_0`. This torque follows the
        variable for two reasons. The variable may cause a torque by itself. And the angle may not
        count from the joint's rest position, which adds stiffness times the difference. If the
        degree is at least ``order``, no offset of the angle matters. But then the reflex's mean
        torque does not help to estimate its gain. A warning says where a free torque at rest
        predicts folds better.
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
    the variance accounted for, in per cent of the torque's variance in each.

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

    def _intrinsic(self, ensemble: Ensemble, centre: float) -> Signals:
        lags = base.fitting_lags(type(self).__name__, self.max_lag, ensemble)
        angle = np.pad(ensemble.angle - centre, ((0, 0), (lags, lags)), constant_values=np.nan)
        windows = sliding_window_view(angle, ensemble.samples, axis=1)[:, ensemble.context :]
        fit = response_readout(np.arange(-lags, lags + 1) / ensemble.sampling_rate)
        weights = np.ones(2 * lags + 1), *fit[1:]
        signals = windows[:, 2 * lags :: -1].swapaxes(0, 1)
        return {"intrinsic": (signals, dict(zip(IMPEDANCE, weights, strict=True)))}


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

    def _intrinsic(self, ensemble: Ensemble, centre: float) -> Signals:
        signals = ensemble.derivatives()
        signals[0] -= centre
        return {
            "intrinsic": (signals[:2], dict(zip(IMPEDANCE[:2], np.eye(2), strict=True))),
            "inertia": (signals[2:], {"inertia": np.ones(1)}),
        }
