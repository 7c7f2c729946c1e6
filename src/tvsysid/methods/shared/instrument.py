r"""Identify a joint in closed loop, with the angle that a reference predicts as the instrument.

In closed loop, noise of the torque moves the angle. With :math:`x = (u, \dot u, \ddot u)` of the
angle and z of the predicted angle, :math:`E[z (y - x^T \theta)] = 0` whatever the loop, but
:math:`E[x (y - x^T \theta)]` is not zero. So z takes the place of x in the left factor of every
moment.

:class:`ByReference` does for every method what does not depend on the method: it predicts the
angle, refuses a reference that hardly moves it, and removes bands where the instrument is weak.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from tvsysid.errors import InputError
from tvsysid.methods.base import Input, Method
from tvsysid.methods.cascade.pathways import history
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.methods.shared.segments import instrumental_fit
from tvsysid.models import Estimate, Model, StandardError
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.instrument import HARDLY_MOVED, lag_samples, predicted, realization_groups
from tvsysid.numerics.spectra import hann
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

if TYPE_CHECKING:
    from tvsysid.methods.tuning.evidence import Evidence

MIN_SHARE = 0.01  # of the angle that a reference must predict for any method
WEAK = 0.5  # below which there is a warning
WINDOW = 0.30  # s over which the strength at a time counts


class ByReference(Method):
    """Identify a joint, also in closed loop if a ``reference`` moves the angle.

    A subclass implements ``_fit``. ``bands_need_strength`` says whether bands need a strong
    instrument at each time.
    """

    reference: str | None
    bands_need_strength: ClassVar[bool] = True

    @property
    def inputs(self) -> tuple[Input, ...]:  # type: ignore[override]
        """Return the channel of the reference, if there is one."""
        name = self.reference
        return () if name is None else (Input(name, "reference", "of any unit"),)

    @property
    def least_share(self) -> float:
        """Return the smallest share of the angle that the reference must predict."""
        return HARDLY_MOVED

    @abstractmethod
    def _fit(self, ensemble: Ensemble, moved: Ensemble) -> Model:
        """Return the model by the angle of ``moved``, which is the ensemble without a reference."""

    def fit(self, ensemble: Ensemble) -> Model:
        """Return the model of an ensemble."""
        if self.reference is None:
            return self._fit(ensemble, ensemble)
        moved, explained = self._moved(ensemble, self.reference)
        model = self._fit(ensemble, moved)
        return self._annotated(model, explained, instrument_strength(ensemble, moved), ensemble)

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        if self.reference is None:
            return self._open_loop_evidence(ensemble, seed)
        moved, _ = self._moved(ensemble, self.reference)
        return with_settings(self, reference=None)._evidence(moved, seed)

    @abstractmethod
    def _open_loop_evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        """Return the evidence for settings where the angle is imposed."""

    def _moved(self, ensemble: Ensemble, reference: str) -> tuple[Ensemble, float]:
        """Return the ensemble as the reference alone would have moved it.

        Return also the share of the angle that the reference predicts in held-out realizations.
        Raise InputError if this is less than ``least_share``.
        """
        moved = attrs.evolve(ensemble, angle=_predicted(ensemble, reference))
        measured, angle = (each.angle[:, ensemble.core] for each in (ensemble, moved))
        left = measured - angle
        explained = 1 - float(np.vdot(left, left) / np.vdot(measured, measured))
        if not explained >= self.least_share:
            raise InputError(
                f"{self.key}: the disturbance {reference!r} hardly moves the angle: it predicts "
                f"{_percent(explained)} of it, at least {_percent(self.least_share)} are needed. "
                "Is it the right channel, and in time with the angle? If so, disturb more "
                f"strongly{self._alternative() if self.least_share > MIN_SHARE else ''}"
            )
        return moved, explained

    def _annotated(
        self, model: Model, explained: float, strength: Array, ensemble: Ensemble
    ) -> Model:
        """Return a model with the details and warnings of the instrument in its diagnostics.

        Where the ``strength`` is less than needed, the data set no limit to the stiffness (Anderson
        & Rubin 1949). There are no bands there, if they need its strength.
        """
        freedom = independent_realizations(ensemble) - 3
        needed = stdtrit(freedom, 0.975) ** 2 * (freedom + 3) / freedom if freedom > 0 else np.inf
        found, estimates = [], model.estimates
        if explained < WEAK:
            found.append(
                f"the reference {self.reference!r} predicts only {_percent(explained)} of the "
                "angle: the random error is large; disturb more strongly, or use a stiffer actuator"
            )
        weak = ~(strength >= needed)
        if self.bands_need_strength and weak.any():
            reason = (
                "the reference hardly moves the angle there, or in too few realizations "
                f"(instrument_strength of less than {needed:.3g}); record more, disturb more "
                f"strongly{self._alternative()}"
            )
            found.append(f"no band at {_percent(weak.mean())} of the times: {reason}")
            estimates = {
                name: attrs.evolve(each, error=partial(_where_strong, each, weak, reason))
                for name, each in estimates.items()
            }
        details = {
            "predicted_by_reference": 100 * explained,
            "instrument_strength_needed": float(needed),
        }
        diagnostics = attrs.evolve(
            model.diagnostics,
            strength=strength,
            warnings=(*model.diagnostics.warnings, *found),
            details={**model.diagnostics.details, **details},
        )
        return attrs.evolve(model, estimates=estimates, diagnostics=diagnostics)

    def _alternative(self) -> str:
        return f", or use kbr:reference={self.reference},weighting=residual, which needs less"


def _where_strong(estimate: Estimate, weak: NDArray[np.bool_], reason: str) -> StandardError | None:
    """Return the standard error of an estimate, except at the times at which it is ``weak``."""
    error = estimate.standard_error
    if error is None:
        return None
    absent = error.absent or (reason if weak.all() else "")
    return attrs.evolve(error, values=np.where(weak, np.nan, error.values), absent=absent)


def reference_around(ensemble: Ensemble, reference: str, late: int, early: int) -> Array:
    """Return the reference with more samples before and after each realization and its context.

    ``late`` and ``early`` are their numbers. Unknown samples of the reference are 0, because an
    instrument may be incomplete.
    """
    values = ensemble.signal(reference)
    if ensemble.mean_subtracted:
        values = values - values.mean(axis=0)
    if not np.any(values):
        raise InputError(
            f"the reference {reference!r} does not "
            f"vary{' between realizations' * ensemble.mean_subtracted}"
        )
    whole = np.pad(values, ((0, 0), (late, early)))
    past = history(ensemble, values, late + ensemble.context)
    whole[:, : past.shape[1]] = np.where(np.isnan(past), whole[:, : past.shape[1]], past)
    return whole


def _predicted(ensemble: Ensemble, reference: str) -> Array:
    """Return the angle (realization, context + time + context) that the reference predicts."""
    if len(ensemble) < 2:
        raise InputError(
            "a reference predicts the angle of a realization by what the others tell; expected at "
            "least two, got one"
        )
    early, late = lag_samples(ensemble.sampling_rate)
    whole = reference_around(ensemble, reference, late, early)
    groups = realization_groups(ensemble.trials, ensemble.onsets)
    return predicted(whole, ensemble.angle, ensemble.core, ensemble.sampling_rate, groups)


def instrument_strength(ensemble: Ensemble, moved: Ensemble) -> Array:
    r"""Return the strength (time,) of the instrument about each time.

    It is :math:`(\sum_r q_r)^2 / \sum_r q_r^2`, at most the number of realizations. q is the
    product of instrument and angle in a realization about a time, without the parts of viscosity
    and inertia. Where the window reaches too far, the strength is that of the nearest window.
    """
    power = hann(max(4, round(WINDOW * ensemble.sampling_rate))) ** 2
    before, after = len(power) // 2, (len(power) - 1) // 2
    early, late = max(0, before - ensemble.context), max(0, after - ensemble.context)
    begin, end = ensemble.core.start + early - before, ensemble.core.stop - late + after
    if end - begin < len(power) + 2 * HALF_WIDTH:
        return np.full(ensemble.samples, np.nan)
    strength = instrumental_fit(ensemble, moved, power, slice(begin, end)).strength
    return np.pad(strength, (early, late), mode="edge")


def _percent(share: float) -> str:
    return f"{100 * max(share, 0.0):.2g} %"
