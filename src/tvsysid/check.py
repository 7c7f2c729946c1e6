"""What every method must do, as checks that anybody's method can be put to."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import cloudpickle
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tvsysid import metrics
from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Ensemble
from tvsysid.simulate import Constant, FilteredNoise, Joint, Profile, SineWave

Array = NDArray[np.float64]

LEVEL = 100.0
"""Stiffness of the constant joint in N·m/rad."""
SNR = 30.0
"""Signal-to-noise ratio of the simulated torque in dB."""


@dataclass(frozen=True)
class Check:
    """One thing that is expected of a method.

    Parameters
    ----------
    name
        What is expected, in a few words.
    passed
        Whether it is so; False too where the check was not reached.
    message
        What came; if it did not pass, what was expected and what to do.
    required
        False for advice: a method may have reasons not to follow it.
    """

    name: str
    passed: bool
    message: str
    required: bool = True


def check_method(method: Any) -> list[Check]:
    """Put a method to everything that is expected of it.

    It identifies simulated joints of known stiffness. Nothing is raised, whatever the method does.

    Parameters
    ----------
    method
        An object with ``identify(ensemble)``.

    Returns
    -------
    list of Check
        All checks in their order. One whose foundation did not pass is reported as not reached.

    Examples
    --------
    >>> from tvsysid.methods import create
    >>> all(check.passed for check in check_method(create("sds")))
    True
    >>> check_method("sds")[0].message
    'expected an object with identify(ensemble), got an object of type str; tvsysid.methods.parse makes a method of a
    text'
    """
    subject = _Subject(method)
    done: dict[str, Check] = {}
    with threadpool_limits(1):  # small matrices: BLAS threads would only wait for each other
        for rule in RULES:
            done[rule.name] = _judged(rule, subject, done)
    return list(done.values())


class _FailedError(Exception):
    """A check failed; the message says how."""


class _NotReachedError(Exception):
    """A check cannot be judged; the message says why."""


class _Joint(NamedTuple):
    """A simulated joint and the truth about it."""

    ensemble: Ensemble
    noiseless_torque: Array
    stiffness: Array


@cache
def _joint(name: str) -> _Joint:
    """Joint by name; the same one for every method."""
    if name == "other rate without context":
        whole = _joint("other rate")
        core = whole.ensemble.core
        angle, torque = whole.ensemble.angle[:, core], whole.ensemble.torque[:, core]
        return whole._replace(ensemble=Ensemble(angle, torque, whole.ensemble.sampling_rate))
    settings: dict[str, tuple[float, Profile, float, float, int]] = {
        "constant": (150.0, Constant(LEVEL), 100.0, 2.0, 1),
        "changing": (150.0, SineWave(), 100.0, 2.0, 2),
        "unseen": (40.0, Constant(LEVEL), 100.0, 2.0, 3),
        "other rate": (120.0, SineWave(period=1.5), 128.0, 1.5, 4),
    }
    duration, profile, rate, period, seed = settings[name]
    simulation = Joint(stiffness=profile).simulate(
        duration, perturbation=FilteredNoise(), snr_db=SNR, seed=seed, rate=8 * rate
    )
    ensemble = segment(decimate(simulation.recording, rate), period)
    noiseless = segment(decimate(simulation.noiseless, rate), period)
    return _Joint(ensemble, noiseless.torque[:, noiseless.core], np.asarray(profile(ensemble.time)))


class _Subject:
    """A method, and what it has identified so far."""

    def __init__(self, method: Any) -> None:
        self.method = method
        self.models: dict[str, Any] = {}
        self.first = np.empty(0)
        self.warned: dict[str, None] = {}

    @property
    def file(self) -> str | None:
        """File in which identify is written."""
        code = getattr(getattr(self.method, "identify", None), "__code__", None)
        return None if code is None else str(code.co_filename)

    def identify(self, ensemble: Ensemble) -> Any:
        with self._listening():
            return self.method.identify(ensemble)

    def model(self, name: str) -> Any:
        """Model of the joint of this name, identified once."""
        if name not in self.models:
            self.models[name] = self.identify(_joint(name).ensemble)
        return self.models[name]

    def predict(self, model: Any, ensemble: Ensemble) -> Array:
        """Torque that a model predicts, if it is one, shape (realization, time)."""
        with self._listening():
            values = np.asarray(model.predict(ensemble))
        return _numbers("predict(ensemble)", values, (len(ensemble), ensemble.samples), ensemble)

    @contextmanager
    def _listening(self) -> Iterator[None]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
        for item in caught:
            if not issubclass(item.category, DataQualityWarning):
                self.warned[f"{item.category.__name__}: {item.message}"] = None


def _stiffness(model: Any, ensemble: Ensemble) -> Array:
    """Stiffness of a model, if it is one, shape (time,)."""
    values = np.asarray(model.stiffness)
    return _numbers("stiffness", values, (ensemble.samples,), ensemble)


def _numbers(what: str, values: NDArray[Any], shape: tuple[int, ...], ensemble: Ensemble) -> Array:
    axes = "(time,)" if len(shape) == 1 else "(realization, time)"
    if values.shape != shape:
        advice = ""
        if ensemble.context and values.shape[-1:] == ensemble.angle.shape[1:]:
            advice = "; this counts the context on both sides too: take only the samples of ensemble.core"
        raise _FailedError(f"expected {what} of shape {axes} = {shape}, got {values.shape}{advice}")
    if values.dtype.kind != "f":
        raise _FailedError(
            f"expected {what} as real floating-point numbers, got {values.dtype}; np.asarray(values, dtype=float) "
            "converts what is real"
        )
    if np.isinf(values).any():
        raise _FailedError(f"{what} holds infinite values; give NaN where nothing can be said")
    return np.asarray(values, dtype=np.float64)


def _mostly_known(what: str, values: Array) -> None:
    share = float(np.mean(np.isfinite(values)))
    if share < 0.5:
        raise _FailedError(
            f"{what} is NaN at {100 * (1 - share):.0f} % of the samples; expected numbers at most of them"
        )


def _has_identify(subject: _Subject) -> str:
    method = subject.method
    if isinstance(method, type):
        raise _FailedError(f"expected an object, got the class {method.__name__} itself; give {method.__name__}()")
    if not callable(getattr(method, "identify", None)):
        advice = "; tvsysid.methods.parse makes a method of a text" if isinstance(method, str) else ""
        raise _FailedError(
            f"expected an object with identify(ensemble), got an object of type {type(method).__name__}{advice}"
        )
    return "it does"


def _untouched(subject: _Subject) -> str:
    ensemble = _joint("constant").ensemble
    copies = ensemble.angle.copy(), ensemble.torque.copy()
    try:
        subject.model("constant")
    except (Exception, SystemExit) as error:
        if _wrote(error):
            raise
        raise _NotReachedError("identify stopped before its end") from error
    if not all(map(np.array_equal, copies, (ensemble.angle, ensemble.torque))):
        _joint.cache_clear()
        raise _FailedError("identify changed the ensemble, which all methods share; work on ensemble.angle.copy()")
    return "angle and torque are as they were"


def _identifies(subject: _Subject) -> str:
    try:
        subject.model("constant")
    except (Exception, SystemExit) as error:
        if _wrote(error):
            raise _NotReachedError("identify writes to the ensemble") from error
        raise
    return f"it identifies {_joint('constant').ensemble!r}"


def _returns_model(subject: _Subject) -> str:
    model, ensemble = subject.model("constant"), _joint("constant").ensemble
    if model is None:
        raise _FailedError("identify returned None; end it by returning a model")
    missing = [
        what
        for what, there in (
            ("stiffness", hasattr(model, "stiffness")),
            ("predict(ensemble)", callable(getattr(model, "predict", None))),
        )
        if not there
    ]
    if missing:
        raise _FailedError(
            "expected a model with stiffness and predict(ensemble), "
            f"got an object of type {type(model).__name__} without {' and '.join(missing)}"
        )
    stiffness, torque = _stiffness(model, ensemble), subject.predict(model, ensemble)
    for what, values in (("stiffness", stiffness), ("predict(ensemble)", torque)):
        _mostly_known(what, values)
    subject.first = stiffness.copy()
    return f"stiffness of shape {stiffness.shape}, predict(ensemble) of shape {torque.shape}"


def _recovers_constant(subject: _Subject) -> str:
    mean = float(np.nanmean(subject.first))
    came = f"{mean:.3g} N·m/rad in the mean, where {LEVEL:g} is true"
    if mean < 0:
        raise _FailedError(f"{came}: the sign is reversed; torque is positive where it resists a positive angle")
    if abs(mean - LEVEL) > 0.1 * LEVEL:
        raise _FailedError(f"{came}; expected at most 10 % off. Are the units rad and N·m?")
    return came


def _predicts(subject: _Subject) -> str:
    model = subject.model("constant")
    shares = {}
    for name in ("constant", "unseen"):
        simulated = _joint(name)
        shares[name] = _vaf(simulated.noiseless_torque, subject.predict(model, simulated.ensemble))
    came = f"VAF {shares['constant']:.1f} % of the noiseless torque, {shares['unseen']:.1f} % in data it has not seen"
    if not min(shares.values()) > 80:
        raise _FailedError(
            f"{came}; expected more than 80 %. Does predict count viscosity and inertia, and is it aligned in time?"
        )
    return came


def _follows_change(subject: _Subject) -> str:
    simulated = _joint("changing")
    stiffness, truth = _stiffness(subject.model("changing"), simulated.ensemble), simulated.stiffness
    known = np.isfinite(stiffness)
    _mostly_known("stiffness", stiffness)
    error = float(np.sqrt(np.mean((stiffness[known] - truth[known]) ** 2)))
    guess = float(np.std(truth[known]))
    varies = np.ptp(stiffness[known]) > 0
    correlation = float(np.corrcoef(stiffness[known], truth[known])[0, 1]) if varies else 0.0
    came = f"correlation {correlation:.2f} with a sine of ±50 N·m/rad, error {error:.1f} N·m/rad RMS"
    if not (correlation > 0.8 and error < guess):
        raise _FailedError(
            f"{came}; expected more than 0.8, and less than the {guess:.1f} of a constant guess. A method that takes "
            "stiffness as constant can be compared, but will not do well"
        )
    return came


def _repeats(subject: _Subject) -> str:
    ensemble = _joint("constant").ensemble
    subject.model("changing")
    if not _same(_stiffness(subject.model("constant"), ensemble), subject.first):
        raise _FailedError(
            "the stiffness of the first model changed when identify was called again; return a new object each time"
        )
    again = _stiffness(subject.identify(ensemble), ensemble)
    if not _same(again, subject.first):
        raise _FailedError(
            f"the same data gave other numbers, up to {_largest_difference(again, subject.first):.2g} N·m/rad off; "
            "give random numbers a fixed seed, and keep nothing from one call to the next"
        )
    return "the same data gave the same numbers, after other data too"


def _travels(subject: _Subject) -> str:
    ensemble = _joint("constant").ensemble
    try:
        copy = cloudpickle.loads(cloudpickle.dumps(subject.method))
    except Exception as error:
        raise _FailedError(
            "expected a method that cloudpickle can send to a worker process, got "
            f"{describe_error(error, subject.file)}; hold no open file, lock or generator in it"
        ) from error
    there = _stiffness(_Subject(copy).identify(ensemble), ensemble)
    if not _same(there, subject.first):
        raise _FailedError("its copy gave other numbers; keep all settings in the object itself")
    return "its copy gave the same numbers"


def _scales(subject: _Subject) -> str:
    ensemble = _joint("constant").ensemble
    tenfold = replace(ensemble, torque=10 * ensemble.torque)
    ratio = float(np.nanmean(_stiffness(subject.identify(tenfold), ensemble)) / np.nanmean(subject.first))
    came = f"ten times the torque gave {ratio:.3g} times the stiffness"
    if not abs(ratio - 10) < 0.5:
        raise _FailedError(f"{came}; expected 10. Does a threshold or a prior hold for one size of torque only?")
    return came


def _other_rate(subject: _Subject) -> str:
    return _at_other_rate(subject, "other rate")


def _without_context(subject: _Subject) -> str:
    name = "other rate without context"
    came = _at_other_rate(subject, name)
    simulated = _joint(name)
    model, ensemble = subject.model(name), simulated.ensemble
    stiffness = _stiffness(model, ensemble)
    edge = round(0.1 * ensemble.sampling_rate)
    edges = np.r_[:edge, ensemble.samples - edge : ensemble.samples]
    error = (stiffness - simulated.stiffness)[edges]
    worst = float(np.nanmax(np.abs(error), initial=0.0))
    if worst > LEVEL / 2:
        raise _FailedError(
            f"within 0.1 s of the ends stiffness is up to {worst:.0f} N·m/rad off; give NaN where lags or windows "
            "reach beyond the samples, no invented values"
        )
    predicted = subject.predict(model, ensemble)[:, edges]
    share = _vaf(simulated.noiseless_torque[:, edges], predicted)
    if np.isfinite(predicted).any() and not share > 50:
        raise _FailedError(
            f"within 0.1 s of the ends predict(ensemble) has a VAF of {share:.0f} %; give NaN where lags or "
            "derivatives reach beyond the samples, no invented values"
        )
    return f"{came}; NaN at {np.count_nonzero(np.isnan(stiffness))} of {ensemble.samples} times"


def _at_other_rate(subject: _Subject, name: str) -> str:
    simulated = _joint(name)
    model, ensemble = subject.model(name), simulated.ensemble
    stiffness, predicted = _stiffness(model, ensemble), subject.predict(model, ensemble)
    for what, values in (("stiffness", stiffness), ("predict(ensemble)", predicted)):
        _mostly_known(what, values)
    known = np.isfinite(stiffness)
    mean, truth = float(stiffness[known].mean()), float(simulated.stiffness[known].mean())
    share = _vaf(simulated.noiseless_torque, predicted)
    came = f"at 128 Hz and 1.5 s: {mean:.3g} N·m/rad in the mean, where {truth:.3g} is true, VAF {share:.1f} %"
    if abs(mean - truth) > 0.15 * truth or not share > 80:
        raise _FailedError(
            f"{came}; expected at most 15 % off and more than 80 %. Use ensemble.sampling_rate and ensemble.samples "
            "instead of numbers that hold at 100 Hz and 2 s"
        )
    return came


def _few_realizations(subject: _Subject) -> str:
    told_of = []
    for count in (3, 1):
        few = _joint("constant").ensemble.select(range(count))
        words = f"{count} realization{'s' if count > 1 else ''}"
        try:
            model = subject.identify(few)
        except (Exception, SystemExit) as error:
            plain = isinstance(error, ValueError) and not isinstance(error, np.linalg.LinAlgError)
            if plain and str(error).strip():
                told_of.append(f"{words}: refused ({describe_error(error, subject.file)})")
                continue
            raise _FailedError(
                f"{words}: {describe_error(error, subject.file)}; expected a result, or a tvsysid.InputError that says "
                "how many are needed"
            ) from error
        _stiffness(model, few)
        subject.predict(model, few)
        told_of.append(f"{words}: a result")
    return "; ".join(told_of)


def _own_warnings(subject: _Subject) -> str:
    if subject.warned:
        raise _FailedError(
            f"it warned in other words than tvsysid.DataQualityWarning, which reports do not show: "
            f"{'; '.join(list(subject.warned)[:3])}"
        )
    return "none but tvsysid.DataQualityWarning"


class _Rule(NamedTuple):
    name: str
    judge: Callable[[_Subject], str]
    """Gives what came; raises if that is not what was expected."""
    needs: str | None = None
    """Rule without which this one cannot be judged."""
    required: bool = True


MODEL = "returns a model"
RULES = (
    _Rule("has identify", _has_identify),
    _Rule("leaves the ensemble untouched", _untouched, "has identify"),
    _Rule("identifies a joint", _identifies, "has identify"),
    _Rule(MODEL, _returns_model, "identifies a joint"),
    _Rule("recovers a constant stiffness", _recovers_constant, MODEL),
    _Rule("predicts the torque", _predicts, MODEL),
    _Rule("follows a changing stiffness", _follows_change, MODEL, required=False),
    _Rule("gives the same numbers again", _repeats, MODEL),
    _Rule("can be sent to a worker", _travels, "gives the same numbers again"),
    _Rule("scales with the torque", _scales, "recovers a constant stiffness"),
    _Rule("works at another rate and length", _other_rate, MODEL),
    _Rule("works without context", _without_context, "works at another rate and length"),
    _Rule("takes few realizations, or says that it does not", _few_realizations, MODEL),
    _Rule("warns as the package does", _own_warnings, MODEL, required=False),
)


def _judged(rule: _Rule, subject: _Subject, done: dict[str, Check]) -> Check:
    if rule.needs is not None and not done[rule.needs].passed:
        return Check(rule.name, False, f"not reached, because of {rule.needs!r}", rule.required)
    try:
        return Check(rule.name, True, rule.judge(subject), rule.required)
    except _FailedError as error:
        message = str(error)
    except _NotReachedError as error:
        message = f"not reached: {error}"
    except (Exception, SystemExit) as error:
        message = _explained(error, subject)
    return Check(rule.name, False, message, rule.required)


def _explained(error: BaseException, subject: _Subject) -> str:
    text = describe_error(error, subject.file)
    if _wrote(error):
        return f"it writes to an array that all methods share; work on a copy, as in ensemble.angle.copy(). {text}"
    if isinstance(error, InputError):
        return f"it refused: {text}"
    return f"it stopped with {text}"


def _wrote(error: BaseException) -> bool:
    """Whether an array was written to that must not be; NumPy has no class for that error."""
    return isinstance(error, ValueError) and any(words in str(error) for words in ("read-only", "WRITEABLE"))


def _vaf(torque: Array, predicted: Array) -> float:
    """Mean over realizations in per cent; NaN where nothing is predicted."""
    shares = metrics.vaf(torque, predicted)
    return float(np.nanmean(shares)) if np.isfinite(shares).any() else float("nan")


def _same(values: Array, others: Array) -> bool:
    return values.shape == others.shape and np.allclose(values, others, rtol=1e-9, atol=0.0, equal_nan=True)


def _largest_difference(values: Array, others: Array) -> float:
    differences = np.abs(values - others)
    return float(np.nanmax(differences)) if np.isfinite(differences).any() else float("nan")
