"""Identify both pathways of a joint in turn, each from the torque that the other leaves."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.methods import birf
from tvsysid.methods.base import whole_samples
from tvsysid.methods.cascade.method import TwoPathwayMethod
from tvsysid.methods.cascade.pathways import (
    DIRECTIONS,
    Drive,
    MeasuredChannel,
    Stretch,
    TwoPathwayModel,
    history,
)
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.models import Estimate, StandardError
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import A_BASIS, Basis, CubicBSplines
from tvsysid.numerics.hammerstein import Turn, alternate, lagged_moments, parallel_cascade
from tvsysid.numerics.moments import convolve_lags, sliding_sum
from tvsysid.numerics.moments import lagged_moments as moments_of
from tvsysid.numerics.pseudoinverse import truncated
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import not_negative, optional, positive, text

NO_BAND = "the method's authors state none for two pathways that are identified in turn"
MAX_TURNS = 30  # of either pathway
MIN_GAIN = 1e-5  # share of the torque's power by which a turn must improve the fit
MIN_REALIZATIONS = 3  # with their past: of fewer there is nothing to average over


class AlternatingCascade(TwoPathwayMethod):
    """Identify each pathway in turn from the torque that the other pathway leaves.

    A subclass names the method of one pathway that identifies either. The response of the reflex
    begins where the lags of the intrinsic response end, or at 0 with EMG. Turns end when the
    explained torque hardly grows. Realizations whose past is not recorded are left out.
    """

    max_lag: float
    memory: float

    @abstractmethod
    def _one_path(self, max_lag: float) -> birf.BasisIRF | ShortDataSegments:
        """Return the method that identifies a pathway with these lags to either side, in s."""

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip the method if too few realizations have a recorded past."""
        past = history(ensemble, ensemble.angle, whole_samples(self.memory, ensemble))
        count = int((~np.isnan(past).any(axis=1)).sum())
        lasts = ensemble.context >= whole_samples(self.max_lag, ensemble)
        if count * lasts >= MIN_REALIZATIONS:
            return None
        return (
            f"{count} of {len(ensemble)} realizations have {self.memory:g} s recorded before them, "
            f"and {MIN_REALIZATIONS} are needed, with {self.max_lag:g} s after them; cut with more "
            "context (--context), or shorten memory"
        )

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        lags, before = (whole_samples(each, ensemble) for each in (self.max_lag, self.memory))
        first = 0 if self.emg else lags
        reach = (max(before, 2 * lags) - first + 1) // 2  # to either side of the reflex's mean lag
        before = first + 2 * reach
        drive = (
            MeasuredChannel(self.emg) if self.emg else constant_cascade(ensemble, lags, before)[0]
        )
        past = past_of(ensemble, drive, before)[:, : 2 * reach + ensemble.samples]
        known = ~np.isnan(past).any(axis=1)
        past, kept = past[known], ensemble.select(known)
        angle = kept.angle[:, kept.core.start - lags : kept.core.stop + lags]
        torque = kept.torque[:, kept.core]

        def moved(signal: Array, context: int, output: Array) -> Ensemble:
            """Return a joint of one pathway with this input in the place of the angle."""
            return attrs.evolve(
                kept,
                angle=signal,
                torque=np.pad(output, ((0, 0), (context, context))),
                recorded_angle=None,
                channels={},
                context=context,
            )

        def step(turn: Turn) -> Turn:
            joint = moved(angle, lags, torque - turn.details[1])
            intrinsic = self._one_path(self.max_lag).fit(joint)
            left = torque - intrinsic.predict(joint)
            weights = self._reflex(moved(past, reach, left))
            late = convolve_lags(past, weights)
            explained = 1 - float(np.sum((left - late) ** 2) / np.sum(torque**2))
            return Turn(weights, explained, (intrinsic, late))

        best = alternate(step, Turn(details=(None, 0.0)), MAX_TURNS, MIN_GAIN)
        intrinsic = attrs.evolve(best.details[0], method=repr(self))
        return two_pathways(ensemble, intrinsic, drive, best.weights, first)

    def _reflex(self, joint: Ensemble) -> Array:
        """Return the weights (time, lag) of a reflex whose drive moves a joint without another."""
        rate = joint.sampling_rate
        model = self._one_path(joint.context / rate).fit(joint)
        assert isinstance(model, ImpulseResponseModel)
        return model.impulse_response / rate


@attrs.frozen
class BasisCascade(AlternatingCascade):
    r"""Identify intrinsic and reflex response in turn, each as a sum of basis functions.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} \sum_j
              \lambda_{\tau j} \Lambda_j(t)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} \sum_j \mu_{\tau j} \Lambda_j(t)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`BasisIRF` (``model="irf"``, ``prior="ridge"``)
    from the torque less the reflex's, the reflex with the same basis from the torque less the
    intrinsic one, and so on until the torque explained grows by less than 0.001 points. f is the
    velocity of stretch, rectified, or EMG.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s, no more than the reflex's delay. The
        reflex's response begins there; with EMG, it begins at 0.
    memory
        Last lag of the reflex's response in s.
    basis
        Basis functions of normalised time; see :class:`BasisIRF`.
    emg
        Channel, rectified, that drives the reflex instead of the velocity.

    Notes
    -----
    The direction of stretch is the one that explains more of the torque. ``reflex_gain`` is the
    area under the reflex's response at a time, in N·m·s/rad (with EMG, torque by the unit of EMG).
    It belongs to the time of the torque, which follows the stretch by the mean lag of the muscle.

    The authors also take slow voluntary torque out, by polynomials of time in each realization.
    ``cascade`` does without them.

    With the velocity, the papers identify a muscle of second order whose coefficients change, by
    refined instrumental variables. Here the reflex has a free response, as theirs with EMG. In
    simulations, their muscle showed no bias of the gain (here 0.75 N·m·s/rad), but five times the
    random error of the gain and 1.6 times the error of the stiffness. It explained less torque of a
    walking ankle.

    Realizations whose memory is not recorded are left out. No bands are stated: the bands of one
    pathway would not count the error of the other.

    References
    ----------
    Guarin & Kearney 2017, Front. Comput. Neurosci. 11:51, and 2018, IEEE Trans. Neural Syst.
    Rehabil. Eng. 26.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    memory: float = attrs.field(default=0.5, validator=positive)
    basis: Basis = attrs.field(factory=CubicBSplines, validator=A_BASIS)
    emg: str | None = attrs.field(default=None, validator=optional(text))

    key = "bpc"
    title = "Basis parallel cascade"
    assumptions = (
        "The movement is the same in all realizations.",
        "Both pathways change as sums of the basis functions chosen; faster changes are missed.",
        "The intrinsic response ends before the reflex's delay does.",
        "The reflex answers the velocity of stretch, or EMG.",
    )
    differs = (
        "It changes as its basis functions can; the pathways are identified in turn, so that each "
        "may keep a part of the other's torque."
    )
    cites = ("guarin2017", "guarin2018")

    def _one_path(self, max_lag: float) -> birf.BasisIRF:
        return birf.BasisIRF(max_lag=max_lag, basis=self.basis, model="irf", prior="ridge")


@attrs.frozen
class EnsembleCascade(AlternatingCascade):
    r"""Identify intrinsic and reflex response at each time in turn, across realizations.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} h(t, \tau)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} p(t, \tau)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`ShortDataSegments` from the torque less the
    reflex's, the reflex by the same truncated pseudo-inverse from the torque less the intrinsic
    one, and so on until the torque explained grows by less than 0.001 points. f is the velocity of
    stretch, rectified.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s, no more than the reflex's delay.
        The reflex's response begins there.
    memory
        Last lag of the reflex's response in s.
    window
        Time in s over which the joint is taken as constant, as in :class:`ShortDataSegments`. 0, as
        the paper has it, takes each time by itself, and needs 500 to 800 realizations.

    Notes
    -----
    The direction of stretch and ``reflex_gain`` are those of :class:`BasisCascade`. The paper has a
    different static function at each time, with more coefficients than the usual number of
    realizations determines.

    Realizations that do not have the memory recorded before them are left out. No bands are stated.

    References
    ----------
    Ludvig, Starret Visser, Giesbrecht & Kearney 2011, IEEE Trans. Biomed. Eng. 58, 1715-1723.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    memory: float = attrs.field(default=0.5, validator=positive)
    window: float = attrs.field(default=0.10, validator=not_negative)

    key = "tvpc"
    title = "Ensemble parallel cascade"
    assumptions = (
        "The movement is the same in all realizations.",
        "The joint is constant over a short window; nothing else is assumed of how it changes.",
        "The intrinsic response ends before the reflex's delay does.",
        "Many realizations are needed: without a window, 500 to 800.",
    )
    differs = (
        "It is a mean over its window, with a large random error of few realizations; the pathways "
        "are identified in turn."
    )
    cites = ("ludvig2011",)

    def _one_path(self, max_lag: float) -> ShortDataSegments:
        return ShortDataSegments(max_lag, self.window)

    def _reflex(self, joint: Ensemble) -> Array:
        """Return the weights, from the mean square of the torque as it is, not about its mean."""
        half, count = whole_samples(self.window / 2, joint), np.ones(joint.samples)
        moments = count, *moments_of(joint.angle, joint.torque, joint.context)[:3]
        count, *sums = (sliding_sum(each, half, half) for each in moments)
        phi, cross, power = (np.swapaxes(each.T / count, 0, -1) for each in sums)
        return truncated(phi, cross, power, count * len(joint)).weights


def two_pathways(
    ensemble: Ensemble,
    intrinsic: ImpulseResponseModel,
    drive: Stretch | MeasuredChannel,
    reflex: Array,
    first: int,
) -> TwoPathwayModel:
    """Return the model of an intrinsic pathway and of a reflex, without bands.

    The reflex's weights (time, lag) begin with the lag ``first``. The gain is their sum.
    """
    rate, error = ensemble.sampling_rate, StandardError.none(ensemble.samples, NO_BAND)
    unit = "N m/V" if isinstance(drive, MeasuredChannel) else UNITS["reflex_gain"]
    estimates = {**intrinsic.estimates, "reflex_gain": Estimate(reflex.sum(axis=1), unit)}
    details = {**intrinsic.diagnostics.details, "direction": float(drive.direction)}
    model = TwoPathwayModel(
        method=intrinsic.method,
        sampling_rate=rate,
        time=intrinsic.time,
        estimates={name: attrs.evolve(each, error=error) for name, each in estimates.items()},
        impulse_response=intrinsic.impulse_response,
        lags=intrinsic.lags,
        reflex_response=reflex * rate,
        reflex_lags=(first + np.arange(reflex.shape[1])) / rate,
        drive=drive,
        diagnostics=attrs.evolve(intrinsic.diagnostics, details=details),
    )
    return model.with_shares(ensemble)


def past_of(ensemble: Ensemble, drive: Drive, before: int) -> Array:
    """Return a drive with its past (realization, before + time).

    Its mean over realizations is subtracted where the ensemble's is.
    """
    past = history(ensemble, drive(ensemble), before)
    return past - mean_known(past) if ensemble.mean_subtracted else past


def constant_cascade(ensemble: Ensemble, lags: int, before: int) -> tuple[Stretch, Turn]:
    """Return the velocity of stretch that explains most torque of a constant joint, with its fit.

    The first pathway is the intrinsic one, the second the reflex.
    """
    fits = []
    for drive in (Stretch(direction=direction) for direction in DIRECTIONS):
        rows = _rows(ensemble, past_of(ensemble, drive, before), lags)
        fits.append((drive, parallel_cascade(lagged_moments(rows), lags)))
    return max(fits, key=lambda fit: fit[1].explained)


def _rows(ensemble: Ensemble, past: Array, lags: int) -> Iterator[tuple[Array, Array]]:
    """Yield angle and drive (2, realization, before + time), and torque, where they are known.

    The angle is ``lags`` samples ahead, with at most 2 ``lags`` samples before. Realizations whose
    past begins at the same time are together.
    """
    short, before = max(0, lags - ensemble.context), past.shape[1] - ensemble.samples
    ahead = np.pad(ensemble.angle, ((0, 0), (before, short)))[:, ensemble.context + lags :]
    signals = np.stack([ahead[:, : past.shape[1]], past])
    last = ensemble.samples - short
    starts = np.isnan(past).sum(axis=1).clip(short)  # NaN come first
    for first in np.unique(starts[starts < last]):
        rows = starts == first
        torque = ensemble.torque[rows, ensemble.core][:, first:last]
        yield signals[:, rows, first : before + last], torque
