"""What every method must do, as checks that anybody's method can be put to."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import attrs
import cloudpickle
import numpy as np

from tvsysid import metrics
from tvsysid.check.subject import LEVEL, FailedError, Subject, numbers, simulated_case
from tvsysid.errors import InputError, plain_text
from tvsysid.estimates import IMPEDANCE
from tvsysid.methods.base import inputs_of, names_said, reason_to_skip, scheduled_by
from tvsysid.numerics import Array
from tvsysid.numerics.threads import single_thread


@attrs.frozen
class Check:
    """One thing that is expected of a method, which it ``passed``, or did not pass or reach.

    The ``message`` says what came and, if it did not pass, what was expected and what to do.
    What is not ``required`` is advice: a method may have reasons not to follow it. One whose
    foundation did not pass was not ``run``.
    """

    name: str
    passed: bool
    message: str
    required: bool = True
    run: bool = True


def check_method(method: object) -> list[Check]:
    """Put a method to everything that is expected of it.

    It identifies simulated joints of known stiffness, which have the channels that it declares as
    ``inputs``. Nothing is raised, whatever the method does. All checks come in their order; one
    whose foundation did not pass is reported as not run.

    Examples
    --------
    >>> from tvsysid.methods import create
    >>> all(check.passed for check in check_method(create("sds")))
    True
    >>> check_method("sds")[0].message
    'expected an object with identify(ensemble), got an object of type str; tvsysid.methods.parse
    makes a method of a text'
    """
    subject, done = Subject(method), dict[str, Check]()
    with single_thread():
        for rule in _RULES:
            done[rule.name] = _judged(rule, subject, done)
    return list(done.values())


def _expect(holds: bool | np.bool_, came: str, advice: str) -> str:
    """What came, if it is as expected."""
    if not holds:
        raise FailedError(f"{came}; {advice}")
    return came


def _vaf(torque: Array, predicted: Array) -> float:
    """Mean over realizations in per cent; NaN where nothing is predicted."""
    shares = metrics.vaf(torque, predicted)
    return float(np.nanmean(shares)) if np.isfinite(shares).any() else float("nan")


def _same(values: Array, others: Array) -> bool:
    return values.shape == others.shape and np.allclose(
        values, others, rtol=1e-9, atol=0.0, equal_nan=True
    )


def _has_identify(subject: Subject) -> str:
    method = subject.method
    if isinstance(method, type):
        raise FailedError(
            f"expected an object, got the class {method.__name__} itself; give {method.__name__}()"
        )
    if not callable(getattr(method, "identify", None)):
        advice = (
            "; tvsysid.methods.parse makes a method of a text" if isinstance(method, str) else ""
        )
        what = f"an object of type {type(method).__name__}{advice}"
        raise FailedError(f"expected an object with identify(ensemble), got {what}")
    return "it does"


def _states_inputs(subject: Subject) -> str:
    inputs = inputs_of(subject.method)
    ensemble = subject.case("constant").ensemble
    if reason := reason_to_skip(subject.method, ensemble):
        raise FailedError(f"it skips {ensemble!r}: {reason}")
    return ", ".join(["angle", "torque", *(f"{item.name} ({item.kind})" for item in inputs)])


def _identifies(subject: Subject) -> str:
    subject.model("constant")
    given = subject.case("constant").ensemble
    return (
        f"identified {len(given)} realizations of {given.duration:g} s at "
        f"{given.sampling_rate:g} Hz"
    )


def _untouched(subject: Subject) -> str:
    ensemble = subject.case("constant").ensemble
    fresh = simulated_case.__wrapped__("constant", *subject.needs).ensemble
    names = ("angle", "torque", *ensemble.channels)
    if not all(np.array_equal(ensemble.signal(name), fresh.signal(name)) for name in names):
        simulated_case.cache_clear()
        raise FailedError(
            "identify changed the ensemble, which all methods share; work on ensemble.angle.copy()"
        )
    return f"{', '.join(names)} are as they were"


def _returns_model(subject: Subject) -> str:
    model = subject.model("constant")
    if model is None:
        raise FailedError("identify returned None; end it by returning a model")
    wanted = {"stiffness": ("stiffness", "estimates"), "predict(ensemble)": ("predict", "pathways")}
    missing = [
        what for what, names in wanted.items() if not any(hasattr(model, name) for name in names)
    ]
    if missing:
        raise FailedError(
            "expected a model with stiffness (or estimates) and predict(ensemble) (or pathways), "
            f"got an object of type {type(model).__name__} without {' and '.join(missing)}"
        )
    _, subject.first, torque = subject.result("constant")
    estimates = getattr(model, "estimates", {"stiffness": None})
    scheduled = scheduled_by(subject.method)
    said = [*names_said(subject.method, "quantities"), *scheduled]
    if absent := [name for name in said if name not in estimates]:
        raise FailedError(
            f"expected estimates of all its quantities, got none of {', '.join(absent)}"
        )
    for name, most in scheduled.items():
        if (count := np.size(getattr(estimates[name], "values", estimates[name]))) > most:
            raise FailedError(
                f"expected {most} values of {name} at most, as scheduled_quantities says, got "
                f"{count}"
            )
    unsaid = ", ".join(name for name in estimates if name not in (*IMPEDANCE, *said))
    advice = (
        f"; name {unsaid} in quantities or scheduled_quantities, or a study does not keep it"
        if unsaid
        else ""
    )
    return f"{', '.join(estimates)}, and predict(ensemble) of shape {torque.shape}{advice}"


def _adds_up(subject: Subject) -> str:
    model, ensemble = subject.model("constant"), subject.case("constant").ensemble
    said = getattr(subject.method, "pathway_names", ())
    own = model.pathways(ensemble) if hasattr(model, "pathways") else {"intrinsic": None}
    if absent := [name for name in said if name not in own]:
        raise FailedError(
            f"expected the pathways of its pathway_names, got none of {', '.join(absent)}"
        )
    if not hasattr(model, "pathways"):
        return "one pathway"
    torques = {name: numbers(f"pathway {name!r}", each, ensemble) for name, each in own.items()}
    gap = float(np.nanmax(np.abs(sum(torques.values()) - subject.predict(model, ensemble))))
    came = _expect(
        gap <= 1e-6 * ensemble.torque.std(),
        f"{' + '.join(torques)} {f'is up to {gap:.2g} N·m off' if gap else 'is'} what it predicts",
        "expected pathways(ensemble) with predict(ensemble) as their sum",
    )
    unsaid = ", ".join(name for name in torques if name not in said) if len(torques) > 1 else ""
    return (
        f"{came}; name {unsaid} in pathway_names, or a study does not keep it" if unsaid else came
    )


def _tells_pathways_apart(subject: Subject) -> str:
    model, ensemble = subject.model("constant"), subject.case("constant").ensemble
    if not hasattr(model, "pathways") or not {"intrinsic", "reflex"} <= set(
        model.pathways(ensemble)
    ):
        return "it has no reflex pathway"
    case, model = subject.case("reflex"), subject.model("reflex")
    torques = model.pathways(case.ensemble)
    shares = {name: _vaf(torque, torques[name]) for name, torque in case.pathways.items()}
    return _expect(
        min(shares.values()) > 50,
        f"VAF {', '.join(f'{share:.1f} % of the {name} torque' for name, share in shares.items())}",
        "expected more than 50 % of each",
    )


def _recovers_constant(subject: Subject) -> str:
    mean = float(np.nanmean(subject.first))
    came = f"{mean:.3g} N·m/rad in the mean, where {LEVEL:g} is true"
    _expect(
        mean >= 0,
        came,
        "the sign is reversed; torque is positive where it resists a positive angle",
    )
    return _expect(
        abs(mean - LEVEL) <= 0.1 * LEVEL,
        came,
        "expected at most 10 % off. Are the units rad and N·m?",
    )


def _predicts(subject: Subject) -> str:
    model = subject.model("constant")
    cases = [subject.case(name) for name in ("constant", "unseen")]
    seen, unseen = (_vaf(case.torque, subject.predict(model, case.ensemble)) for case in cases)
    return _expect(
        seen > 80 and unseen > 80,
        f"VAF {seen:.1f} % of the noiseless torque, {unseen:.1f} % in data it has not seen",
        "expected more than 80 %. Does predict count viscosity and inertia, and is it aligned in "
        "time?",
    )


def _follows_change(subject: Subject) -> str:
    case, stiffness, _ = subject.result("changing")
    if getattr(subject.method, "time_invariant", False):
        return "it takes the joint as constant, and says so (time_invariant)"
    known = np.isfinite(stiffness)
    found, truth = stiffness[known], case.stiffness[known]
    error, guess = float(np.sqrt(np.mean((found - truth) ** 2))), float(np.std(truth))
    correlation = float(np.corrcoef(found, truth)[0, 1]) if np.ptp(found) > 0 else 0.0
    return _expect(
        correlation > 0.8 and error < guess,
        f"correlation {correlation:.2f} with a sine of ±50 N·m/rad, error {error:.1f} N·m/rad RMS",
        f"expected more than 0.8, and less than the {guess:.1f} of a constant guess. A method "
        "that takes stiffness as "
        "constant can be compared, but will not do well; let it say so: time_invariant = True",
    )


def _repeats(subject: Subject) -> str:
    ensemble = subject.case("constant").ensemble
    subject.model("changing")
    if not _same(subject.stiffness(subject.model("constant"), ensemble), subject.first):
        raise FailedError(
            "the stiffness of the first model changed when identify was called again; return a "
            "new object each time"
        )
    again = subject.stiffness(subject.identify(ensemble), ensemble)
    if not _same(again, subject.first):
        raise FailedError(
            "the same data gave other numbers, up to "
            f"{np.nanmax(np.abs(again - subject.first)):.2g} N·m/rad off; give "
            "random numbers a fixed seed, and keep nothing from one call to the next"
        )
    return "the same data gave the same numbers, after other data too"


def _travels(subject: Subject) -> str:
    ensemble = subject.case("constant").ensemble
    try:
        copy = Subject(cloudpickle.loads(cloudpickle.dumps(subject.method)))
    except Exception as error:
        raise FailedError(
            "expected a method that cloudpickle can send to a worker process, got "
            f"{subject.described(error)}; hold no open file, lock or generator in it"
        ) from error
    if not _same(copy.stiffness(copy.identify(ensemble), ensemble), subject.first):
        raise FailedError("its copy gave other numbers; keep all settings in the object itself")
    return "its copy gave the same numbers"


def _scales(subject: Subject) -> str:
    ensemble = subject.case("constant").ensemble
    tenfold = subject.stiffness(
        subject.identify(attrs.evolve(ensemble, torque=10 * ensemble.torque)), ensemble
    )
    ratio = float(np.nanmean(tenfold) / np.nanmean(subject.first))
    return _expect(
        abs(ratio - 10) < 0.5,
        f"ten times the torque gave {ratio:.3g} times the stiffness",
        "expected 10. Does a threshold or a prior hold for one size of torque only?",
    )


def _other_rate(subject: Subject, name: str = "other rate") -> str:
    case, stiffness, predicted = subject.result(name)
    known = np.isfinite(stiffness)
    mean, share = stiffness[known].mean(), _vaf(case.torque, predicted)
    # A constant stiffness is the mean of what was used: of all, or of what is predicted.
    truths = [case.stiffness[each].mean() for each in (known, known & np.isfinite(predicted))]
    truth = min(truths, key=lambda each: abs(each - mean))
    return _expect(
        abs(mean - truth) <= 0.15 * truth and share > 80,
        f"at 128 Hz and 1.5 s: {mean:.3g} N·m/rad in the mean, where {truth:.3g} is true, VAF "
        f"{share:.1f} %",
        "expected at most 15 % off and more than 80 %. Use ensemble.sampling_rate and "
        "ensemble.samples instead of "
        "numbers that hold at 100 Hz and 2 s",
    )


def _without_context(subject: Subject) -> str:
    if reason := reason_to_skip(subject.method, subject.case("without context").ensemble):
        return f"it says that it cannot: {reason}"
    came = _other_rate(subject, "without context")
    case, stiffness, predicted = subject.result("without context")
    edge = round(0.1 * case.ensemble.sampling_rate)
    edges = np.r_[:edge, case.ensemble.samples - edge : case.ensemble.samples]
    worst = float(np.nanmax(np.abs(stiffness - case.stiffness)[:, edges], initial=0.0))
    share = _vaf(case.torque[:, edges], predicted[:, edges])
    for right, fault in (
        (worst <= LEVEL / 2, f"stiffness is up to {worst:.0f} N·m/rad off"),
        (
            share > 50 or np.isnan(predicted[:, edges]).all(),
            f"predict(ensemble) has a VAF of {share:.0f} %",
        ),
    ):
        advice = (
            "give NaN where lags, windows or derivatives reach beyond the samples, no "
            "invented values"
        )
        _expect(right, f"within 0.1 s of the ends {fault}", advice)
    return (
        f"{came}; NaN at {np.isnan(stiffness).all(axis=0).sum()} of {case.ensemble.samples} times"
    )


def _few_realizations(subject: Subject) -> str:
    came = []
    for count in (3, 1):
        few = subject.case("constant").ensemble.select(range(count))
        words = f"{count} realization{'s' if count > 1 else ''}"
        try:
            if reason := reason_to_skip(subject.method, few):
                raise InputError(reason)
            model = subject.identify(few)
        except (Exception, SystemExit) as error:
            plain = isinstance(error, ValueError) and not isinstance(error, np.linalg.LinAlgError)
            if not (plain and plain_text(error)):
                advice = "expected a result, or a tvsysid.InputError that says how many are needed"
                raise FailedError(f"{words}: {subject.described(error)}; {advice}") from error
            came.append(f"{words}: refused ({subject.described(error)})")
        else:
            subject.stiffness(model, few)
            subject.predict(model, few)
            came.append(f"{words}: a result")
    return "; ".join(came)


def _own_warnings(subject: Subject) -> str:
    shown = "; ".join(list(subject.warned)[:3])
    if shown:
        raise FailedError(
            "it warned in other words than tvsysid.DataQualityWarning, which reports do not "
            f"show: {shown}"
        )
    return "no other warnings than tvsysid.DataQualityWarning"


class _Rule(NamedTuple):
    """``judge`` gives what came, or raises.

    ``needs`` names the rule without which this one cannot be judged.
    """

    name: str
    judge: Callable[[Subject], str]
    needs: str | None = None
    required: bool = True


_MODEL = "returns a model"
_RULES = (
    _Rule("has identify", _has_identify),
    _Rule("states its inputs", _states_inputs, "has identify"),
    _Rule("identifies a joint", _identifies, "states its inputs"),
    _Rule("leaves the ensemble untouched", _untouched, "identifies a joint"),
    _Rule(_MODEL, _returns_model, "leaves the ensemble untouched"),
    _Rule("has pathways that add up", _adds_up, _MODEL),
    _Rule(
        "separates intrinsic and reflex torque",
        _tells_pathways_apart,
        "has pathways that add up",
        required=False,
    ),
    _Rule("recovers a constant stiffness", _recovers_constant, _MODEL),
    _Rule("predicts the torque", _predicts, _MODEL),
    _Rule("follows a changing stiffness", _follows_change, _MODEL, required=False),
    _Rule("gives the same numbers again", _repeats, _MODEL),
    _Rule("can be sent to a worker", _travels, "gives the same numbers again"),
    _Rule("scales with the torque", _scales, "recovers a constant stiffness"),
    _Rule("works at another rate and length", _other_rate, _MODEL),
    _Rule("works without context", _without_context, "works at another rate and length"),
    _Rule("takes few realizations, or says that it does not", _few_realizations, _MODEL),
    _Rule("uses the package's warning class", _own_warnings, _MODEL, required=False),
)


def _judged(rule: _Rule, subject: Subject, done: dict[str, Check]) -> Check:
    if rule.needs is not None and not done[rule.needs].passed:
        before = done[rule.needs]
        return Check(
            rule.name,
            False,
            f"not run: {before.name!r} failed" if before.run else before.message,
            rule.required,
            run=False,
        )
    try:
        return Check(rule.name, True, rule.judge(subject), rule.required)
    except FailedError as error:
        message = str(error)
    except (Exception, SystemExit) as error:
        said = plain_text(error)
        wrote = isinstance(error, ValueError) and any(
            words in said for words in ("read-only", "WRITEABLE")
        )
        message = (
            f"it {'refused:' if isinstance(error, InputError) else 'stopped with'} "
            f"{subject.described(error)}"
        )
        if wrote:  # NumPy has no class for that error
            advice = (
                "it writes to an array that all methods share; work on a copy, as in "
                "ensemble.angle.copy()"
            )
            message = f"{advice}. {subject.described(error)}"
    return Check(rule.name, False, message, rule.required)
