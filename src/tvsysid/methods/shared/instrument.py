r"""Identify a joint in closed loop, with the angle that a reference predicts as the instrument.

In closed loop, noise of the torque moves the angle. With :math:`x = (u, \dot u, \ddot u)` of the
angle and z of the predicted angle, :math:`E[z (y - x^T \theta)] = 0` whatever the loop, but
:math:`E[x (y - x^T \theta)]` is not zero. So z takes the place of x in the left factor of every
moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from tvsysid.errors import InputError
from tvsysid.methods.base import Input, Method
from tvsysid.methods.cascade.pathways import history
from tvsysid.methods.shared.estimates import ErrorStatistics
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.methods.shared.segments import Segments, instrumental_fit
from tvsysid.models import Diagnostics, StandardError
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.instrument import HARDLY_MOVED, lag_samples, predicted, realization_groups
from tvsysid.numerics.spectra import hann, power_spectrum
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

if TYPE_CHECKING:
    from tvsysid.methods.tuning.evidence import Evidence

LEAST = 0.01  # share of the angle that the reference predicts below which nobody can use it
WEAK = 0.5  # below which there is a warning
WINDOW = 0.30  # s over which the strength at a time counts


class Instrument(NamedTuple):
    r"""Ensemble as the ``reference`` alone would have ``moved`` it, and its instrument strength.

    ``explained`` is the predicted share of the angle in held-out realizations. ``strength``
    (time,) is :math:`(\sum_r q_r)^2 / \sum_r q_r^2`, at most the number of realizations. q is the
    product of instrument and angle in a realization about a time, without the parts of viscosity
    and inertia. Where the strength is less than ``needed``, the data set no limit to the stiffness
    (Anderson & Rubin 1949). In the ``noisy_band``, in Hz, noise moves the angle more than the
    reference does; None if there is no such frequency.
    """

    moved: Ensemble
    explained: float
    strength: Array
    needed: float
    noisy_band: tuple[float, float] | None
    reference: str

    @classmethod
    def of(
        cls, method: str, ensemble: Ensemble, reference: str, least: float = HARDLY_MOVED
    ) -> Instrument:
        """Predict the angle from the reference.

        Raise InputError if the reference predicts less than the share ``least`` of the angle.
        """
        angle = _predicted(ensemble, reference)
        core = ensemble.core
        left = ensemble.angle[:, core] - angle[:, core]
        explained = 1 - float(
            np.vdot(left, left) / np.vdot(ensemble.angle[:, core], ensemble.angle[:, core])
        )
        if not explained >= least:
            raise InputError(
                f"{method}: the disturbance {reference!r} hardly moves the angle: it predicts "
                f"{_percent(explained)} of it, at least {_percent(least)} are needed. Is it the "
                "right channel, and in time with the angle? If so, disturb more "
                f"strongly{_alternative(reference) if least > LEAST else ''}"
            )
        moved = attrs.evolve(ensemble, angle=angle)
        strength = _strength(ensemble, moved)
        independent = independent_realizations(ensemble)
        return cls(
            moved,
            explained,
            strength,
            _needed(independent),
            _noisy_band(left, angle[:, core], ensemble),
            reference,
        )

    def annotate(self, diagnostics: Diagnostics, banded: bool = True) -> Diagnostics:
        """Add the details and warnings of the instrument to the diagnostics.

        ``banded`` says that the method's bands need a strong instrument at each time.
        """
        known = self.strength[np.isfinite(self.strength)]
        of_known = (float(np.median(known)), float(known.min())) if known.size else (np.nan, np.nan)
        details = {
            "predicted_by_reference": 100 * self.explained,
            "instrument_strength_median": of_known[0],
            "instrument_strength_least": of_known[1],
            "instrument_strength_needed": self.needed,
        }
        return attrs.evolve(
            diagnostics,
            strength=self.strength,
            warnings=(*diagnostics.warnings, *self._warnings(banded)),
            details={**diagnostics.details, **details},
        )

    @property
    def weak(self) -> NDArray[np.bool_]:
        """Return at which times (time,) the instrument is too weak for a band."""
        return ~(self.strength >= self.needed)

    def _warnings(self, banded: bool) -> tuple[str, ...]:
        """Return the warnings about the instrument."""
        found = []
        if self.explained < WEAK:
            where = ""
            if self.noisy_band is not None:
                where = " from {:.2g} to {:.2g} Hz, where noise moves the angle more".format(
                    *self.noisy_band
                )
            found.append(
                f"the reference {self.reference!r} predicts only {_percent(self.explained)} of the "
                f"angle: the random error is large; disturb more strongly{where}, or use a stiffer "
                "actuator"
            )
        if banded and self.weak.any():
            found.append(f"no band at {_percent(self.weak.mean())} of the times: {self.reason}")
        return tuple(found)

    @property
    def reason(self) -> str:
        """Return why there is no band where the instrument is weak."""
        return (
            "the reference hardly moves the angle there, or in too few realizations "
            f"(instrument_strength of less than {self.needed:.3g}); record more, disturb more "
            f"strongly{_alternative(self.reference)}"
        )

    def banded(self, errors: ErrorStatistics | Mapping[str, StandardError]) -> WhereStrong:
        """Return the errors of a method, only where the instrument is strong enough."""
        return WhereStrong(errors, self.weak, self.reason)


class ByReference(Method):
    """Identify a joint, also in closed loop if a ``reference`` moves the angle."""

    reference: str | None

    @property
    def inputs(self) -> tuple[Input, ...]:  # type: ignore[override]
        """Return the channel of the reference, if there is one."""
        name = self.reference
        return () if name is None else (Input(name, "reference", "of any unit"),)

    def _least_share(self) -> float:
        """Return the smallest share of the angle that the reference must predict."""
        return HARDLY_MOVED

    def instrument(self, ensemble: Ensemble) -> Instrument | None:
        """Return the instrument; None without a reference."""
        if self.reference is None:
            return None
        return Instrument.of(self.key, ensemble, self.reference, self._least_share())

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        instrument = self.instrument(ensemble)
        if instrument is None:
            return self._open_loop_evidence(ensemble, seed)
        return with_settings(self, reference=None)._evidence(instrument.moved, seed)

    def _open_loop_evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        """Return the evidence for settings where the angle is imposed."""
        raise NotImplementedError


@attrs.frozen(eq=False)
class WhereStrong:
    """Standard errors, except at the times at which the instrument is ``weak``.

    The reason for their absence is kept.
    """

    errors: ErrorStatistics | Mapping[str, StandardError]
    weak: NDArray[np.bool_]
    reason: str

    def standard_errors(self) -> dict[str, StandardError]:
        """Return the standard errors by quantity."""
        found = self.errors if isinstance(self.errors, Mapping) else self.errors.standard_errors()
        why = self.reason if self.weak.all() else ""
        return {
            name: attrs.evolve(
                error, values=np.where(self.weak, np.nan, error.values), absent=error.absent or why
            )
            for name, error in found.items()
        }


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
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    groups = realization_groups(ensemble.trials, ensemble.onsets)
    return predicted(whole, ensemble.angle, ensemble.core, ensemble.sampling_rate, groups)


def _strength(ensemble: Ensemble, moved: Ensemble) -> Array:
    """Return the strength (time,) of the instrument about each time.

    Where the window reaches too far, the strength is that of the nearest window.
    """
    power = hann(max(4, round(WINDOW * ensemble.sampling_rate))) ** 2
    before, after = len(power) // 2, (len(power) - 1) // 2
    early, late = max(0, before - ensemble.context), max(0, after - ensemble.context)
    begin, end = ensemble.core.start + early - before, ensemble.core.stop - late + after
    if end - begin < len(power) + 2 * HALF_WIDTH:
        return np.full(ensemble.samples, np.nan)
    strength = instrumental_fit(Segments(ensemble, power, begin, end), moved).strength
    return np.pad(strength, (early, late), mode="edge")


def _needed(independent: int) -> float:
    """Return the strength above which the data limit the stiffness."""
    freedom = independent - 3
    return float(stdtrit(freedom, 0.975) ** 2 * independent / freedom) if freedom > 0 else np.inf


def _noisy_band(left: Array, angle: Array, ensemble: Ensemble) -> tuple[float, float] | None:
    """Return the first and last frequency in Hz at which noise moves the angle more.

    At these frequencies the residual of the angle is larger than the predicted angle. Only the
    lower frequencies that hold 90 % of the residual's power count.
    """
    noise, signal = (power_spectrum(each) for each in (left, angle))
    within = np.cumsum(noise) <= 0.9 * noise.sum()
    found = np.flatnonzero((noise > signal) & within) / ensemble.duration
    return (float(found[0]), float(found[-1])) if found.size else None


def _alternative(reference: str) -> str:
    return f", or use kbr:reference={reference},weighting=residual, which needs less"


def _percent(share: float) -> str:
    return f"{100 * max(share, 0.0):.2g} %"
