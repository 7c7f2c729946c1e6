"""Define the base class of methods, and check that windows fit into realizations."""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods.cascade.reflex_test import is_time_varying
from tvsysid.models import Model
from tvsysid.numerics.threads import single_thread
from tvsysid.signals import Ensemble, check_ensemble
from tvsysid.validators import one_of, with_settings

if TYPE_CHECKING:
    from tvsysid.methods.tuning import Evidence

# A signal is 0 if its peak without context is at most this share of the whole peak.
ROUNDING = 1e-12
Kind = Literal["input", "reference", "scheduling"]

# Share of the angle-dependent torque that a joint of order 2 explains; simulated joints have 99 %.
MIN_AGREEMENT_PERCENT = 95.0


@attrs.frozen
class Input:
    """A channel that a method reads beside angle and torque.

    Parameters
    ----------
    name
        Name of the channel.
    kind
        ``"input"`` acts on the joint, such as EMG that drives a reflex. ``"reference"`` is the
        disturbance that the experimenter applied, in closed loop. The mean over realizations is
        subtracted from both. ``"scheduling"`` is a measured variable on which the joint's
        properties depend; it keeps its mean.
    unit
        Unit in which the method expects the channel.
    """

    name: str
    kind: Kind = attrs.field(validator=one_of(Kind))
    unit: str


class Choice(NamedTuple):
    """Method with settings that were chosen from data, and the evidence for them."""

    method: Method
    evidence: Evidence


class Method(ABC):
    """Base class of methods. A subclass has settings as fields, and implements :meth:`fit`.

    Every attribute of the class has a default.

    Attributes
    ----------
    key, title
        Names on the command line and on pages. By default, the name of the class.
    assumptions
        Assumptions about joint and data, in sentences.
    differs
        Why its stiffness differs from the true stiffness and from that of other methods, in a
        sentence.
    cites
        Keys of ``references.bib``.
    inputs
        Channels that the method reads in addition to angle and torque.
    quantities
        Names of quantities that it always estimates in addition to stiffness, viscosity and
        inertia.
    pathway_names
        Pathways of its models, if there are several.
    contiguous
        Whether realizations must follow each other in the recording.
    time_invariant
        Whether the method assumes a constant joint.
    perturbation, system
        The only perturbation and simulated joint that the method supports, by their names in a
        study. Empty if it supports all.
    can_be_tuned
        Whether settings can be chosen from data. A subclass that can choose its settings sets it.

    Examples
    --------
    >>> import tvsysid as tv
    >>> class Rigid(tv.Method):
    ...     def fit(self, ensemble):
    ...         return tv.Model.of(ensemble, stiffness=100.0)
    >>> Rigid().key
    'rigid'
    """

    key: ClassVar[str]
    title: ClassVar[str]
    assumptions: ClassVar[tuple[str, ...]] = ()
    differs: ClassVar[str] = ""
    cites: ClassVar[tuple[str, ...]] = ()
    inputs: ClassVar[tuple[Input, ...]] = ()
    quantities: ClassVar[tuple[str, ...]] = ()
    pathway_names: ClassVar[tuple[str, ...]] = ()
    contiguous: ClassVar[bool] = False
    time_invariant: ClassVar[bool] = False
    perturbation: ClassVar[str] = ""
    system: ClassVar[str] = ""
    can_be_tuned: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        cls.key = vars(cls).get("key", cls.__name__.lower())
        cls.title = vars(cls).get("title", cls.__name__)

    def __repr__(self) -> str:
        return type(self).__name__

    @abstractmethod
    def fit(self, ensemble: Ensemble) -> Model:
        """Return the model of an ensemble of read-only arrays with zero mean over realizations."""

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return the reason why the method cannot identify an ensemble, or None if it can."""
        return None

    def identify(self, ensemble: Ensemble) -> Model:
        """Identify the impedance of the joint from realizations whose mean was subtracted before.

        The ensemble is checked before :meth:`fit`, and the model after it. The model is immutable.
        Its ``time``, ``stiffness``, ``viscosity`` and ``inertia`` are of shape (time,), with NaN
        where not identified.

        Raises
        ------
        InputError
            If the settings do not fit the ensemble, or :meth:`fit` returns no model of it.

        Warns
        -----
        DataQualityWarning
            If the joint violates an assumption of the method. The model's diagnostics hold the
            texts too. :func:`tvsysid.diagnose` finds faults of the data.
        """
        started = perf_counter()
        with single_thread():
            _check_ensemble(self, "identify", ensemble)
            model = self.fit(ensemble)
            _check_model(self, model, ensemble)
            texts = (
                *model.diagnostics.warnings,
                *self._own_warnings(ensemble, model),
                *_violated_assumptions(self, ensemble, model),
            )
        details = dict(model.diagnostics.details)
        if ensemble.delay_removed:
            details["delay_removed"] = ensemble.delay_removed
        diagnostics = attrs.evolve(
            model.diagnostics, warnings=texts, seconds=perf_counter() - started, details=details
        )
        for text in texts:
            warnings.warn(f"{self.key}: {text}", DataQualityWarning, stacklevel=2)
        return attrs.evolve(model, method=model.method or repr(self), diagnostics=diagnostics)

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Identify some of the realizations from which ``model`` was identified.

        A method that searches starts from the model's results. Other methods ignore the model.
        """
        return self.identify(ensemble)

    def tuned(self, ensemble: Ensemble) -> Choice:
        """Choose settings from the realizations, whose mean is subtracted.

        Return the method with these settings, and the evidence: the settings that were tried, with
        the score of each.

        Raises
        ------
        InputError
            If the ensemble has too few samples, or the method has no settings that can be chosen.
        """
        _check_ensemble(self, "tuned", ensemble)
        with single_thread():
            evidence = self._evidence(ensemble)
        return Choice(with_settings(self, **evidence.settings), evidence)

    def _evidence(self, ensemble: Ensemble) -> Evidence:
        """Return the settings that were tried, with their scores."""
        raise InputError(f"{type(self).__name__} has no settings that can be chosen from data")

    def _own_warnings(self, ensemble: Ensemble, model: Model) -> Iterator[str]:
        """Yield warnings about the settings for an ensemble, or about its model."""
        yield from ()


def reason_to_skip(method: Method, ensemble: Ensemble) -> str | None:
    """Return why a method cannot identify an ensemble: a missing channel, or ``method.skip``."""
    missing = [item for item in method.inputs if item.name not in ensemble.channels]
    if missing:
        needed = ", ".join(f"{item.name!r} ({item.kind}, {item.unit})" for item in missing)
        return (
            f"it needs the channel {needed}; read it as a further channel (--channel NAME=…; for "
            "an experiment under [reading.channels])"
        )
    return method.skip(ensemble)


def centered_channels(methods: Iterable[Method]) -> tuple[str, ...]:
    """Return the channels whose mean is subtracted: inputs and references."""
    every = [item for method in methods for item in method.inputs]
    return tuple(dict.fromkeys(item.name for item in every if item.kind != "scheduling"))


def _check_ensemble(method: Method, verb: str, ensemble: Ensemble) -> None:
    """Raise if the object is not an ensemble, its signals are 0, or the method skips it."""
    check_ensemble(verb, ensemble)
    for name in ("angle", "torque"):
        values = np.abs(ensemble.signal(name))
        if values[:, ensemble.core].max() <= ROUNDING * values.max():
            raise InputError(
                f"{verb}: the {name} is 0 in all realizations without their context; cut other "
                "realizations, or name another channel"
            )
    if reason := reason_to_skip(method, ensemble):
        raise InputError(f"{type(method).__name__}: {reason}")


def _check_model(method: Method, model: object, ensemble: Ensemble) -> None:
    """Raise if the object is not a model, or its estimates do not have the ensemble's shape."""
    name = type(method).__name__
    if not isinstance(model, Model):
        raise InputError(
            f"{name}: fit returned an object of type {type(model).__name__}; return "
            "tvsysid.Model.of(ensemble, stiffness, viscosity, inertia)"
        )
    lengths = {"realization": len(ensemble), "time": ensemble.samples}
    lengths |= {axis: len(values) for axis, values in model.coordinates.items()}
    for quantity, estimate in model.estimates.items():
        expected = tuple(lengths.get(axis, 0) for axis in estimate.axes)
        if estimate.values.shape != expected:
            unknown = [axis for axis in estimate.axes if axis not in lengths]
            missing = f"; coordinates of {', '.join(unknown)} are missing" if unknown else ""
            raise InputError(
                f"{name}: {quantity} over {', '.join(estimate.axes)} must be of shape {expected}, "
                f"it is {estimate.values.shape}{missing}"
            )


def whole_samples(seconds: float, ensemble: Ensemble) -> int:
    """Return the nearest number of samples to a duration in s."""
    return round(seconds * ensemble.sampling_rate)


def fitting_lags(name: str, max_lag: float, ensemble: Ensemble) -> int:
    """Return the number of lags on either side. Raise if a realization is too short for them."""
    lags = whole_samples(max_lag, ensemble)
    if lags < 1:
        raise InputError(
            f"{name}: max_lag {max_lag:g} s is less than one sample at {ensemble.sampling_rate:g} "
            f"Hz; give at least {1 / ensemble.sampling_rate:g} s"
        )
    check_window(f"{name}: lags of ±{max_lag:g} s", 2 * lags + 1, ensemble)
    return lags


def check_window(what: str, samples: int, ensemble: Ensemble) -> None:
    """Raise if no sample of a realization has a whole window around it."""
    if missing_edge(samples // 2, ensemble) * 2 >= ensemble.samples:
        raise InputError(
            f"{what} need {samples} samples, a realization has {ensemble.samples} with "
            f"{ensemble.context} of context on either side; shorten the lags or the window, or "
            "cut longer realizations or more context"
        )


def missing_edge(reach: int, ensemble: Ensemble) -> int:
    """Return how many samples at either end of a realization lack a whole window."""
    return max(0, reach - ensemble.context)


def padded(values: NDArray[Any], early: int, late: int | None = None) -> NDArray[Any]:
    """Add rows of NaN at the ends of the first axis, by default as many late as early ones."""
    edges = [(early, early if late is None else late)] + [(0, 0)] * (values.ndim - 1)
    return np.pad(values, edges, constant_values=np.nan)


def _violated_assumptions(method: Method, ensemble: Ensemble, model: Model) -> Iterator[str]:
    """Yield a warning for each assumption of the method that the joint violates."""
    details = model.diagnostics.details
    agreement = details.get("second_order_agreement", math.nan)
    if agreement < MIN_AGREEMENT_PERCENT:
        yield (
            f"inertia, viscosity and stiffness explain only {agreement:.0f} % of the torque that "
            "depends on the angle: the joint is not of second order, so viscosity and inertia have "
            "no meaning; look at the impulse response (eirf, sds; in models.nc, in Python "
            "model.impulse_response)"
        )
    if method.time_invariant and is_time_varying(ensemble):
        yield (
            "stiffness or viscosity change over a realization (p < 0.0001), but this method "
            "assumes a constant joint and estimates a mean; use a method that follows changes"
        )
