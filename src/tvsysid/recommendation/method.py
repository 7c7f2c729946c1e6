"""Recommend a method for an ensemble: measure its properties, and apply the rules."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import NamedTuple

import attrs

from tvsysid.errors import InputError, without_quality_warnings
from tvsysid.methods import METHODS, KernelRegression, from_text, key_of, parse
from tvsysid.methods.base import Method, reason_to_skip
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import FAULTS, Diagnosis, diagnose
from tvsysid.quality.checks import judge
from tvsysid.quality.fit import FittedEnsemble, at_diagnosis_rate
from tvsysid.signals import Ensemble, check_ensemble

BANDS_HZ = (0.0, 5.0), (8.0, 25.0)  # slow and fast noise are compared
SLOW_NOISE_DB = 10.0  # power of slow over fast noise, above which noise is slow
MIN_FEEDBACK_PERCENT = 0.1  # of the torque, that later movement predicts; in open loop it is less
BIAS_PERCENT = 10.0  # of the stiffness, by noise
MAX_BIAS_PERCENT = 30.0  # largest bias by noise that other weights of the frequencies correct
LOOP_BIAS_PERCENT = 5.0  # of the stiffness, by a closed loop
MIN_INFORMATION = 2.0  # realizations at a signal-to-noise ratio of 0 dB
CLOSED_LOOP = "noise in the torque moves the angle (a closed loop)"
LOW_STIFFNESS = CLOSED_LOOP + ": frequencies with noise make stiffness {noise_bias:.0f} % lower"
RECORD_REFERENCE = "Record the disturbance or the actuator's command"


@attrs.frozen
class DataProperties:
    """Properties of the data that the rules use. NaN or None where unknown."""

    realizations: int = 0
    reference: str | None = None
    scheduling: str | None = None
    information: float = math.nan  # realizations at a signal-to-noise ratio of 0 dB
    feedback: float = math.nan  # %, of the torque that later movement predicts
    slow_noise: float = math.nan  # dB, power density below 5 Hz over that at 8 to 25 Hz
    noise_bias: float = math.nan  # %, by which stiffness rises if noisy frequencies weigh less
    loop_bias: float = math.nan  # %, of the stiffness
    faults: frozenset[str] = frozenset()

    @property
    def is_slow(self) -> bool:
        """Whether the torque's noise is slow."""
        return self.slow_noise > SLOW_NOISE_DB

    @property
    def is_biased(self) -> bool:
        """Whether slow noise lowers the stiffness."""
        return self.is_slow and self.noise_bias > BIAS_PERCENT


class Rule(NamedTuple):
    """Row of the decision table.

    ``holds`` says whether the row applies. ``methods`` are typed as on the command line, the best
    first; empty where no method is right. ``why`` is the reason. In both, a property in braces
    stands for its value.
    """

    holds: Callable[[DataProperties], bool]
    methods: tuple[str, ...]
    why: str


# The first rule that holds decides.
RULES = (
    Rule(
        lambda data: data.scheduling is not None,
        ("lpvkbi:variable={scheduling}", "lpv:variable={scheduling}"),
        "the joint follows {scheduling!r}, which was recorded and differs between realizations",
    ),
    Rule(
        lambda data: any(FAULTS[name].severity == "invalid" for name in data.faults),
        (),
        "the data have a fault that makes every method's stiffness wrong. The diagnosis names "
        "it and says what to do: tv.diagnose(ensemble), tvsysid inspect --diagnose",
    ),
    Rule(
        lambda data: data.information < MIN_INFORMATION,
        (),
        "the torque that depends on the angle is too weak for a stiffness over time (worth "
        "{information:.1f} realizations at 0 dB). Perturb more, or record more",
    ),
    Rule(
        lambda data: data.loop_bias > LOOP_BIAS_PERCENT and not data.is_slow,
        ("birf:reference={reference},tuned=true", "kbr:reference={reference}"),
        CLOSED_LOOP + "; it does not move {reference!r}",
    ),
    Rule(
        lambda data: (
            data.loop_bias > LOOP_BIAS_PERCENT
            or ("feedback" in data.faults and data.reference is not None)
        ),
        (
            "kbr:reference={reference},weighting=residual,tuned=true",
            "kbr:reference={reference},weighting=residual",
            "birf:reference={reference}",
        ),
        CLOSED_LOOP
        + "; it does not move {reference!r}; frequencies with little noise have more weight",
    ),
    Rule(
        lambda data: "feedback" in data.faults,
        (),
        f"{CLOSED_LOOP}, which biases every method, and no reference is named. {RECORD_REFERENCE}",
    ),
    Rule(  # before the rules on noise bias: stiffness with a reflex depends on frequency, too
        lambda data: "reflex" in data.faults,
        ("adaptive", "cascade"),
        "the data show a stretch reflex, and adaptive separates it from the stiffness",
    ),
    Rule(
        lambda data: data.is_slow and data.noise_bias > MAX_BIAS_PERCENT,
        (),
        f"{LOW_STIFFNESS}. Every method is biased. {RECORD_REFERENCE}",
    ),
    Rule(
        lambda data: data.is_biased,
        ("kbr:weighting=residual",),
        f"{LOW_STIFFNESS}. Frequencies with little noise have the most weight",
    ),
    Rule(
        lambda data: data.realizations < 4,
        ("cascade", "kbr"),
        "there are too few realizations to tell a switch from noise; cascade finds how smooth "
        "stiffness is from all of its harmonics together",
    ),
    Rule(
        lambda data: True,
        ("adaptive", "kbr:tuned=true", "kbr"),
        "the movement repeats, and adaptive finds from the data how fast stiffness changes, and "
        "whether it switches",
    ),
)


@attrs.frozen(eq=False, repr=False)
class Recommendation:
    """Recommended method for an ensemble, and the reason.

    Parameters
    ----------
    suited
        Methods as the command line takes them, as in ``"kbr:weighting=residual,tuned=true"``, the
        best first. Empty where no method is right.
    why
        Reason for the first, in a sentence.
    measured
        Properties of the data.
    diagnosis
        Diagnosis of the ensemble, or why there is none.
    unnamed_references
        A sentence for each channel that moves the angle and was not named as the reference.
    """

    suited: tuple[str, ...]
    why: str
    measured: DataProperties = DataProperties()
    diagnosis: Diagnosis | str = "not diagnosed"
    unnamed_references: tuple[str, ...] = ()

    @property
    def method(self) -> Method | None:
        """The method, ready to use: ``recommend(ensemble).method.identify(ensemble)``.

        None where no method is right.
        """
        return parse(self.suited[0]) if self.suited else None

    def select(self, methods: Mapping[str, Method]) -> list[str]:
        """Return the labels of the ``methods`` that suit, the best first.

        A method suits if it has the settings that the recommendation names. Whether they were
        chosen from the data does not matter.
        """
        labels: list[str] = []
        for text in dict.fromkeys(re.sub("[:,]tuned=true", "", each) for each in self.suited):
            key = key_of(text)
            for label, method in methods.items():
                is_alike = type(method) is METHODS[key]
                # If applying the text's settings changes nothing, the method has them already.
                if is_alike and from_text(text, "method", {key: method}) == method:
                    labels.append(label)
        return labels

    def __repr__(self) -> str:
        first = self.suited[0] if self.suited else "no method is right"
        return "\n".join([f"Recommendation: {first}: {self.why}", *self.unnamed_references])


def recommend(
    ensemble: Ensemble,
    reference: str | None = None,
    scheduling: str | None = None,
    *,
    diagnosis: Diagnosis | str | None = None,
) -> Recommendation:
    """Recommend a method for an ensemble by measured properties of the data.

    The first rule that holds decides. The page docs/which-method.md has the rules as a table, and
    how often they are right.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    reference
        Channel with the disturbance that was applied, or the actuator's command, if it is not sure
        that the angle is imposed.
    scheduling
        Channel with a variable that the joint follows and that differs between realizations.
    diagnosis
        Diagnosis of this ensemble with the same reference, or why there is none, if known.

    Raises
    ------
    InputError
        If it is no ensemble, or there is no such channel.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(
    ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> found = tv.recommend(tv.preprocess.subtract_mean(ensemble))
    >>> found.suited
    ('adaptive', 'kbr:tuned=true', 'kbr')
    >>> found.method
    AdaptiveRegression(emg=None)
    """
    check_ensemble("recommend", ensemble)
    for name in filter(None, (reference, scheduling)):
        ensemble.signal(name)  # raises if there is no such channel
    measured = DataProperties(len(ensemble), reference, scheduling)
    unnamed: tuple[str, ...] = ()
    with single_thread(), without_quality_warnings():
        try:
            diagnosis = diagnosis or diagnose(ensemble, reference)
        except InputError as error:  # a single realization, or too short
            diagnosis = str(error).removeprefix("diagnose: ")
        if isinstance(diagnosis, Diagnosis) and scheduling is None:
            measured = measure(measured, at_diagnosis_rate(ensemble), diagnosis)
            others = (name for name in ensemble.channels if name != reference)
            unnamed = tuple(find_unnamed_references(ensemble, others))
    rule = next(rule for rule in RULES if rule.holds(measured))
    values = attrs.asdict(measured)
    typed = (text.format(**values) for text in rule.methods)
    suited = tuple(text for text in typed if not reason_to_skip(parse(text), ensemble))
    return Recommendation(suited, rule.why.format(**values), measured, diagnosis, unnamed)


def find_unnamed_references(ensemble: Ensemble, channels: Iterable[str]) -> Iterator[str]:
    """Yield a sentence for each of these channels that moves the angle as a reference does."""
    for name in channels:
        finding = judge("loop-bias", FittedEnsemble.of(ensemble), name, False)
        if finding.found:
            yield (
                f"Channel {name!r} moves the angle, and was not named as the reference: "
                f"{finding.what}."
            )


def measure(known: DataProperties, ensemble: Ensemble, diagnosis: Diagnosis) -> DataProperties:
    """Add to the ``known`` properties those from the diagnosis and from fits to the ensemble."""
    findings = {each.name: each for each in diagnosis.checks}
    ratio = diagnosis.measures["signal-to-noise ratio"][0]
    loop = findings.get("loop-bias")
    measured = attrs.evolve(
        known,
        information=len(ensemble) * 10 ** (ratio / 10),
        feedback=findings["feedback"].value,
        slow_noise=_slow_noise(diagnosis),
        loop_bias=abs(loop.value) if loop and loop.fault.beyond(loop.value) else math.nan,
        faults=frozenset(each.name for each in diagnosis.findings),
    )
    if not measured.is_slow:
        return measured
    with suppress(InputError):  # a method cannot identify the data
        plain, weighted = (
            mean_of(KernelRegression(weighting=weighting).identify(ensemble).stiffness)
            for weighting in ("white", "residual")
        )
        scale = max(abs(weighted), abs(plain))
        measured = attrs.evolve(measured, noise_bias=100 * (weighted - plain) / scale)
    return measured


def _slow_noise(diagnosis: Diagnosis) -> float:
    """Return the ratio in dB of the noise's mean power density below 5 Hz to that at 8 to 25 Hz."""
    frequency, power = diagnosis.curves.frequency, diagnosis.curves.residual_power
    bands = ((frequency > start) & (frequency <= stop) for start, stop in BANDS_HZ)
    low, high = (power[band].mean() for band in bands)
    return 10 * math.log10(low / high) if low > 0 and high > 0 else math.nan
