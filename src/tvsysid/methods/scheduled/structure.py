"""Regressors of a scheduled joint's torque: signals times polynomials in the variable."""

from __future__ import annotations

import attrs
import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.methods.cascade.columns import second_order_fit
from tvsysid.methods.cascade.pathways import Stretch, history
from tvsysid.models import IMPEDANCE
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.laguerre import laguerre_filters
from tvsysid.signals import Array, Ensemble


@attrs.frozen
class Reflex:
    """Reflex pathway, without its weights.

    It has ``filters`` of the stretch after a ``delay``, with a ``memory`` and a ``time_constant``,
    all times in samples. Each filter's weight is a polynomial with ``degrees`` coefficients, in the
    variable at the time of the stretch.
    """

    delay: int
    memory: int
    filters: int
    time_constant: float
    degrees: int
    drive: Stretch

    @property
    def responses(self) -> Array:
        """Return the impulse responses of the filters, shape (filter, lag)."""
        return laguerre_filters(self.filters, self.memory, self.time_constant)

    def columns(self, ensemble: Ensemble, polynomials: Array) -> Array:
        """Return the regressors of the reflex, shape (filter * degree, realization, time).

        They are NaN where the memory was not recorded.
        """
        before, drive = self.delay + self.memory - 1, self.drive(ensemble)
        out = np.empty((self.filters, self.degrees, len(ensemble), ensemble.samples))
        for degree in range(self.degrees):
            past = history(ensemble, polynomials[..., degree] * drive, before)
            past = past[:, : self.memory - 1 + ensemble.samples]
            for number, response in enumerate(self.responses):
                out[number, degree] = scipy.signal.lfilter(response, 1.0, past, axis=1)[
                    :, self.memory - 1 :
                ]
        return out.reshape(-1, *out.shape[2:])


@attrs.frozen
class Structure:
    """Model of the torque, without its weights.

    The ``variable``'s ``limits`` are mapped to -1 and 1; the angle counts from its ``centre``. Each
    intrinsic signal has a polynomial with ``degrees`` coefficients. The intrinsic signals are the
    angles at up to ``lags`` samples to either side. If ``lags`` is 0, they are angle and velocity,
    and an acceleration with a constant weight. The torque at rest has ``rest`` coefficients.
    """

    variable: str
    limits: tuple[float, float]
    centre: float
    lags: int
    degrees: int
    rest: int
    reflex: Reflex | None

    def stretched(self, direction: int) -> Structure:
        """Return the same structure with the other direction of stretch."""
        if self.reflex is None:
            return self
        drive = attrs.evolve(self.reflex.drive, direction=direction)
        return attrs.evolve(self, reflex=attrs.evolve(self.reflex, drive=drive))

    @property
    def counts(self) -> tuple[int, ...]:
        """Return the number of degrees of each intrinsic signal."""
        return (
            (self.degrees,) * (2 * self.lags + 1) if self.lags else (self.degrees, self.degrees, 1)
        )

    @property
    def orders(self) -> tuple[int, int]:
        """Return the orders of the polynomials of the intrinsic and of the reflex pathway."""
        return self.degrees - 1, self.reflex.degrees - 1 if self.reflex else 0

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the numbers of columns: at rest, intrinsic and reflex."""
        return (
            self.rest,
            sum(self.counts),
            *([self.reflex.filters * self.reflex.degrees] if self.reflex else []),
        )

    def of_orders(self, order: int, reflex_order: int) -> Structure:
        """Return the same structure with polynomials of other orders."""
        reflex = self.reflex and attrs.evolve(self.reflex, degrees=reflex_order + 1)
        return attrs.evolve(self, degrees=order + 1, reflex=reflex)

    def within(self, order: int, reflex_order: int) -> NDArray[np.bool_]:
        """Return which columns polynomials of these orders have, shape (column,)."""
        kept = [
            np.ones(self.rest, dtype=bool),
            *(np.arange(count) <= order for count in self.counts),
        ]
        if self.reflex is not None:
            kept.append(
                np.tile(np.arange(self.reflex.degrees) <= reflex_order, self.reflex.filters)
            )
        return np.concatenate(kept)

    def polynomials(self, values: Array) -> Array:
        """Return Chebyshev polynomials of values of the variable, shape (..., degree).

        There are as many as the highest order needs.
        """
        most = max(self.degrees, self.rest, self.reflex.degrees if self.reflex else 1)
        return chebyshev_of(values, self.limits, most)

    def readout(self, rate: float) -> Array:
        """Return the matrix (3, signal) that gives stiffness, viscosity and inertia.

        It multiplies the weights of the intrinsic signals.
        """
        if not self.lags:
            return np.eye(3)
        fit = second_order_fit(np.arange(-self.lags, self.lags + 1) / rate)
        return np.stack([np.ones(fit.shape[1]), *fit[1:]])

    def signals(self, ensemble: Ensemble) -> Array:
        """Return the intrinsic signals, shape (signal, realization, time).

        They are NaN where lags or filters reach beyond the context.
        """
        if not self.lags:
            found = ensemble.derivatives()
            found[0] -= self.centre
            return found
        missing = max(0, self.lags - ensemble.context)
        angle = np.pad(
            ensemble.angle - self.centre, ((0, 0), (missing, missing)), constant_values=np.nan
        )
        first = ensemble.context + missing - self.lags
        windows = sliding_window_view(angle, ensemble.samples, axis=1)[
            :, first : first + 2 * self.lags + 1
        ]
        return np.asarray(windows[:, ::-1].transpose(1, 0, 2))

    def parts(self, ensemble: Ensemble) -> list[Array]:
        """Return the regressors of rest, intrinsic and reflex torque.

        Each has shape (column, realization, time). They lose their mean over realizations where the
        ensemble has lost its own.
        """
        polynomials = self.polynomials(ensemble.signal(self.variable))
        own = np.moveaxis(polynomials[:, ensemble.core], -1, 0)
        pairs = zip(self.signals(ensemble), self.counts, strict=True)
        found = [np.concatenate([own[:count] * signal for signal, count in pairs])]
        if self.reflex is not None:
            found.append(self.reflex.columns(ensemble, polynomials))
        return [self.at_rest(ensemble), *(_about_mean(each, ensemble) for each in found)]

    def at_rest(self, ensemble: Ensemble) -> Array:
        """Return the regressors of the torque at rest, shape (degree, realization, time)."""
        own = self.polynomials(ensemble.signal(self.variable)[:, ensemble.core])[..., : self.rest]
        return _about_mean(np.moveaxis(own, -1, 0), ensemble)

    def readouts(self, rate: float) -> dict[str, Array]:
        """Return a matrix for each quantity, which gives the quantity's weights.

        It has shape (coefficient, degree) and multiplies the coefficients of all columns.
        """
        found = {}
        for name, row in zip(IMPEDANCE, self.readout(rate), strict=True):
            own = [
                weight * np.eye(count, self.degrees)
                for weight, count in zip(row, self.counts, strict=True)
            ]
            found[name] = np.concatenate([np.zeros((self.rest, self.degrees)), *own])
        if self.reflex is None:
            return found
        reflex = np.kron(self.reflex.responses.sum(axis=1)[:, None], np.eye(self.reflex.degrees))
        before = self.rest + sum(self.counts)
        found = {name: np.pad(each, ((0, len(reflex)), (0, 0))) for name, each in found.items()}
        return found | {"reflex_gain": np.pad(reflex, ((before, 0), (0, 0)))}


def _about_mean(columns: Array, ensemble: Ensemble) -> Array:
    """Subtract the mean over realizations where the ensemble has lost its own.

    The ``columns`` have shape (column, realization, time).
    """
    return (
        columns - mean_known(columns.swapaxes(0, 1))[:, None]
        if ensemble.mean_subtracted
        else columns
    )
