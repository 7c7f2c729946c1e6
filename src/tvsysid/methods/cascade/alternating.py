"""Methods that identify both pathways of a joint in turn."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, Literal

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.methods.base import Input, Method, whole_samples
from tvsysid.methods.cascade.pathways import (
    DIRECTIONS,
    PATHWAYS,
    Drive,
    Measured,
    Stretch,
    TwoPathwayModel,
    history,
    of_unit_slope,
    velocity_terms,
)
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.models import Estimate, StandardError
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import ChebyshevPolynomials, evaluate
from tvsysid.numerics.hammerstein import Rows, Turn, alternate, lagged_moments, parallel_cascade
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, window_moments
from tvsysid.signals import Array, Ensemble

Nonlinearity = Literal["rectifier", "polynomial"]

NO_BAND = "the method's authors state none for two pathways that are identified in turn"
DEGREE = 5  # of the polynomial
MAX_TURNS = 30  # of either pathway
MIN_GAIN = 1e-5  # share of the torque's power by which a turn must improve the fit
MIN_REALIZATIONS = 3  # with their past: of fewer there is nothing to average over


class AlternatingCascade(Method):
    """Identify each pathway in turn from the torque that the other pathway leaves.

    A subclass names the method that identifies the intrinsic pathway, and identifies the response
    of the reflex. Turns end when the explained torque hardly grows. In each turn, a polynomial's
    coefficients are fitted by least squares to the responses to its terms. With a ``slow_order``,
    a polynomial of time is fitted to the residual torque of each realization, and subtracted in
    the next turn. Realizations whose past is not recorded are left out.
    """

    max_lag: float
    delay: float | None
    memory: float
    nonlinearity: Nonlinearity
    emg: str | None = None
    slow_order: int | None = None

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
        needed = min(MIN_REALIZATIONS, len(ensemble))
        if count >= needed and ensemble.context >= whole_samples(self.max_lag, ensemble):
            return None
        return (
            f"{count} of {len(ensemble)} realizations have {self.memory:g} s recorded before them, "
            f"as long as the reflex's response, and {self.max_lag:g} s after; cut with more "
            "context (--context), or shorten memory"
        )

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        usual_delay = self.max_lag if self.emg is None else 0.0
        first = whole_samples(usual_delay if self.delay is None else self.delay, ensemble)
        lags, before = (whole_samples(each, ensemble) for each in (self.max_lag, self.memory))
        if self.emg is not None:
            drive: Drive = Measured(self.emg)
        else:
            drive, _ = constant_cascade(ensemble, lags, max(before, 2 * lags))
        degree = DEGREE if self.nonlinearity == "polynomial" and not self.emg else 0
        signals, start = terms_of(ensemble, drive, degree)
        past = past_of(ensemble, signals, before)[..., : before - first + ensemble.samples]
        known = ~np.isnan(past[0]).any(axis=1)
        past, part = past[:, known], _with_context(ensemble.select(known), lags)
        torque, functions = part.torque[:, part.core], np.zeros((ensemble.samples, 0))
        if self.slow_order is not None:
            polynomials = ChebyshevPolynomials(self.slow_order + 1)
            functions = np.linalg.qr(evaluate(polynomials, ensemble.samples))[0]

        def step(turn: Turn) -> Turn:
            coefficients, weights, _, (_, slow), _ = turn
            drive, left = np.tensordot(coefficients, past, 1), part.torque.copy()
            left[:, part.core] -= convolve_lags(drive, weights) + slow
            intrinsic = self._intrinsic(ensemble).fit(attrs.evolve(part, torque=left))
            beyond = torque - intrinsic.predict(part)
            weights = self._response(drive, beyond - slow, ensemble)
            if degree:
                terms = np.stack([convolve_lags(each, weights).ravel() for each in past])
                solved = np.linalg.solve(terms @ terms.T, terms @ (beyond - slow).ravel())
                coefficients = np.asarray(solved / np.linalg.norm(solved))
                drive = np.tensordot(coefficients, past, 1)
                weights = self._response(drive, beyond - slow, ensemble)
            rest = beyond - convolve_lags(drive, weights)
            slow = rest @ functions @ functions.T
            explained = 1 - float(np.sum((rest - slow) ** 2) / np.sum(torque**2))
            return Turn(coefficients, weights, explained, (intrinsic, slow))

        none = np.zeros((ensemble.samples, before - first + 1))
        begun = Turn(start, none, details=(None, np.zeros_like(torque)))
        best = alternate(step, begun, MAX_TURNS, MIN_GAIN)
        details = {"turns": float(min(best.number + 1, MAX_TURNS))}  # the last turn did not help
        if self.slow_order is not None:
            details["vaf_with_slow"] = 100 * best.explained
        intrinsic = attrs.evolve(best.details[0], method=repr(self))
        unit = "N m/V" if self.emg else UNITS["reflex_gain"]
        return two_pathways(ensemble, intrinsic, drive, best, first, details, unit)


def two_pathways(
    ensemble: Ensemble,
    intrinsic: ImpulseResponseModel,
    drive: Drive,
    turn: Turn,
    first: int,
    details: dict[str, float],
    unit: str = UNITS["reflex_gain"],
) -> TwoPathwayModel:
    """Return the model of an intrinsic pathway and of a turn's reflex, without bands.

    The reflex's weights (time, lag) begin with the lag ``first``. The gain is their sum. A turn of
    several coefficients has a polynomial of the velocity as its drive.
    """
    reflex = turn.reflex
    if len(turn.coefficients) > 1:
        drive, slope = of_unit_slope(ensemble, turn.coefficients)
        reflex = reflex * slope
    rate, none = ensemble.sampling_rate, StandardError.none(ensemble.samples, NO_BAND)
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


def after_delay(method: Any, attribute: attrs.Attribute[Any], memory: float) -> None:
    """Validate that the reflex's memory is longer than its delay."""
    if method.delay is not None and method.delay >= memory:
        raise InputError(
            f"{type(method).__name__}: memory must be longer than the delay of {method.delay:g} s, "
            f"got {memory!r}"
        )


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
    kept = slice(ensemble.context - samples, ensemble.angle.shape[1] - ensemble.context + samples)
    signals = {name: getattr(ensemble, name)[:, kept] for name in ("angle", "torque")}
    return attrs.evolve(ensemble, **signals, channels={}, recorded_angle=None, context=samples)


def past_of(ensemble: Ensemble, signals: Array, before: int) -> Array:
    """Return signals with their past (signal, realization, before + time).

    Their mean over realizations is subtracted where the ensemble's is.
    """
    past = np.stack([history(ensemble, each, before) for each in signals])
    return past - [mean_known(each)[None] for each in past] if ensemble.mean_subtracted else past


def terms_of(ensemble: Ensemble, drive: Drive, degree: int) -> tuple[Array, Array]:
    """Return signals that make up a reflex's drive, and their initial coefficients.

    With a ``degree``, they are the terms of a polynomial of the velocity near the drive.
    """
    values = drive(ensemble)
    if not degree:
        return values[None], np.ones(1)
    terms = velocity_terms(ensemble, degree)
    solved = np.linalg.lstsq(terms.reshape(degree, -1).T, values.ravel(), rcond=None)[0]
    return terms, np.asarray(solved)


def constant_cascade(
    ensemble: Ensemble, lags: int, before: int, degree: int = 0
) -> tuple[Drive, Turn]:
    """Return the velocity of stretch that explains most torque of a constant joint, with its fit.

    With a ``degree``, the drive is a polynomial of the velocity that begins as that rectifier.
    """
    fits = []
    for drive in map(Stretch, (0.0, 0.0), DIRECTIONS):
        signals, start = terms_of(ensemble, drive, degree)
        moments = lagged_moments(list(_rows(ensemble, signals, lags, before)))
        fits.append((drive, parallel_cascade(moments, lags, start)))
    return max(fits, key=lambda fit: fit[1].explained)


def _rows(ensemble: Ensemble, signals: Array, lags: int, before: int) -> Iterator[Rows]:
    """Yield signals (1 + signal, realization, before + time) and torque with their known past.

    The first signal is the angle ``lags`` samples ahead, with at most 2 ``lags`` samples before.
    Realizations whose past begins at the same time are together.
    """
    short = max(0, lags - ensemble.context)
    past = past_of(ensemble, signals, before)
    ahead = np.pad(ensemble.angle, ((0, 0), (before, short)))[:, ensemble.context + lags :]
    together = np.concatenate([ahead[None, :, : past.shape[2]], past])
    last = ensemble.samples - short
    starts: NDArray[np.int64] = np.isnan(past[0]).sum(axis=1).clip(short)  # NaN come first
    for first in np.unique(starts[starts < last]):
        rows = starts == first
        torque = ensemble.torque[rows, ensemble.core][:, first:last]
        yield together[:, rows, first : before + last], torque
