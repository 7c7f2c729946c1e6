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
from tvsysid.models import Diagnostics, StandardError
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.instrument import HARDLY_MOVED, lag_samples, predicted, realization_groups
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.spectra import hann, power_spectrum
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

if TYPE_CHECKING:
    from tvsysid.methods.tuning.evidence import Evidence

LEAST = 0.01  # share of the angle that the reference predicts below which nobody can use it
WEAK = 0.5  # below which there is a warning
WINDOW = 0.30  # s over which the strength at a time counts
SINGULAR = 1e-9  # determinant of scaled moments below which the quantities are not identifiable


class Instrument(NamedTuple):
    r"""Ensemble as the ``reference`` alone would have ``moved`` it, and its instrument strength.

    ``explained`` is the predicted share of the angle in held-out realizations. ``strength``
    (time,) is :math:`(\sum_r q_r)^2 / \sum_r q_r^2`, at most the number of realizations. q is the
    product of instrument and angle in a realization about a time, without the parts of viscosity
    and inertia. Where the strength is less than ``needed``, the data set no limit to the stiffness
    (Anderson & Rubin 1949). ``drowned`` is the range of frequencies in Hz in which noise moves the
    angle more than the reference does; None if there is no such frequency.
    """

    moved: Ensemble
    explained: float
    strength: Array
    needed: float
    drowned: tuple[float, float] | None
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
                f"{_percent(explained)} of "
                f"it, at least {_percent(least)} are needed. Is it the right channel, and in time "
                "with the angle? If "
                f"so, disturb more strongly{_alternative(reference) if least > LEAST else ''}"
            )
        moved = attrs.evolve(ensemble, angle=angle)
        strength = _strength(ensemble, moved)
        independent = independent_realizations(ensemble)
        return cls(
            moved,
            explained,
            strength,
            _needed(independent),
            _drowned(left, angle[:, core], ensemble),
            reference,
        )

    def seen(self, diagnostics: Diagnostics, banded: bool = True) -> Diagnostics:
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
            if self.drowned is not None:
                where = " from {:.2g} to {:.2g} Hz, where noise moves the angle more".format(
                    *self.drowned
                )
            found.append(
                f"the reference {self.reference!r} predicts only {_percent(self.explained)} of "
                "the angle: the random "
                f"error is large; disturb more strongly{where}, or use a stiffer actuator"
            )
        if banded and self.weak.any():
            found.append(f"no band at {_percent(self.weak.mean())} of the times: {self.reason}")
        return tuple(found)

    @property
    def reason(self) -> str:
        """Return why there is no band where the instrument is weak."""
        return (
            "the reference hardly moves the angle there, or in too few realizations "
            "(instrument_strength of less than "
            f"{self.needed:.3g}); record more, disturb more strongly{_alternative(self.reference)}"
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


class SegmentFit(NamedTuple):
    """Impedance (time, 3) of segments, its ``variances`` and the instrument's ``strength``.

    ``strength`` has shape (time,).
    """

    impedance: Array
    variances: Array
    strength: Array


def segment_fit(
    ensemble: Ensemble, moved: Ensemble, power: Array, begin: int, end: int
) -> SegmentFit:
    r"""Fit the impedance of segments by instruments.

    The segments lie between the samples ``begin`` and ``end``, which count the context. ``power``
    weighs a segment's samples.

    .. math:: A_r = \sum_i w_i z_r(i)\, x_r(i)^T, \quad c_r = \sum_i w_i z_r(i)\, y_r(i), \quad
              \hat\theta = \left(\sum_r A_r\right)^{-1} \sum_r c_r, \quad
              V = A^{-1} \sum_r s_r s_r^T A^{-T} \frac{R}{R - 3}, \quad s_r = c_r - A_r \hat\theta

    The realizations are the independent samples, so that the noise may have any colour and
    strength. Where the derivatives lack samples, segments are cut short.
    """
    products = _segment_products(ensemble, moved, power, begin, end)
    count, independent = len(ensemble), independent_realizations(ensemble)
    inverse = _inverse(products[..., :3].sum(axis=0))
    impedance = np.einsum("tij,rtj->ti", inverse, products[..., 3])
    scores = products[..., 3] - np.einsum("rtij,tj->rti", products[..., :3], impedance)
    effects = np.einsum("tij,rtj->rti", inverse, scores)
    share = count / (independent - 3) if independent > 3 else np.nan
    own = np.einsum("ti,rtij,tj->rt", inverse[:, 0], products[..., :3], inverse[:, :, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        strength = own.sum(axis=0) ** 2 / np.sum(own**2, axis=0)
    return SegmentFit(impedance, share * np.sum(effects**2, axis=0), strength)


def _segment_products(
    ensemble: Ensemble, moved: Ensemble, power: Array, begin: int, end: int
) -> Array:
    """Return weighted sums over segments of z times x and y: (realization, time, 3, 4)."""
    reach, samples = HALF_WIDTH, ensemble.angle.shape[1]
    first, last = max(reach, begin), min(samples - reach, end)
    at = slice(first - reach, last + reach)
    z, x = (differentiate(each.angle[:, at], ensemble.sampling_rate) for each in (moved, ensemble))
    x = np.concatenate([x, ensemble.torque[None, :, first:last]])
    weights = np.broadcast_to(power[::-1], (end - begin - len(power) + 1, len(power)))
    out = np.empty((len(ensemble), len(weights), 3, 4))
    product = np.zeros((len(ensemble), end - begin))
    for a, left in enumerate(z):
        for b, right in enumerate(x):
            np.multiply(left, right, out=product[:, first - begin : last - begin])
            out[:, :, a, b] = convolve_lags(product, weights)
    return out


def _inverse(matrices: Array) -> Array:
    """Invert matrices (time, 3, 3) that are not symmetric; NaN where they are singular."""
    rows, columns = (np.sqrt(np.sum(matrices**2, axis=axis, keepdims=True)) for axis in (2, 1))
    scale = np.sqrt(rows * columns)
    scaled = np.divide(matrices, scale, out=np.zeros_like(matrices), where=scale > 0)
    told = np.abs(np.linalg.det(scaled)) > SINGULAR
    scaled[~told] = np.eye(3)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(
            told[:, None, None], np.linalg.inv(scaled) / scale.transpose(0, 2, 1), np.nan
        )


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
    return np.pad(
        segment_fit(ensemble, moved, power, begin, end).strength, (early, late), mode="edge"
    )


def _needed(independent: int) -> float:
    """Return the strength above which the data limit the stiffness."""
    freedom = independent - 3
    return float(stdtrit(freedom, 0.975) ** 2 * independent / freedom) if freedom > 0 else np.inf


def _drowned(left: Array, angle: Array, ensemble: Ensemble) -> tuple[float, float] | None:
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
