"""Find faults of an ensemble, before or after identification."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from typing import TYPE_CHECKING

import attrs
import numpy as np

from tvsysid.numerics.threads import single_thread

# Importing these modules registers their checks, in the order of the report.
from tvsysid.quality import (
    amount,  # noqa: F401
    channels,  # noqa: F401
    delays,  # noqa: F401
    realizations,
    sensors,  # noqa: F401
    structure,  # noqa: F401
)
from tvsysid.quality.checks import FAULTS, Finding, judge
from tvsysid.quality.curves import Curves, curves
from tvsysid.quality.fit import FittedEnsemble
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

OF_MORE_DATA = ("loop-bias", "gaps", "mains")
# Checks of the ensemble as given. The others run after drifting offsets and delay are removed.
AS_GIVEN = ("same-channel", "mean-torque", "mean-angle", "angle-offset", "torque-offset")
# Checks that assume the same movement in all realizations.
OF_REPETITION = (
    "drift",
    "misaligned-realizations",
    "unlike-realizations",
    "wrong-period",
    "scattered-realizations",
)
BANDWIDTH_POWER = 0.95  # share of the angle's power within its bandwidth


@attrs.frozen(eq=False, repr=False)
class Diagnosis:
    """Results of all checks of an ensemble.

    Parameters
    ----------
    checks
        Findings in the order of :data:`FAULTS`. ``loop-bias`` is among them if a reference was
        given, ``gaps`` and ``mains`` if the recording was given.
    measures
        Values about the ensemble by name, with their unit: ``{"bandwidth": (8.9, "Hz"), ...}``.
    curves
        Curves that the figures show.
    ensemble
        Description of the ensemble.
    """

    checks: tuple[Finding, ...]
    measures: dict[str, tuple[float, str]]
    curves: Curves
    ensemble: str

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Checks that found a fault."""
        return tuple(check for check in self.checks if check.found)

    @property
    def table(self) -> pd.DataFrame:
        """Return a row for each check: name, state, value, limit, severity, what, remedy, ..."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(
            attrs.asdict(each) | {"state": each.state} | each.fault._asdict()
            for each in self.checks
        )

    @property
    def verdict(self) -> str:
        """Return the result in words, with the number of checks that apply to these data."""
        states = Counter(check.state for check in self.checks)
        judged = len(self.checks) - states["not judged"]
        found = f"{states['found'] or 'no'} fault{'s' * (states['found'] > 1)}"
        uncertain = f", {states['uncertain']} uncertain" if states["uncertain"] else ""
        return f"{found} found{uncertain} ({judged} of {len(FAULTS)} checks are possible)"

    @property
    def notes(self) -> tuple[str, ...]:
        """Return a line for each reason why checks are uncertain or not judged."""
        names = defaultdict[tuple[str, str], list[str]](list)
        for check in self.checks:
            if check.state in ("uncertain", "not judged"):
                names[check.state, check.what].append(check.name)
        return tuple(
            f"{state}: {', '.join(those)} ({what})" for (state, what), those in names.items()
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


@single_thread()
def diagnose(
    ensemble: Ensemble,
    reference: str | None = None,
    *,
    repeats: bool = True,
    recording: Recording | None = None,
) -> Diagnosis:
    r"""Find faults of an ensemble, with their effects on the result and their remedies.

    A joint of second order, :math:`y = k(t)\,\theta + b(t)\,\dot\theta + I\,\ddot\theta`, with
    stiffness and viscosity free in bins of 50 ms, is fitted to the deviations from the mean over
    realizations. The fit reveals wrong units, signs and rates. Its residual reveals feedback and
    lost signals. Changes of both from realization to realization reveal drift and misalignment. A
    comparison of models with and without a reflex reveals a reflex.

    A check finds a fault if its value is beyond the limit. Where noise can cause such a value, it
    must also be significant (p < 0.00001; reflexes twice p < 0.0001). These tests use the scatter
    over realizations, so the noise may have any colour. Other checks count events that noise does
    not cause, or state a size. docs/diagnosis.md gives the kind of each check.

    Parameters
    ----------
    ensemble
        Realizations of one repeated movement. If their mean is not subtracted, a check finds it.
    reference
        Channel with the disturbance that was applied, or the actuator's command. It shows best
        whether the joint is in closed loop (``loop-bias``).
    repeats
        Whether the movement is the same in all realizations. It is False for pieces of a record
        without a period. Drift, a wrong period and realizations unlike the others are then not
        judged.
    recording
        Record from which the ensemble was cut, before decimation. Without it, gaps and mains hum
        are not checked.

    Raises
    ------
    InputError
        For a single realization, or realizations too short for derivatives.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(60, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> recording = tv.preprocess.decimate(simulation.recording, 100)
    >>> ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
    >>> tv.diagnose(ensemble)
    Diagnosis of 30 realizations of 2 s at 100 Hz: no fault found (26 of 32 checks are possible)
    not judged: mean-torque, mean-angle (the mean over realizations has been subtracted)
    not judged: clipped-angle (values of the angle repeat, not only extremes: no sign of clipping)
    """
    given = FittedEnsemble.of(ensemble)
    steady = realizations.without_drifting_offsets(given)
    delay = steady.finding("delay")
    data = steady.advance(delay.value * steady.rate / 1000) if delay.significant else steady
    subjects = dict.fromkeys(AS_GIVEN, given) | {"delay": steady}
    found = {
        name: subjects.get(name, data).finding(name) for name in FAULTS if name not in OF_MORE_DATA
    }
    if reference is not None:
        found["loop-bias"] = judge("loop-bias", data, reference)
    if recording is not None:
        found |= diagnose_recording(recording)
    reasons = {} if repeats else dict.fromkeys(OF_REPETITION, "the movement is not repeated")
    if found["same-channel"].found:
        others = found.keys() - {"same-channel"}
        reasons |= dict.fromkeys(others, "angle and torque are one signal")
    found |= {name: Finding(name, math.nan, reason, False) for name, reason in reasons.items()}
    description = (
        f"{len(ensemble)} realizations of {ensemble.duration:g} s at {ensemble.sampling_rate:g} Hz"
    )
    return Diagnosis(
        tuple(found[name] for name in FAULTS if name in found),
        _measures(data),
        curves(given),
        description,
    )


def diagnose_recording(recording: Recording) -> dict[str, Finding]:
    """Run the checks ``gaps`` and ``mains`` on a recording that is not decimated."""
    return {name: judge(name, recording) for name in ("gaps", "mains")}


def _measures(data: FittedEnsemble) -> dict[str, tuple[float, str]]:
    """Return values that describe an ensemble, with their units."""
    (stiffness, viscosity, inertia), _ = data.fit.mean_impedance
    angle = data.core("angle")
    explained = np.clip(data.fit.explained, 1e-9, 1 - 1e-9)
    power = np.cumsum(np.mean(np.abs(np.fft.rfft(angle, axis=1)[:, 1:]) ** 2, axis=0))
    within = 1 + np.searchsorted(power, BANDWIDTH_POWER * power[-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        natural = np.sqrt(stiffness / inertia) / (2 * math.pi)
    return {
        "mean stiffness": (stiffness, "N·m/rad"),
        "mean viscosity": (viscosity, "N·m·s/rad"),
        "inertia": (inertia, "kg·m²"),
        "natural frequency": (natural, "Hz"),
        "angle RMS": (angle.std(), "rad"),
        "bandwidth of the angle": (within / data.ensemble.duration, "Hz"),
        "explained torque": (100 * data.fit.explained, "%"),
        "signal-to-noise ratio": (10 * math.log10(explained / (1 - explained)), "dB"),
    }
