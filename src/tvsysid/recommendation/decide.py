"""Which method suits an ensemble, and why: measured properties, held against one table of rules."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import suppress

import attrs

from tvsysid.checked import Frozen
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import DEFAULT_METHODS, Tuned, key_of, parse
from tvsysid.methods.apply import Identifies
from tvsysid.methods.base import reason_to_skip
from tvsysid.models import Model
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import Diagnosis, diagnose, find_reference
from tvsysid.recommendation.properties import measured_in
from tvsysid.recommendation.rules import AGAINST, IS_SLOW, IS_STRONG, Measured, holds, rule_of
from tvsysid.showing import summary_html
from tvsysid.signals import Ensemble
from tvsysid.validators import settings_of

SAID = ("reflex", "loop-bias", "feedback")  # faults that the rules speak of
MAY_BE_A_LOOP = (
    "the torque's noise is slow or strong. If the actuator is compliant, this noise moves the "
    "angle, and stiffness is "
    "underestimated. Only the actuator's command as the reference shows it"
)


@attrs.frozen(eq=False, repr=False)
class Recommendation(Frozen):
    """Which method suits an ensemble, and why.

    Parameters
    ----------
    suited
        The method as the command line takes it, as in ``"kbr:weighting=residual,tuned=true"``, and
        after it what to go by where that was not run; empty where none is right.
    why
        In a sentence.
    measured
        Properties of the data by name, each with its unit; NaN where it is not shown, or the data
        do not tell it.
    against
        What speaks against the other usual methods, by key.
    caveats
        What to keep in mind, a sentence each.
    diagnosis
        What the properties come from; None where there is a single realization.
    unnamed_references
        A sentence for each channel that moves the angle and was not named as a reference.
    """

    suited: tuple[str, ...]
    why: str
    measured: Measured
    against: Mapping[str, str]
    caveats: tuple[str, ...] = ()
    diagnosis: Diagnosis | None = None
    unnamed_references: tuple[str, ...] = ()

    @property
    def method(self) -> Identifies | None:
        """The method, ready to run: ``recommend(ensemble).method.identify(ensemble)``.

        None where none is right.
        """
        return parse(self.suited[0]) if self.suited else None

    def leading(self, methods: Mapping[str, object], tuned: Container[str] = ()) -> str | None:
        """Label of the first of these ``methods`` that suits; None if none does.

        The settings of some are ``tuned``.
        """
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
    def objections(self) -> list[str]:
        """What speaks against other methods; those against which the same does stand together."""
        found = []
        for reason in dict.fromkeys(self.against.values()):
            methods = [key for key, each in self.against.items() if each == reason]
            said = re.sub("^It ", "it " if len(methods) == 1 else "each ", reason)
            found.append(f"not {', '.join(methods)}: {said}")
        return found

    @property
    def _rows(self) -> list[tuple[str, float, str]]:
        return [(name, *each) for name, each in self.measured.items()]

    def __repr__(self) -> str:
        told = ", ".join(
            f"{name} {_short(value)} {unit}".rstrip()
            for name, value, unit in self._rows
            if not math.isnan(value)
        )
        lines = [f"Recommendation: {self.sentence}", f"measured: {told}"]
        return "\n".join([*lines, *self.objections, *(f"caveat: {each}" for each in self.caveats)])

    def _repr_html_(self) -> str:
        notes = [*self.objections, *(f"caveat: {each}" for each in self.caveats)]
        return summary_html(
            "Recommendation", self.sentence, ["property", "value", "unit"], self._rows, notes
        )


def recommend(
    ensemble: Ensemble,
    reference: str | None = None,
    scheduling: str | None = None,
    *,
    model: Model | None = None,
    diagnosis: Diagnosis | None = None,
) -> Recommendation:
    """Say which method suits an ensemble, and why, by what is measured in it.

    The properties are held against :data:`tvsysid.recommendation.RULES`, each of which a kind of
    simulated data in ``benchmarks/recommend.py`` stands for; docs/which-method.md has the table and
    how often it is right.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    reference
        Channel with the disturbance that was applied, or the actuator's command, if the angle may
        not be imposed.
    scheduling
        Channel with a variable that the joint follows and that differs between realizations.
    model
        What ``adaptive`` found in this ensemble, if that is known; otherwise it is identified here.
    diagnosis
        Of this ensemble, with the same reference, if that is known.

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
    adaptive: stiffness switches, which it places and other methods smear
    >>> found.method
    AdaptiveRegression(emg=None)
    """
    if not isinstance(ensemble, Ensemble):
        raise InputError(
            f"recommend: expected an Ensemble, got {type(ensemble).__name__}; cut a Recording first"
        )
    for name in filter(None, (reference, scheduling)):
        ensemble.signal(name)  # raises for one that there is not
    with single_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        with suppress(InputError):  # a single realization, or too short
            diagnosis = diagnosis or diagnose(ensemble, reference)
        measured = measured_in(ensemble, diagnosis, reference, scheduling, model)
    rule = rule_of(measured)
    known = {name: value for name, (value, _) in measured.items()} | {
        "reference": reference,
        "scheduling": scheduling,
    }
    suited = [typed.format(**known) for typed in rule.methods]
    suited = [typed for typed in suited if not reason_to_skip(parse(typed), ensemble)]
    unnamed = tuple(
        moving(
            ensemble, [name for name in ensemble.channels if name not in (reference, scheduling)]
        )
    )
    caveats = (*_caveats(diagnosis, measured), *unnamed)
    against = _against(suited, ensemble, measured, known)
    return Recommendation(
        tuple(suited), rule.why.format(**known), measured, against, caveats, diagnosis, unnamed
    )


def moving(ensemble: Ensemble, channels: Iterable[str]) -> Iterator[str]:
    """Yield a sentence for each of these channels that moves the angle as a reference does."""
    for name in channels:
        seen = find_reference(ensemble, name)
        if seen.found:
            yield (
                f"Channel {name!r} moves the angle, and was not named as the reference: "
                f"{seen.what}."
            )


def _against(
    suited: list[str], ensemble: Ensemble, measured: Measured, known: Mapping[str, object]
) -> dict[str, str]:
    """Why not the other usual methods: they do not apply, what is measured, or what makes their stiffness differ."""
    found = {}
    for key in DEFAULT_METHODS if suited else ():
        if key != key_of(suited[0]):
            method = parse(key)
            told = (
                text.format(**known)
                for condition, keys, text in AGAINST
                if key in keys and holds(condition, measured)
            )
            found[key] = reason_to_skip(method, ensemble) or next(
                told, str(getattr(method, "differs", ""))
            )
    return found


def _short(value: float) -> str:
    """Three digits, and all before the point."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _alike(wanted: Identifies, method: object) -> bool:
    """Whether a method is the one wanted, but for settings that are chosen from the data."""
    own, other = (
        getattr(each, "method", each) for each in (wanted, method)
    )  # of a tuned one, what is tuned
    usual = settings_of(type(own)())
    return type(other) is type(own) and all(
        getattr(other, name) == each
        for name, each in settings_of(own).items()
        if each != usual.get(name)
    )


def _caveats(diagnosis: Diagnosis | None, measured: Measured) -> tuple[str, ...]:
    """What the diagnosis found, and what it could not see."""
    if diagnosis is None:
        return ("a single realization, or one too short, cannot be diagnosed",)
    found = [
        f"{each.fault.title.lower()}: {each.fault.effect}"
        for each in diagnosis.findings
        if each.name not in SAID
    ]
    loud = any(holds(each, measured) for each in (IS_SLOW, IS_STRONG))
    if loud and not any(check.name == "loop-bias" for check in diagnosis.checks):
        found.append(MAY_BE_A_LOOP)
    return (*found, *diagnosis.remarks)
