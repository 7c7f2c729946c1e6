"""Methods that identify both pathways of a changing joint in turn."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.methods.base import Input, Method, whole_samples
from tvsysid.methods.cascade.drives import Candidate, constant_cascade, past_of
from tvsysid.methods.cascade.pathways import PATHWAYS, Measured, TwoPathwayModel, history
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.numerics.bases import ChebyshevPolynomials, evaluate
from tvsysid.numerics.hammerstein import last_better
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, window_moments
from tvsysid.signals import Array, Ensemble

Nonlinearity = Literal["rectifier", "polynomial"]

DEGREE = 5  # of the polynomial
MAX_TURNS = 30  # of either pathway
MIN_GAIN = 1e-5  # share of the torque's power by which a turn must improve the fit
MIN_REALIZATIONS = 3  # with their past: of fewer there is nothing to average over


class _Turn(NamedTuple):
    explained: float
    intrinsic: ImpulseResponseModel
    coefficients: Array
    weights: Array
    number: int


class AlternatingCascade(Method):
    """Identify each pathway in turn from the torque that the other pathway leaves.

    A subclass names the method that identifies the intrinsic pathway, and identifies the response
    of the reflex. Turns end when the explained torque hardly grows. In each turn, a polynomial's
    coefficients are fitted by least squares to the responses to its terms. With a ``slow_order``,
    a polynomial of time is fitted to the residual torque of each realization, and subtracted in
    the next turn. Realizations whose past is not recorded are left out.
    """

    max_lag: float
    memory: float
    nonlinearity: Nonlinearity
    emg: str | None = None
    slow_order: int | None = None

    quantities = ("reflex_gain",)
    pathway_names = PATHWAYS
    uses_recorded_angle = True

    @abstractmethod
    def _first_lag(self) -> float:
        """Return the first lag of the reflex's response in s."""

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
        drives = self._drives(ensemble)
        first = whole_samples(self._first_lag(), ensemble)
        best = last_better(self._turns(ensemble, drives, first), MIN_GAIN)
        drive, slope, direction = drives.scaled(ensemble, best.coefficients)
        details = {
            "turns": float(min(best.number + 1, MAX_TURNS)),  # the last turn did not help
            "direction": float(direction),
        }
        if self.slow_order is not None:
            details["vaf_with_slow"] = 100 * best.explained
        unit = "N m/V" if self.emg else UNITS["reflex_gain"]
        plain = attrs.evolve(best.intrinsic, method=repr(self))
        return TwoPathwayModel.beside(
            plain, ensemble, best.weights * slope, drive, first, details, unit
        )

    def _drives(self, ensemble: Ensemble) -> Candidate:
        if self.emg is not None:
            return Candidate.of(ensemble, Measured(self.emg))
        lags, before = (whole_samples(each, ensemble) for each in (self.max_lag, self.memory))
        rectifiers = Candidate.rectifiers(ensemble)
        rectifier, _ = constant_cascade(ensemble, rectifiers, lags, max(before, 2 * lags))
        if self.nonlinearity == "rectifier":
            return rectifier
        return rectifier.as_polynomial(ensemble, DEGREE)

    def _turns(self, ensemble: Ensemble, drives: Candidate, first: int) -> Iterator[_Turn]:
        lags, before = (whole_samples(each, ensemble) for each in (self.max_lag, self.memory))
        past = past_of(ensemble, drives.signals, before)[:, :, : before - first + ensemble.samples]
        known = ~np.isnan(past[0]).any(axis=1)
        past, part = past[:, known], _with_context(ensemble.select(known), lags)
        torque = part.torque[:, part.core]
        reflex, slow, coefficients = np.zeros_like(torque), np.zeros_like(torque), drives.start
        for number in range(1, MAX_TURNS + 1):
            left = part.torque.copy()
            left[:, part.core] -= reflex + slow
            intrinsic = self._intrinsic(ensemble).fit(attrs.evolve(part, torque=left))
            assert isinstance(intrinsic, ImpulseResponseModel)
            beyond = torque - intrinsic.predict(part)
            drive = np.tensordot(coefficients, past, 1)
            weights = self._response(drive, beyond - slow, ensemble)
            if len(coefficients) > 1:
                terms = np.stack([convolve_lags(each, weights).ravel() for each in past])
                solved = np.linalg.solve(terms @ terms.T, terms @ (beyond - slow).ravel())
                coefficients = np.asarray(solved / np.linalg.norm(solved))
                drive = np.tensordot(coefficients, past, 1)
                weights = self._response(drive, beyond - slow, ensemble)
            reflex = convolve_lags(drive, weights)
            if self.slow_order is not None:
                slow = _slow_part(beyond - reflex, self.slow_order)
            explained = 1 - float(np.sum((beyond - reflex - slow) ** 2) / np.sum(torque**2))
            yield _Turn(explained, intrinsic, coefficients, weights, number)


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


def _slow_part(torque: Array, order: int) -> Array:
    """Return the polynomial of time in each realization."""
    functions = np.linalg.qr(evaluate(ChebyshevPolynomials(order + 1), torque.shape[1]))[0]
    return np.asarray(torque @ functions @ functions.T)


def _with_context(ensemble: Ensemble, samples: int) -> Ensemble:
    """Return an ensemble with less context: the reflex's torque there is not known."""
    kept = slice(ensemble.context - samples, ensemble.angle.shape[1] - ensemble.context + samples)
    return attrs.evolve(
        ensemble,
        angle=ensemble.angle[:, kept],
        torque=ensemble.torque[:, kept],
        channels={},
        recorded_angle=None,
        context=samples,
    )
