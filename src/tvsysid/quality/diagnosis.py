"""One verb: what is wrong with an ensemble, before or after it is identified."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.moments import window_moments
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import delays, losses, realizations, scales, structure, timing
from tvsysid.quality.catalogue import FAULTS, Fault
from tvsysid.quality.curves import Curves, curves
from tvsysid.quality.fitted import FittedEnsemble, NotJudged, Seen
from tvsysid.quality.resampling import SHORTEST, known_samples
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

OF_ANY_SIGNAL = (
    "few-realizations",
    "repeated-realizations",
    "same-channel",
)  # do not take the torque for an answer
OF_REPETITION = (
    "drift",
    "misaligned-realizations",
    "unlike-realizations",
    "wrong-period",
    "scattered-realizations",
)  # take all realizations for one behaviour
MOST_POWER = 0.95  # share of the angle's power that lies within its bandwidth
# in s, to either side, of the correlation matrix that is looked at: those of impulse-response
# methods
LAGS = 0.12


@attrs.frozen
class Finding:
    """One thing that was looked at in an ensemble, and what was seen.

    Parameters
    ----------
    name
        Its key in the catalogue, such as ``"drift"``.
    value, significant
        How strong it is, in the unit of its fault, and whether that is more than noise explains.
        NaN where it could not be judged.
    what
        What was seen, in words; why it could not be judged where it was not.
    realizations
        Indices of the realizations concerned, of faults that single ones have.
    """

    name: str
    value: float
    significant: bool
    what: str
    realizations: tuple[int, ...] = ()

    @property
    def fault(self) -> Fault:
        """What was looked for: title, measure, unit, limit, effect and remedy."""
        return FAULTS[self.name]

    @property
    def judged(self) -> bool:
        """Whether the data allow a judgement at all."""
        return not math.isnan(self.value)

    @property
    def beyond(self) -> bool:
        """Whether the value is on the wrong side of its limit, significant or not."""
        return self.fault.beyond(self.value)

    @property
    def found(self) -> bool:
        """Whether it is wrong: beyond its limit, and significant."""
        return self.beyond and self.significant

    @property
    def state(self) -> str:
        """Return ``"found"``, ``"in order"``, ``"uncertain"`` or ``"not judged"``.

        Uncertain is a value beyond the limit that is not significant.
        """
        if self.found:
            return "found"
        return "uncertain" if self.beyond else "in order" if self.judged else "not judged"

    @property
    def strength(self) -> str:
        """Value against limit, in words.

        Examples
        --------
        >>> Finding("drift", 24.3, True, "").strength
        '24.3 %, at most 10 is in order'
        """
        if not self.judged:
            return "–"
        fault, size = self.fault, abs(self.value)
        value = "0" if size < 1e-9 else f"{self.value:.3g}" if size < 1e4 else f"{self.value:.2g}"
        unit = fault.unit.removesuffix("s") if value == "1" else fault.unit
        sign = "±" if self.value < 0 else ""
        too_low = fault.wrong == "below" or size < fault.lowest
        allowed = (
            f"at least {fault.lowest or fault.limit:g}"
            if too_low
            else f"at most {sign}{fault.limit:g}"
        )
        caveat = ", but not significant" if self.state == "uncertain" else ""
        return f"{value} {unit}, {allowed} is in order{caveat}"

    def __repr__(self) -> str:
        return f"Finding({self.name}: {self.state}; {self.what})"


@attrs.frozen(eq=False, repr=False)
class Diagnosis:
    """What was looked at in an ensemble, and what is wrong with it.

    Parameters
    ----------
    checks
        Everything that was looked at, in the order of the catalogue; ``loop-bias`` where a
        reference was given, ``gaps`` and ``mains`` where the recording was.
    measures
        Values about the ensemble by name, with their unit: ``{"bandwidth": (8.9, "Hz"), ...}``.
    curves, ensemble
        What the pictures show; what was diagnosed, in words.
    remarks
        What is no fault but limits the result, or could be better.
    """

    checks: tuple[Finding, ...]
    measures: dict[str, tuple[float, str]]
    curves: Curves
    ensemble: str
    remarks: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The checks that found something wrong."""
        return tuple(check for check in self.checks if check.found)

    @property
    def uncertain(self) -> tuple[Finding, ...]:
        """The checks whose value is beyond its limit, but not significant."""
        return tuple(check for check in self.checks if check.state == "uncertain")

    @property
    def clean(self) -> bool:
        """Whether nothing was found, and nothing is uncertain."""
        return not self.findings and not self.uncertain

    @property
    def table(self) -> pd.DataFrame:
        """Return a row for each check: name, state, value, limit, what, effect, remedy."""
        import pandas as pd  # noqa: PLC0415  # heavy

        own = ("name", "state", "found", "value", "what")
        rows = [
            {name: getattr(check, name) for name in own} | check.fault._asdict()
            for check in self.checks
        ]
        return pd.DataFrame(
            rows, columns=[*own[:4], "unit", "wrong", "limit", "lowest", "what", "effect", "remedy"]
        )

    @property
    def verdict(self) -> str:
        """Return the outcome in a sentence, with the number of checks that apply to these data."""
        judged = f"{sum(check.judged for check in self.checks)} of {len(FAULTS)}"
        count, uncertain = len(self.findings), len(self.uncertain)
        if uncertain and not count:
            return f"{uncertain} uncertain in {judged} checks, nothing found for sure"
        also = f", {uncertain} uncertain" if uncertain else ""
        return f"{count or 'no'} fault{'' if count < 2 else 's'} found in {judged} checks{also}"

    @property
    def notes(self) -> tuple[str, ...]:
        """Return a line on uncertain checks, one on checks that were not judged, and the remarks.

        The lines include the values and the reasons.
        """
        uncertain = [f"{check.name} ({check.strength})" for check in self.uncertain]
        reasons: dict[str, list[str]] = {}
        for check in self.checks:
            if not check.judged:
                reasons.setdefault(check.what, []).append(check.name)
        unknown = [f"{', '.join(names)} ({why})" for why, names in reasons.items()]
        lines = {"uncertain": uncertain, "not judged": unknown}
        return (
            *(f"{state}: {'; '.join(told)}" for state, told in lines.items() if told),
            *self.remarks,
        )

    def __repr__(self) -> str:
        lines = [f"Diagnosis of {self.ensemble}: {self.verdict}"]
        for check in self.findings:
            lines += [
                f"- {check.name}: {check.what} ({check.strength})",
                f"    effect: {check.fault.effect}",
                f"    remedy: {check.fault.remedy}",
            ]
        return "\n".join([*lines, *self.notes])

    def plot(self, title: str = "") -> Figure:
        """Draw the evidence of the checks."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above

        return plot(self, title)


def diagnose(
    ensemble: Ensemble,
    reference: str | None = None,
    *,
    repeats: bool = True,
    recording: Recording | None = None,
) -> Diagnosis:
    r"""Look for what is wrong with an ensemble, and say what it does to the result and what to do.

    A joint of second order, :math:`y = k(t)\,\theta + b(t)\,\dot\theta + I\,\ddot\theta`, with
    stiffness and viscosity free in bins of 50 ms, is fitted to the deviations from the mean over
    realizations. The fit reveals wrong units, signs and rates; its residual feedback and lost
    signals; how both vary over realizations drift and misalignment. Models with and without one
    reveal reflexes. A finding must be beyond its limit. Where noise can reach that, it must also be
    significant (p < 0.00001; reflexes twice p < 0.0001), by the scatter over realizations, so that
    noise may have any colour; the rest counts what noise does not do, or states a size.
    docs/diagnosis.md says which check is of which kind.

    Parameters
    ----------
    ensemble
        Realizations of one repeated behaviour; mean subtracted, or not (which is then found). An
        InputError is raised for a single one, or for realizations that are too short for
        derivatives.
    reference
        Channel with the disturbance that was applied, or the actuator's command: whether the joint
        is in closed loop shows best by it (``loop-bias``).
    repeats
        Whether the behaviour is the same in all realizations. If it is not, as in pieces of a
        record without period, drift, a wrong period and realizations unlike the others are no
        faults, and not judged.
    recording
        Record that the ensemble was cut from, before decimation: gaps and mains hum show in it
        alone.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(60, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> recording = tv.preprocess.decimate(simulation.recording, 100)
    >>> ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
    >>> tv.diagnose(ensemble)
    Diagnosis of 30 realizations of 2 s at 100 Hz: no fault found in 28 of 34 checks not judged:
    mean-torque, mean-angle (the mean over realizations has been subtracted); clipped-angle (...)
    """
    if not isinstance(ensemble, Ensemble):
        raise InputError(
            f"diagnose: expected an Ensemble, got {type(ensemble).__name__}; cut a Recording with "
            "tvsysid.preprocess.segment"
        )
    if len(ensemble) < 2:
        raise InputError(
            "diagnose: expected at least two realizations to compare, got one; cut the recording "
            "with a shorter period"
        )
    channels = {} if reference is None else {reference: ensemble.signal(reference)}
    data = FittedEnsemble.of(attrs.evolve(ensemble, channels=channels))
    known = known_samples(data.ensemble.samples, data.ensemble.context)
    if known < SHORTEST:
        context = f"{HALF_WIDTH / data.rate:g} s of context"
        instead = context if data.ensemble.samples >= SHORTEST else "a higher rate"
        raise InputError(
            f"diagnose: derivatives are known at {known} samples of a realization at "
            f"{data.rate:g} Hz, it takes "
            f"{SHORTEST}; give longer realizations, or {instead}"
        )
    timely, found = _looked_at(data, reference)
    if recording is not None:
        found |= diagnose_recording(recording)
    if not repeats:
        found |= {
            name: Finding(name, math.nan, False, "the behaviour is not repeated")
            for name in OF_REPETITION
        }
    if found["same-channel"].found:
        # Nothing else that is seen then is of a joint.
        why = "angle and torque are one signal"
        found |= {
            name: Finding(name, math.nan, False, why) for name in found if name not in OF_ANY_SIGNAL
        }
    seen, checks = curves(data), tuple(found[name] for name in FAULTS if name in found)
    words = (
        f"{len(ensemble)} realizations of {ensemble.duration:g} s at {ensemble.sampling_rate:g} Hz"
    )
    misleading = any(
        found[name].found for name in ("same-channel", "same-perturbation", "wrong-period")
    )
    shorter = timing.shorter_period(timely) if repeats and not misleading else ()
    unmoved = () if found["narrow-excitation"].found else scales.unmoved_times(data)
    return Diagnosis(checks, _measures(timely, seen), seen, words, (*unmoved, *shorter))


def find_reflex(ensemble: Ensemble) -> Finding:
    """Look for a stretch reflex alone, in the ensemble as it is.

    No delay and no drifting offset is removed before.
    """
    return _finding("reflex", structure.reflex, FittedEnsemble.of(ensemble))


def find_reference(ensemble: Ensemble, channel: str) -> Finding:
    """Look for ``loop-bias`` with a channel that was not declared as a reference.

    It is found only where the channel drives the angle as a command does.
    """
    return _finding("loop-bias", structure.applied, FittedEnsemble.of(ensemble), channel)


def diagnose_recording(recording: Recording) -> dict[str, Finding]:
    """Look for ``gaps`` and ``mains`` in a record that is not decimated."""
    return {
        check.__name__: _finding(check.__name__, check, recording)
        for check in (losses.gaps, losses.mains)
    }


@single_thread()
def _finding(name: str, check: Callable[..., Seen], *arguments: object) -> Finding:
    try:
        seen = check(*arguments)
    except NotJudged as reason:
        return Finding(name, math.nan, False, str(reason))
    return Finding(name, float(seen.value), bool(seen.significant), seen.what, seen.realizations)


# Checks that need no more than the ensemble less drifting offsets and a delay.
TIMELY: dict[str, Callable[[FittedEnsemble], Seen]] = {
    "few-realizations": scales.few_realizations,
    "weak-answer": scales.weak_answer,
    "narrow-excitation": scales.narrow_excitation,
    "same-perturbation": scales.same_perturbation,
    "repeated-realizations": realizations.repeated,
    "reversed-torque": scales.reversed_torque,
    "angle-unit": scales.angle_unit,
    "torque-unit": scales.torque_unit,
    "sampling-rate": scales.sampling_rate,
    "clock-skew": delays.clock_skew,
    "drift": timing.drift,
    "misaligned-realizations": realizations.misaligned,
    "feedback": structure.feedback,
    "reflex": structure.reflex,
    "slow-answer": structure.slow_answer,
}


@single_thread()
def _looked_at(
    data: FittedEnsemble, reference: str | None
) -> tuple[FittedEnsemble, dict[str, Finding]]:
    """Fit less drifting offsets and a delay, and a finding for each fault."""
    found: dict[str, Finding] = {}

    def look(name: str, check: Callable[..., Seen], *arguments: object) -> Finding:
        found[name] = _finding(name, check, *arguments)
        return found[name]

    look("same-channel", scales.same_channel, data)
    # Drifting offsets and a delay would look like much else: the rest is judged without them.
    lines = []
    for which in ("angle", "torque"):
        look(f"mean-{which}", realizations.mean_left, data, which)
        drifts = look(f"{which}-offset", realizations.offset, data, which).found
        lines.append(realizations.offset_line(data, which) if drifts else np.zeros(len(data)))
    level = data.levelled(*lines)
    late = look("delay", delays.delay, level)
    timely = level.synchronised(late.value * level.rate / 1000 if late.significant else 0.0)
    for name, check in TIMELY.items():
        look(name, check, timely)
    if reference is not None:
        look("loop-bias", structure.loop_bias, timely, reference)
    misplaced = found["misaligned-realizations"]
    unlike = look("unlike-realizations", realizations.unlike, timely, misplaced.realizations)
    period = look("wrong-period", timing.wrong_period, timely, found["drift"].found)
    told = unlike.realizations + (misplaced.realizations if misplaced.found else ())
    look("scattered-realizations", realizations.scattered, timely, told, period.found)
    look("coarse-angle", losses.coarse_angle, data)
    heights = losses.spike_heights(timely)
    for which in ("angle", "torque"):
        look(f"clipped-{which}", losses.clipped, timely, which)
        look(f"lost-{which}", losses.lost, timely, which, heights)
        look(f"{which}-spikes", losses.spikes, timely, which, heights)
    return timely, found


def _measures(data: FittedEnsemble, seen: Curves) -> dict[str, tuple[float, str]]:
    """Values that are good to know, whatever was found."""
    values, _ = data.mean_impedance
    explained = data.explained
    angle = data.core("angle")
    power = np.mean(np.abs(np.fft.rfft(angle, axis=1)) ** 2, axis=0)[1:]
    within = int(np.searchsorted(np.cumsum(power), MOST_POWER * power.sum()))
    frequency = (
        np.sqrt(values[0] / values[2]) / (2 * np.pi) if values[0] * values[2] > 0 else np.nan
    )
    bandwidth = (within + 1) / data.ensemble.duration
    inside = seen.coherence[
        :, (seen.coherence_frequency > 0) & (seen.coherence_frequency <= bandwidth)
    ]
    measures = {
        "mean stiffness": (values[0], "N·m/rad"),
        "mean viscosity": (values[1], "N·m·s/rad"),
        "inertia": (values[2], "kg·m²"),
        "natural frequency": (frequency, "Hz"),
        "angle RMS": (np.sqrt(np.mean(angle**2)), "rad"),
        "bandwidth of the angle": (bandwidth, "Hz"),
        "condition of lagged angles": (_condition(data), "1"),
        "coherence within the bandwidth": (np.median(inside) if inside.size else np.nan, "1"),
        "explained torque": (100 * explained, "%"),
        "signal-to-noise ratio": (
            10 * np.log10(max(explained, 1e-9) / max(1 - explained, 1e-9)),
            "dB",
        ),
    }
    return {name: (float(value), unit) for name, (value, unit) in measures.items()}


def _condition(data: FittedEnsemble) -> float:
    """Return the condition number of the mean correlation matrix of lagged angles.

    Impulse-response methods invert this matrix.
    """
    lags = min(round(LAGS * data.rate), (data.angle.shape[1] - 1) // 2)
    spread = np.linalg.eigvalsh(window_moments(data.angle, data.angle, lags, lags).mean(axis=0))
    # What rounding leaves of the smallest eigenvalue tells nothing.
    return (
        float(1 / max(spread[0] / spread[-1], np.finfo(float).eps)) if spread[-1] > 0 else math.inf
    )
