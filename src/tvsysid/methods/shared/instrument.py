r"""Identify a joint in closed loop. The instrument is the angle predicted from a reference.

In closed loop, noise of the torque moves the angle. With :math:`x = (u, \dot u, \ddot u)` of the
angle and z of the predicted angle, :math:`E[z (y - x^T \theta)] = 0` whatever the loop, but
:math:`E[x (y - x^T \theta)]` is not zero. So z takes the place of x in the left factor of every
moment.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.base import Input, Method
from tvsysid.methods.pathways import history
from tvsysid.models import Model
from tvsysid.numerics.instrument import MIN_PREDICTED, lag_samples, predicted, realization_groups
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

if TYPE_CHECKING:
    from tvsysid.methods.tuning import Evidence

# Least share of the angle that a reference must predict, with residual weights
MIN_SHARE = 0.01
WEAK_SHARE = 0.5  # share below which there is a warning


class ReferenceMethod(Method):
    """Identify a joint, also in closed loop if a ``reference`` moves the angle.

    A subclass implements ``_fit``.
    """

    reference: str | None

    @property
    def inputs(self) -> tuple[Input, ...]:  # type: ignore[override]
        """Return the channel of the reference, if there is one."""
        name = self.reference
        return () if name is None else (Input(name, "reference", "of any unit"),)

    @property
    def least_share(self) -> float:
        """Return the smallest share of the angle that the reference must predict."""
        return MIN_PREDICTED

    @abstractmethod
    def _fit(self, ensemble: Ensemble, instrument: Ensemble) -> Model:
        """Return the model. ``instrument`` has the angle that the reference predicts, if any."""

    def fit(self, ensemble: Ensemble) -> Model:
        """Return the model of an ensemble."""
        if self.reference is None:
            return self._fit(ensemble, ensemble)
        instrument, explained = self._instrument(ensemble, self.reference)
        model = self._fit(ensemble, instrument)
        warned = (
            f"the reference {self.reference!r} predicts only {_percent(explained)} of the angle: "
            "the random error is large; disturb more strongly, or use a stiffer actuator"
        )
        diagnostics = attrs.evolve(
            model.diagnostics,
            warnings=(*model.diagnostics.warnings, *[warned] * (explained < WEAK_SHARE)),
            details={**model.diagnostics.details, "predicted_by_reference": 100 * explained},
        )
        return attrs.evolve(model, diagnostics=diagnostics)

    def _evidence(self, ensemble: Ensemble) -> Evidence:
        if self.reference is None:
            return self._open_loop_evidence(ensemble)
        # Noise does not move the predicted angle, so the loop is open.
        instrument, _ = self._instrument(ensemble, self.reference)
        return with_settings(self, reference=None)._open_loop_evidence(instrument)

    def _open_loop_evidence(self, ensemble: Ensemble) -> Evidence:
        """Return the evidence for settings in open loop."""
        return super()._evidence(ensemble)

    def _instrument(self, ensemble: Ensemble, reference: str) -> tuple[Ensemble, float]:
        """Return the ensemble with the angle that the reference predicts, not the measured one.

        Return also the share of the angle that the reference predicts in held-out realizations.
        Raise InputError if this is less than ``least_share``.
        """
        instrument = attrs.evolve(ensemble, angle=_predicted(ensemble, reference))
        measured, angle = (each.angle[:, ensemble.core] for each in (ensemble, instrument))
        error = measured - angle
        explained = 1 - float(np.vdot(error, error) / np.vdot(measured, measured))
        if not explained >= self.least_share:
            raise InputError(
                f"{self.key}: the disturbance {reference!r} hardly moves the angle: it predicts "
                f"{_percent(explained)} of it, at least {_percent(self.least_share)} are needed. "
                "Is it the right channel, and in time with the angle? If so, disturb more strongly"
            )
        return instrument, explained


def _predicted(ensemble: Ensemble, reference: str) -> Array:
    """Return the angle (realization, context + time + context) that the reference predicts.

    Unknown samples of the reference are 0. This weakens the instrument, without a bias.
    """
    values = ensemble.signal(reference)
    if ensemble.mean_subtracted:
        values = values - values.mean(axis=0)
    if len(ensemble) < 2 or not np.any(values):
        raise InputError(
            f"the reference {reference!r} does not vary between realizations, so it cannot "
            "predict how the angle differs between them"
        )
    after, before = lag_samples(ensemble.sampling_rate)
    extended = np.pad(values, ((0, 0), (before, after)))
    # Samples recorded before a realization replace its zeros.
    past = history(ensemble, values, before + ensemble.context)
    start = extended[:, : past.shape[1]]
    start[:] = np.where(np.isnan(past), start, past)
    groups = realization_groups(ensemble.trials, ensemble.onsets)
    return predicted(extended, ensemble.angle, ensemble.core, ensemble.sampling_rate, groups)


def _percent(share: float) -> str:
    return f"{100 * max(share, 0.0):.2g} %"
