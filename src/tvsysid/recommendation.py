"""Which method suits an ensemble, and why: measured properties, held against one table of rules."""

from __future__ import annotations

import math
import warnings
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from tvsysid.checked import Frozen
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import DEFAULT_METHODS, Tuned, key_of, parse
from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.methods.apply import Identifies
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import Model
from tvsysid.quality import Diagnosis, diagnose, find_reference
from tvsysid.quality.resampling import lowered
from tvsysid.showing import summary_html
from tvsysid.signals import Array, Ensemble

SLOW, WIDE = (0.0, 5.0), (8.0, 25.0)  # Hz: bands whose power density of the noise is compared
MEASURES = ("angle RMS", "bandwidth of the angle", "signal-to-noise ratio", "mean stiffness")  # of the diagnosis
LIKELY = 0.5  # probability from which on a switch counts, and a constant
MOST = 0.99  # share of a change that so many harmonics hold
SAID = ("reflex", "loop-bias", "feedback")  # faults that the rules speak of
REFERENCE, IS_SLOW = "reference={reference}", "slow noise > 10"


Measured = Mapping[str, tuple[float, str]]  # value and unit by property


class Rule(NamedTuple):
    """A row of the decision table: the first whose conditions all hold decides.

    ``conditions`` are ``property > limit`` or ``property < limit``, in the property's unit. The first of the
    ``methods``, as typed on the command line, that applies is recommended; there is none where none is right. ``why``
    is a sentence; ``scenario`` is the kind of data in ``benchmarks/recommend.py`` that shows it.
    """

    conditions: tuple[str, ...]
    methods: tuple[str, ...]
    why: str
    scenario: str


LOOP = "noise in the torque moves the angle (a closed loop)"
RULES = (
    Rule(
        ("scheduling variable > 0",),
        ("lpvkbi:variable={scheduling}", "lpv:variable={scheduling}"),
        "the joint follows {scheduling!r}, which was recorded and differs between realizations",
        "follows a variable",
    ),
    Rule(
        ("information < 2",),
        (),
        "the torque that answers the angle is too weak for a stiffness over time: perturb more, or record more",
        "weak excitation",
    ),
    Rule(
        ("loop bias > 5", IS_SLOW),
        (f"kbr:{REFERENCE},weighting=residual,tuned=true", f"kbr:{REFERENCE},weighting=residual", f"birf:{REFERENCE}"),
        f"{LOOP}, of which {{reference!r}} is free; it is slow, and frequencies count by how little of it they hold",
        "loop with a reference",
    ),
    Rule(
        ("loop bias > 5",),
        (f"birf:{REFERENCE},tuned=true", f"birf:{REFERENCE}", f"kbr:{REFERENCE}"),
        f"{LOOP}, of which {{reference!r}} is free",
        "loop with a reference",
    ),
    Rule(
        ("feedback > 10",),
        (),
        f"{LOOP}, which biases them all, and no reference is named: record the disturbance or the actuator's command",
        "loop without a reference",
    ),
    Rule(
        ("realizations < 6",),
        ("cascade", "adaptive", "kbr:tuned=true", "kbr"),
        "realizations are too few to tell a switch from noise, and it finds how smooth stiffness is without them",
        "few realizations",
    ),
    Rule(
        ("reflex > 0",),
        ("adaptive", "cascade"),
        "a stretch reflex is shown, and it takes that out of the stiffness (cascade says more of the reflex itself)",
        "reflex",
    ),
    Rule(
        (IS_SLOW, "switches < 1"),
        ("kbr:weighting=residual,tuned=true", "adaptive"),
        "the torque's noise is slow, and frequencies count by how little of it they hold; stiffness does not switch",
        "slow noise",
    ),
    Rule(
        ("harmonics > 0", "harmonics < 4", "switches < 1"),
        ("birf:tuned=true", "adaptive"),
        "stiffness changes as a few harmonics of the period, of which its random error is the least (by adaptive up to "
        "1.5 times that)",
        "slow change",
    ),
    Rule(
        (),
        ("adaptive", "kbr:tuned=true", "kbr"),
        "the behaviour repeats, and it finds from the data how fast stiffness changes, and whether it switches",
        "fast change, short record",
    ),
)


@dataclass(frozen=True, eq=False, repr=False)
class Recommendation(Frozen):
    """Which method suits an ensemble, and why.

    Parameters
    ----------
    suited
        The method as the command line takes it, as in ``"kbr:weighting=residual,tuned=true"``, and after it what to go
        by where that was not run; empty where none is right.
    why
        In a sentence.
    measured
        Properties of the data by name, each with its unit; NaN where it is not shown, or the data do not tell it.
    against
        What speaks against the other usual methods, by key.
    caveats
        What to keep in mind, a sentence each.
    diagnosis
        What the properties come from; None where there is a single realization.
    """

    suited: tuple[str, ...]
    why: str
    measured: Measured
    against: Mapping[str, str]
    caveats: tuple[str, ...] = ()
    diagnosis: Diagnosis | None = None

    @property
    def method(self) -> Identifies | None:
        """The method, ready to run: ``recommend(ensemble).method.identify(ensemble)``; None where none is right."""
        return parse(self.suited[0]) if self.suited else None

    def leading(self, methods: Mapping[str, object], tuned: Container[str] = ()) -> str | None:
        """Label of the one to go by of these ``methods``; None if none suits. The settings of some are ``tuned``."""
        for wanted in map(parse, self.suited):
            for label, method in methods.items():
                if isinstance(wanted, Tuned) and not (label in tuned or isinstance(method, Tuned)):
                    continue
                if _alike(wanted, method):
                    return label
        return None

    @property
    def sentence(self) -> str:
        """Method and reason."""
        return f"{self.suited[0] if self.suited else 'no method is right'}: {self.why}"

    @property
    def _rows(self) -> list[tuple[str, float, str]]:
        return [(name, *each) for name, each in self.measured.items()]

    def __repr__(self) -> str:
        told = ", ".join(
            f"{name} {value:.3g} {unit}".rstrip() for name, value, unit in self._rows if not math.isnan(value)
        )
        lines = [f"Recommendation: {self.sentence}", f"measured: {told}"]
        lines += [f"not {key}: {reason}" for key, reason in self.against.items()]
        return "\n".join([*lines, *(f"caveat: {each}" for each in self.caveats)])

    def _repr_html_(self) -> str:
        notes = [f"not {key}: {reason}" for key, reason in self.against.items()]
        notes += [f"caveat: {each}" for each in self.caveats]
        return summary_html("Recommendation", self.sentence, ["property", "value", "unit"], self._rows, notes)


def recommend(
    ensemble: Ensemble, reference: str | None = None, scheduling: str | None = None, *, model: Model | None = None
) -> Recommendation:
    """Say which method suits an ensemble, and why, by what is measured in it.

    The properties are held against :data:`tvsysid.recommendation.RULES`, each of which a kind of simulated data in
    ``benchmarks/recommend.py`` stands for; docs/which-method.md has the table and how often it is right.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    reference
        Channel with the disturbance that was applied, or the actuator's command, if the angle may not be imposed.
    scheduling
        Channel with a variable that the joint follows and that differs between realizations.
    model
        What ``adaptive`` found in this ensemble, if that is known; otherwise it is identified here.

    Raises
    ------
    InputError
        If it is no ensemble, or there is no such channel.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> found = tv.recommend(tv.preprocess.subtract_mean(ensemble))
    >>> print(found.sentence)
    adaptive: the behaviour repeats, and it finds from the data how fast stiffness changes, and whether it switches
    >>> found.method
    AdaptiveRegression()
    """
    if not isinstance(ensemble, Ensemble):
        raise InputError(f"recommend: expected an Ensemble, got {type(ensemble).__name__}; cut a Recording first")
    for name in filter(None, (reference, scheduling)):
        ensemble.signal(name)  # raises for one that there is not
    diagnosis = None
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        with suppress(InputError):  # a single realization, or too short
            diagnosis = diagnose(ensemble, reference)
        measured = _measured(ensemble, diagnosis, scheduling, model)
    rule, channels = rule_of(measured), {"reference": reference, "scheduling": scheduling}
    suited = [typed.format(**channels) for typed in rule.methods]
    suited = [typed for typed in suited if not reason_to_skip(parse(typed), ensemble)]
    against, caveats = _against(suited, ensemble), _caveats(diagnosis, measured)
    caveats += tuple(moving(ensemble, [name for name in ensemble.channels if name not in (reference, scheduling)]))
    return Recommendation(tuple(suited), rule.why.format(**channels), measured, against, caveats, diagnosis)


def moving(ensemble: Ensemble, channels: Iterable[str]) -> Iterator[str]:
    """Of channels that nobody named as a reference, those that move the joint as one does, in a sentence each."""
    for name in channels:
        seen = find_reference(ensemble, name)
        if seen.found:
            yield f"{name!r} moves before the angle: if it is the perturbation, name it as the reference; {seen.what}"


def rule_of(measured: Measured) -> Rule:
    """First rule that holds."""
    return next(rule for rule in RULES if all(_holds(condition, measured) for condition in rule.conditions))


def _measured(
    ensemble: Ensemble, diagnosis: Diagnosis | None, scheduling: str | None, model: Model | None
) -> dict[str, tuple[float, str]]:
    """Properties that the rules ask for, and those that explain them."""
    measured = {"realizations": (float(len(ensemble)), ""), "duration": (ensemble.duration, "s")}
    measured["scheduling variable"] = (float(scheduling is not None), "")
    if diagnosis is None:
        return measured
    measured |= {name: diagnosis.measures[name] for name in MEASURES}
    information = len(ensemble) * 10 ** (measured["signal-to-noise ratio"][0] / 10)
    measured["information"] = (information, "realizations at 0 dB")
    seen = {check.name: abs(check.value) for check in diagnosis.checks if check.found}
    seen |= {check.name: abs(check.value) for check in diagnosis.uncertain if check.name == "loop-bias"}
    for name in ("reflex", "feedback", "loop-bias", "scattered-realizations"):
        measured[name.replace("-", " ")] = (seen.get(name, math.nan), "%")
    measured["slow noise"] = (_slowness(diagnosis), "dB")
    if math.isnan(measured["reflex"][0]):
        measured |= _speed(ensemble, model)
    return measured


def _slowness(diagnosis: Diagnosis) -> float:
    """Power density in dB of the noise at low frequencies over that at higher ones."""
    frequency, power = diagnosis.curves.frequency, diagnosis.curves.residual_power
    low, high = (float(power[(frequency > start) & (frequency <= stop)].mean()) for start, stop in (SLOW, WIDE))
    return 10 * math.log10(low / high) if low > 0 and high > 0 else math.nan


def _speed(ensemble: Ensemble, model: Model | None) -> dict[str, tuple[float, str]]:
    """By how much stiffness changes, how fast, and how often it switches, by ``adaptive``; nothing where that fails."""
    adaptive = AdaptiveRegression()
    if not isinstance(model, AdaptiveModel):
        if reason_to_skip(adaptive, ensemble):
            return {}
        try:
            model = adaptive.identify(lowered(ensemble))
        except InputError:
            return {}
    assert isinstance(model, AdaptiveModel)
    switches = sum(each.quantity == "stiffness" and each.probability > LIKELY for each in model.switches)
    change = float(np.nanmax(model.stiffness) - np.nanmin(model.stiffness))
    fastest = float(np.nanmax(np.abs(np.gradient(model.stiffness, model.time))))
    found = {"switches": (float(switches), ""), "stiffness changes by": (change, "N·m/rad")}
    if model.diagnostics.details["constant_stiffness"] < LIKELY:
        found["harmonics"] = (_harmonics(model.stiffness), "of the period")
    return found | {"time of the fastest change": (change / fastest if fastest > 0 else math.nan, "s")}


def _harmonics(stiffness: Array) -> float:
    """How many harmonics of a realization hold nearly all of a change."""
    power = np.cumsum(np.abs(np.fft.rfft(stiffness[np.isfinite(stiffness)])[1:]) ** 2)
    return 1.0 + float(np.searchsorted(power, MOST * power[-1]))


def _against(suited: list[str], ensemble: Ensemble) -> dict[str, str]:
    """Why not the other usual methods: they do not apply, or what makes their stiffness differ."""
    looped = suited and "reference=" in suited[0]
    found = {}
    for key in DEFAULT_METHODS:
        if not suited or key != key_of(suited[0]):
            method = parse(key)
            differs = "It takes the angle as imposed." if looped else getattr(method, "differs", "")
            found[key] = reason_to_skip(method, ensemble) or str(differs)
    return found


def _holds(condition: str, measured: Measured) -> bool:
    """Whether a condition holds; of what is not known, none does."""
    name, side, limit = condition.rsplit(" ", 2)
    value = measured.get(name, (math.nan, ""))[0]
    return value > float(limit) if side == ">" else value < float(limit)


def _alike(wanted: Identifies, method: object) -> bool:
    """Whether a method is the one wanted, but for settings that are chosen from the data."""
    own, other = (getattr(each, "method", each) for each in (wanted, method))  # of a tuned one, what is tuned
    usual = vars(type(own)())
    return type(other) is type(own) and all(
        vars(other)[name] == each for name, each in vars(own).items() if each != usual.get(name)
    )


def _caveats(diagnosis: Diagnosis | None, measured: Measured) -> tuple[str, ...]:
    """What the diagnosis found, and what it could not see."""
    if diagnosis is None:
        return ("a single realization, or one too short, cannot be diagnosed",)
    found = [f"{each.fault.title.lower()}: {each.fault.effect}" for each in diagnosis.findings if each.name not in SAID]
    if _holds(IS_SLOW, measured) and not any(check.name == "loop-bias" for check in diagnosis.checks):
        found.append(
            "the torque's noise is slow: if the actuator gives way, it moves the angle, and stiffness comes out too "
            "low; this shows by the actuator's command alone (reference)"
        )
    return tuple(found)
