"""Base class of methods: checks before the fit, warnings and timing after it."""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from time import perf_counter
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    Literal,
    NamedTuple,
    Self,
    TypeVar,
)

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DataQualityWarning, InputError, describe_error, plain_text
from tvsysid.methods.cascade.reflex_test import changes
from tvsysid.models import Model
from tvsysid.numerics.threads import single_thread
from tvsysid.showing import summary_html
from tvsysid.signals import Ensemble
from tvsysid.validators import at_least, one_of, positive, with_settings

if TYPE_CHECKING:
    from tvsysid.methods.tuning.evidence import Evidence

Number = TypeVar("Number", np.float64, np.complex128)
Chosen = TypeVar("Chosen", bound="Method")
MOST_VALUES = 100_000  # of a variable of a method's own
NOTHING = 1e-12  # share of the largest value that is rounding
Kind = Literal["input", "reference", "scheduling"]

MIN_AGREEMENT = (
    95.0  # second-order agreement in % of a joint of second order; simulated ones have 99
)
CERTAIN = 2.0  # standard errors by which it must lie lower


@attrs.frozen
class Input:
    """A signal that a method needs beside angle and torque: a channel, and the unit in which the method takes it.

    Of the kinds, ``"input"`` acts on the joint, as EMG that drives a reflex; ``"reference"`` is
    the disturbance that the experimenter applied, in closed loop; both lose their mean with the
    angle. ``"scheduling"`` is a measured variable that the joint's properties depend on; it
    keeps its mean.
    """

    name: str
    kind: Kind = attrs.field(validator=one_of(Kind))
    unit: str


class Choice(NamedTuple, Generic[Chosen]):
    """A ``method`` whose settings were chosen from data, and the ``evidence`` for them."""

    method: Chosen
    evidence: Evidence

    def _repr_html_(self) -> str:
        return summary_html("Choice", f"{self.method!r}: {self.evidence}")


class Method(ABC):
    """Settings of a method, in seconds and hertz, and one verb.

    A class of your own needs no base class: anything with ``identify(ensemble)`` that returns a
    model is a method. This one adds the checks, the warnings and the timing.
    """

    key: ClassVar[str]
    title: ClassVar[str]
    assumptions: ClassVar[tuple[str, ...]]
    differs: ClassVar[str] = (
        ""  # why its stiffness differs from the true one and from other methods', in a sentence
    )
    cites: ClassVar[
        tuple[str, ...]
    ] = ()  # keys of tvsysid.methods.references; none of a method that is our own
    inputs: ClassVar[
        tuple[Input, ...]
    ] = ()  # signals that it needs beside angle and torque; channels of the ensemble
    contiguous: ClassVar[bool] = (
        False  # whether it needs realizations that follow each other in the record
    )
    time_invariant: ClassVar[bool] = False  # whether it takes the joint as constant
    uses_recorded_angle: ClassVar[bool] = (
        False  # whether it uses the angle at the rate at which it was recorded
    )
    # The only kinds of perturbation and of simulated joint that it serves, by names and settings as
    # a study takes them;
    # any, where these are empty.
    perturbation: ClassVar[str] = ""
    system: ClassVar[str] = ""

    def identify(self, ensemble: Ensemble) -> Model:
        """Identify the impedance of the joint from realizations of one repeated behaviour, mean subtracted.

        The model is immutable; its ``time, stiffness, viscosity, inertia`` are of shape (time,),
        with NaN where not identified.

        Raises
        ------
        InputError
            If the settings do not fit the ensemble.

        Warns
        -----
        DataQualityWarning
            If the method's model does not fit the joint; kept in the model's diagnostics.
            Faults of the data are found by :func:`tvsysid.diagnose`.
        """
        started = perf_counter()
        with single_thread():
            _check_ensemble(self, "identify", ensemble)  # whether it can serve it may take BLAS
            model = self._identify(ensemble)
            texts = (
                *model.diagnostics.warnings,
                *self._own_warnings(ensemble),
                *_fit_warnings(self, ensemble, model),
            )
        details = {**model.diagnostics.details, **aligned(ensemble)}
        diagnostics = attrs.evolve(
            model.diagnostics, warnings=texts, seconds=perf_counter() - started, details=details
        )
        for text in texts:
            warnings.warn(f"{self.key}: {text}", DataQualityWarning, stacklevel=2)
        return attrs.evolve(model, diagnostics=diagnostics)

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Identify a part of the realizations that a model was identified from, as held-out prediction does.

        A method that searches starts from what the model found instead; others ignore it.
        """
        with single_thread():
            return self._refit(ensemble, model)

    def _refit(self, ensemble: Ensemble, model: Model) -> Model:
        return self.identify(ensemble)

    def skip(self, ensemble: Ensemble) -> str | None:
        """Why the method cannot serve this ensemble, in words; None if it can."""
        return None

    def tuned(self, ensemble: Ensemble, seed: int = 0) -> Choice[Self]:
        """Choose settings by realizations to be identified from, or others alike.

        Their mean subtracted.

        Returns the ``method``, of the same class, with the settings chosen, and the ``evidence``:
        what was tried, and how each did. The same seed gives the same settings.

        Raises
        ------
        InputError
            If the ensemble is none, or has too few realizations or samples, or for a seed that is
            none.
        """
        _check_ensemble(self, "tuned", ensemble)
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise InputError(f"tuned: seed must be a whole number of 0 or more, got {seed!r}")
        with single_thread():
            evidence = self._evidence(ensemble, seed)
        return Choice(with_settings(self, **evidence.settings), evidence)

    @abstractmethod
    def _identify(self, ensemble: Ensemble) -> Model: ...

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        """What speaks for which settings."""
        raise InputError(f"{type(self).__name__} has no settings that can be chosen from data")

    def _own_warnings(self, ensemble: Ensemble) -> Iterator[str]:
        yield from ()


class SkippedError(InputError):
    """A method cannot serve an ensemble; the message is the reason."""


def said_by(method: object, attribute: str, expected: str, *kinds: type) -> Any:
    """What a method says of itself in an attribute, of one of these kinds.

    An empty one of the first if nothing.
    """
    try:
        said = getattr(method, attribute, None)
        said = kinds[0]() if said is None else said
        fits = isinstance(said, kinds)
    except Exception as error:  # a property, which is anybody's code
        raise InputError(
            f"{type(method).__name__}: {attribute} cannot be read: {describe_error(error)}"
        ) from error
    if not fits:
        raise InputError(
            f"{type(method).__name__}: {attribute} must be {expected}, got {plain_text(said)}"
        )
    return said


def names_said(method: object, attribute: str) -> Any:
    """Names that a method says it finds, or units by name."""
    return said_by(method, attribute, "names in a tuple, or units by name", tuple, list, Mapping)


def scheduled_by(method: object) -> Mapping[str, int]:
    """What a method says that it estimates over a variable of its own, and at how many values at most."""
    expected = (
        f"numbers of values from 1 to {MOST_VALUES} by name, as in {{'stiffness_at_emg': 20}}"
    )
    said: Mapping[str, int] = said_by(method, "scheduled_quantities", expected, dict, Mapping)
    if wrong := [
        most for most in said.values() if type(most) is not int or not 1 <= most <= MOST_VALUES
    ]:
        raise InputError(
            f"{type(method).__name__}: scheduled_quantities must be {expected}, got {wrong[0]!r}"
        )
    return said


def inputs_of(method: object) -> tuple[Input, ...]:
    """Signals that a method needs beside angle and torque."""
    expected = "a tuple of tvsysid.methods.Input (with a comma after a single one)"
    inputs = said_by(method, "inputs", expected, tuple, list)
    if wrong := [item for item in inputs if not isinstance(item, Input)]:
        raise InputError(
            f"{type(method).__name__}: inputs must be {expected}, got {plain_text(wrong[0])} in it"
        )
    return tuple(inputs)


def special(method: object, what: Literal["perturbation", "system"]) -> str:
    """Name of the only kind of perturbation or system that a method says it serves.

    Empty if it serves any.
    """
    return str(said_by(method, what, f"the name of a {what}, with settings if need be", str))


def reason_to_skip(method: object, ensemble: Ensemble) -> str | None:
    """Why a method cannot serve an ensemble, in words; None if it can."""
    missing = [item for item in inputs_of(method) if item.name not in ensemble.channels]
    if missing:
        needed = ", ".join(f"{item.name!r} ({item.kind}, {item.unit})" for item in missing)
        there = ", ".join(map(repr, ensemble.channels)) or "no further channel"
        return (
            f"it needs the channel {needed}, the ensemble has {there}; read it as a further "
            "channel (--channel NAME=…; "
            "for an experiment under [reading.channels])"
        )
    skip = getattr(method, "skip", None)
    reason = skip(ensemble) if callable(skip) else None
    if reason and not isinstance(reason, str):
        raise InputError(
            f"{type(method).__name__}: skip must return a reason in words, or None; got "
            f"{type(reason)}"
        )
    return reason or None


def aligned(ensemble: Ensemble) -> dict[str, float]:
    """Delay between the channels that was corrected before, in s, for a model's diagnostics.

    Nothing if none was.
    """
    return {"delay_removed": ensemble.delay_removed} if ensemble.delay_removed else {}


def _check_ensemble(method: Method, verb: str, ensemble: object) -> None:
    if not isinstance(ensemble, Ensemble):
        raise InputError(
            f"{verb}: expected an Ensemble, got {type(ensemble).__name__}; "
            "cut a Recording with tvsysid.preprocess.segment"
        )
    for name in ("angle", "torque"):
        values = np.abs(ensemble.signal(name))
        if values[:, ensemble.core].max() <= NOTHING * values.max():
            raise InputError(
                f"{verb}: the {name} is 0 in all realizations, their context aside; cut others, "
                "or is this the right "
                "channel?"
            )
    if reason := reason_to_skip(method, ensemble):
        raise InputError(f"{type(method).__name__}: {reason}")


def whole_samples(seconds: float, ensemble: Ensemble) -> int:
    """Nearest number of samples."""
    return round(seconds * ensemble.sampling_rate)


def fitting_lags(name: str, max_lag: float, ensemble: Ensemble) -> int:
    """Lags to either side in samples, if a realization with its context is long enough for them."""
    lags = whole_samples(max_lag, ensemble)
    if lags < 1:
        raise InputError(
            f"{name}: max_lag {max_lag:g} s is less than one sample at {ensemble.sampling_rate:g} "
            "Hz; "
            f"give at least {1 / ensemble.sampling_rate:g} s"
        )
    check_window(f"{name}: lags of ±{max_lag:g} s", 2 * lags + 1, ensemble)
    return lags


def check_window(what: str, samples: int, ensemble: Ensemble) -> None:
    """Raise where no sample of a realization has a whole window about it."""
    if (
        missing_edge(samples // 2, ensemble) * 2 >= ensemble.samples
        or samples > ensemble.angle.shape[1]
    ):
        raise InputError(
            f"{what} need {samples} samples, a realization has {ensemble.samples} with "
            f"{ensemble.context} of "
            "context on either side; give shorter ones, or longer realizations or context"
        )


def missing_edge(reach: int, ensemble: Ensemble) -> int:
    """Samples at either end of a realization from which a window would reach beyond its context."""
    return max(0, reach - ensemble.context)


def padded(values: NDArray[Number], early: int, late: int | None = None) -> NDArray[Number]:
    """Array with rows of NaN added at the ends of its first axis.

    As many late ones as early ones by default.
    """
    late = early if late is None else late
    if early == late == 0:
        return values
    edges = [(early, late)] + [(0, 0)] * (values.ndim - 1)
    return np.pad(values, edges, constant_values=np.nan)


def check_positive(method: object, **settings: object) -> None:
    """Raise for a setting that is not a positive finite number."""
    for name, value in settings.items():
        positive.check(type(method).__name__, name, value)


def check_whole(method: object, least: int, **settings: object) -> None:
    """Raise for a setting that is not a whole number from ``least`` on."""
    for name, value in settings.items():
        at_least(least).check(type(method).__name__, name, value)


def check_choice(method: object, name: str, allowed: object) -> None:
    """Raise for a setting that is none of a Literal's values."""
    one_of(allowed).check(type(method).__name__, name, getattr(method, name))


def _fit_warnings(method: Method, ensemble: Ensemble, model: Model) -> Iterator[str]:
    """Yield why the method's model of a joint does not fit this one."""
    details = model.diagnostics.details
    agreement = details.get("second_order_agreement", math.nan)
    error = details.get("second_order_agreement_error", 0.0)
    if agreement + CERTAIN * error < MIN_AGREEMENT:
        yield (
            f"inertia, viscosity and stiffness explain only {agreement:.0f} % of the torque that "
            "depends on the angle: the joint is not of second order, so viscosity and inertia "
            "mean nothing; look at the impulse response (eirf, sds; in models.nc, in Python "
            "model.impulse_response)"
        )
    if method.time_invariant and changes(ensemble):
        yield (
            "stiffness or viscosity change over a realization (p < 0.0001), but this method takes "
            "the joint as constant and finds a mean; use a method that follows changes"
        )
