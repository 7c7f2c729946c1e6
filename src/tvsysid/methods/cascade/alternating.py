"""Identify both pathways of a joint in turn, each from the torque that the other leaves."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.methods.base import Input, Method, whole_samples
from tvsysid.methods.cascade.pathways import (
    DIRECTIONS,
    PATHWAYS,
    Drive,
    Measured,
    Stretch,
    TwoPathwayModel,
    history,
)
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.models import Estimate, StandardError
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.hammerstein import Turn, alternate, lagged_moments, parallel_cascade
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, window_moments
from tvsysid.signals import Array, Ensemble

NO_BAND = "the method's authors state none for two pathways that are identified in turn"
MAX_TURNS = 30  # of either pathway
MIN_GAIN = 1e-5  # share of the torque's power by which a turn must improve the fit
MIN_REALIZATIONS = 3  # with their past: of fewer there is nothing to average over


class AlternatingCascade(Method):
    """Identify each pathway in turn from the torque that the other pathway leaves.

    A subclass names the method that identifies the intrinsic pathway, and identifies the response
    of the reflex, which begins where the lags of the intrinsic response end, or at 0 with EMG.
    Turns end when the explained torque hardly grows. Realizations whose past is not recorded are
    left out.
    """

    max_lag: float
    memory: float
    emg: str | None = None

    quantities = ("reflex_gain",)
    pathway_names = PATHWAYS
    uses_recorded_angle = True

    @abstractmethod
    def _intrinsic(self, ensemble: Ensemble) -> Method:
        """Return the method that identifies the intrinsic pathway."""

    @abstractmethod
    def _response(self, drive: Array, output: Array, ensemble: Ensemble) -> Array:
        """Return weights (time, lag) of a drive (realization, lag + time) for an output."""

    @property
    def inputs(self) -> tuple[Input, ...]:  # type: ignore[override]
        """Return the channel of the EMG, if it drives the reflex."""
        return () if self.emg is None else (Input(self.emg, "input", "V"),)

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip the method if too few realizations have a recorded past."""
        past = history(ensemble, ensemble.angle, whole_samples(self.memory, ensemble))
        count = int((~np.isnan(past).any(axis=1)).sum())
        needed = min(MIN_REALIZATIONS, max(len(ensemble), 1 + ensemble.mean_subtracted))
        if count >= needed and ensemble.context >= whole_samples(self.max_lag, ensemble):
            return None
        return (
            f"{count} of {len(ensemble)} realizations have {self.memory:g} s recorded before them, "
            f"as long as the reflex's response, and {self.max_lag:g} s after, {needed} are needed; "
            "cut with more context (--context), or shorten memory"
        )

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        lags, before = (whole_samples(each, ensemble) for each in (self.max_lag, self.memory))
        before = max(before, 2 * lags)
        drive: Drive = (
            Measured(self.emg) if self.emg else constant_cascade(ensemble, lags, before)[0]
        )
        first = 0 if self.emg else lags
        past = past_of(ensemble, drive, before)[:, : before - first + ensemble.samples]
        known = ~np.isnan(past).any(axis=1)
        past, part = past[known], _with_context(ensemble.select(known), lags)
        torque = part.torque[:, part.core]

        def step(turn: Turn) -> Turn:
            left = part.torque.copy()
            left[:, part.core] -= convolve_lags(past, turn.second)
            intrinsic = self._intrinsic(ensemble).fit(attrs.evolve(part, torque=left))
            beyond = torque - intrinsic.predict(part)
            weights = self._response(past, beyond, ensemble)
            rest = beyond - convolve_lags(past, weights)
            return Turn(weights, 1 - float(np.sum(rest**2) / np.sum(torque**2)), intrinsic)

        none = np.zeros((ensemble.samples, before - first + 1))
        best = alternate(step, Turn(none), MAX_TURNS, MIN_GAIN)
        intrinsic = attrs.evolve(best.details, method=repr(self))
        return two_pathways(ensemble, intrinsic, drive, best.second, first, {})


def two_pathways(
    ensemble: Ensemble,
    intrinsic: ImpulseResponseModel,
    drive: Drive,
    reflex: Array,
    first: int,
    details: dict[str, float],
) -> TwoPathwayModel:
    """Return the model of an intrinsic pathway and of a reflex, without bands.

    The reflex's weights (time, lag) begin with the lag ``first``. The gain is their sum.
    """
    rate, none = ensemble.sampling_rate, StandardError.none(ensemble.samples, NO_BAND)
    unit = "N m/V" if isinstance(drive, Measured) else UNITS["reflex_gain"]
    estimates = {**intrinsic.estimates, "reflex_gain": Estimate(reflex.sum(axis=1), unit)}
    details = {**intrinsic.diagnostics.details, **details, "direction": float(drive.direction)}
    model = TwoPathwayModel(
        method=intrinsic.method,
        sampling_rate=rate,
        time=intrinsic.time,
        estimates={name: attrs.evolve(each, error=none) for name, each in estimates.items()},
        impulse_response=intrinsic.impulse_response,
        lags=intrinsic.lags,
        reflex_response=reflex * rate,
        reflex_lags=(first + np.arange(reflex.shape[1])) / rate,
        drive=drive,
        diagnostics=attrs.evolve(intrinsic.diagnostics, details=details),
    )
    return model.with_shares(ensemble)


def response_moments(drive: Array, output: Array) -> tuple[Array, Array]:
    """Return mean products of lagged drives (time, lag, lag), and with the output (time, lag).

    They are means over realizations of a drive (realization, lag + time) and an output
    (realization, time), from lag 0 on.
    """
    reach = drive.shape[1] - output.shape[1]
    gram = window_moments(drive, drive, reach, 0)[:, ::-1, ::-1]
    return gram, diagonal_moments(output, drive, reach)[:, ::-1]


def _with_context(ensemble: Ensemble, samples: int) -> Ensemble:
    """Return an ensemble with less context: the reflex's torque there is not known."""
    core = ensemble.core
    kept = slice(core.start - samples, core.stop + samples)
    signals = {name: getattr(ensemble, name)[:, kept] for name in ("angle", "torque")}
    return attrs.evolve(ensemble, **signals, channels={}, recorded_angle=None, context=samples)


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
    drives = [Stretch(direction=direction) for direction in DIRECTIONS]
    rows = (_rows(ensemble, past_of(ensemble, drive, before), lags) for drive in drives)
    fits = [parallel_cascade(lagged_moments(each), lags) for each in rows]
    return max(zip(drives, fits, strict=True), key=lambda fit: fit[1].explained)


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
