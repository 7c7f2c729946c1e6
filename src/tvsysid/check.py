"""Check your own method on simulated joints of known stiffness."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import attrs
import cloudpickle
import numpy as np

from tvsysid import simulate
from tvsysid.errors import describe_error, without_quality_warnings
from tvsysid.methods import Method, resolve
from tvsysid.metrics import vaf
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Array, Ensemble

DURATION_S = 150.0  # of a simulated record
CONSTANT_STIFFNESS = simulate.Constant(100.0)


@attrs.frozen
class Check:
    """Result of one check.

    The message says what happened and, if the method failed, what to do.
    """

    name: str
    passed: bool
    message: str


def check_method(method: Method) -> list[Check]:
    """Check a method on simulated joints of known stiffness.

    The joints have the channels that the method reads. An exception in the method makes a check
    fail, and is not raised. If the method does not identify the first joint, the checks end.

    Examples
    --------
    >>> from tvsysid.methods import parse
    >>> all(check.passed for check in check_method(parse("sds")))
    True
    """
    results: list[Check] = []
    identify_first = cache(lambda: identify_joint(method))
    with single_thread(), without_quality_warnings():
        for check in CHECKS:
            try:
                passed, happened, advice = check(identify_first())
                message = happened if passed else f"{happened}; {advice}"
            except Exception as error:
                passed, message = False, describe_error(error)
            results.append(Check(check.__name__.replace("_", " "), bool(passed), message))
            if not results[0].passed:
                break
    return results


class IdentifiedJoint(NamedTuple):
    """Model of a simulated joint, and its true stiffness in N·m/rad, shape (time,)."""

    method: Method
    ensemble: Ensemble
    truth: Array
    model: Model


def identify_joint(
    method: Method,
    seed: int = 1,
    stiffness: simulate.Profile = CONSTANT_STIFFNESS,
    rate: float = 100.0,
    period: float = 2.0,
    duration: float = DURATION_S,
) -> IdentifiedJoint:
    """Simulate a joint and identify it with a method. Times are in s, the rate is in Hz."""
    kinds = {item.kind for item in method.inputs}
    default = "compliant" if "reference" in kinds else "scheduled" if kinds else "joint"
    joint = resolve(method.system or default, simulate.SYSTEMS, "system")
    perturbation = resolve(method.perturbation or "noise", simulate.PERTURBATIONS, "perturbation")
    simulation = attrs.evolve(joint, stiffness=stiffness).simulate(
        duration, perturbation=perturbation, snr_db=30.0, seed=seed, rate=8 * rate
    )
    names = [item.name for item in method.inputs]
    channels = dict(zip(names, simulation.recording.channels.values(), strict=False))
    recording = attrs.evolve(simulation.recording, channels=channels)
    ensemble = segment(decimate(recording, rate), period)
    truth = simulation.truth_of(ensemble)["stiffness"].mean(axis=0)
    return IdentifiedJoint(method, ensemble, truth, method.identify(ensemble))


Judgement = tuple[bool, str, str]  # whether the check passed, what happened, and advice if not


def identifies_a_joint(joint: IdentifiedJoint) -> Judgement:
    """Identify stiffness at most times."""
    unknown = 100 * np.isnan(joint.model.stiffness).mean()
    names = ", ".join(["angle", "torque", *joint.ensemble.channels])
    advice = f"{unknown:.0f} % of the values are NaN; expected numbers at most times"
    return unknown <= 50, f"from {names} of {joint.ensemble!r}", advice


def recovers_a_constant_stiffness(joint: IdentifiedJoint) -> Judgement:
    """Compare the mean stiffness with the truth."""
    mean = mean_of(joint.model.stiffness)
    return (
        90 <= mean <= 110,
        f"mean {mean:.3g} N·m/rad, true 100",
        "expected at most 10 % off. Are the units rad and N·m? Does a positive torque resist a "
        "positive angle?",
    )


def predicts_the_torque(joint: IdentifiedJoint) -> Judgement:
    """Predict other data of the joint."""
    other = identify_joint(joint.method, seed=3, duration=40.0)
    torque = other.ensemble.torque[:, other.ensemble.core]
    share = mean_of(vaf(torque, joint.model.predict(other.ensemble)))
    return (
        share > 80,
        f"VAF {share:.1f} % of the torque in other data",
        "expected more than 80 %. Does the torque include viscosity and inertia? Is it "
        "aligned in time?",
    )


def follows_a_changing_stiffness(joint: IdentifiedJoint) -> Judgement:
    """Follow a sine wave of stiffness."""
    if joint.method.time_invariant:
        return True, "not tested: the method assumes a constant joint (time_invariant = True)", ""
    joint = identify_joint(joint.method, 2, simulate.SineWave())
    error = np.sqrt(np.nanmean((joint.model.stiffness - joint.truth) ** 2))
    return (
        error < 20,
        f"error {error:.1f} N·m/rad RMS, with a sine of ±50 N·m/rad",
        "expected less than 20; a constant stiffness has 35. A method that assumes a constant "
        "joint should have time_invariant = True",
    )


def gives_the_same_numbers_again(joint: IdentifiedJoint) -> Judgement:
    """Identify the first joint again, by a copy of the method that has identified other joints."""
    again = identify_joint(cloudpickle.loads(cloudpickle.dumps(joint.method)))
    same = np.allclose(again.model.stiffness, joint.model.stiffness, 1e-9, 0.0, equal_nan=True)
    return (
        same,
        f"{'the same' if same else 'another'} stiffness the second time",
        "give random numbers a fixed seed, keep all settings in the object itself, and keep "
        "no results between calls",
    )


def works_at_another_rate_and_length(joint: IdentifiedJoint) -> Judgement:
    """Identify at 128 Hz and 1.5 s."""
    other = identify_joint(joint.method, 4, simulate.SineWave(period=1.5), 128.0, 1.5)
    other.model.predict(other.ensemble)  # raises if the model has another rate
    mean = mean_of(other.model.stiffness)
    return (
        85 <= mean <= 115,
        f"at 128 Hz and 1.5 s: mean {mean:.3g} N·m/rad, true 100",
        "expected at most 15 % off. Use ensemble.sampling_rate and ensemble.samples instead of "
        "numbers that hold at 100 Hz and 2 s",
    )


CHECKS = (
    identifies_a_joint,
    recovers_a_constant_stiffness,
    predicts_the_torque,
    follows_a_changing_stiffness,
    gives_the_same_numbers_again,
    works_at_another_rate_and_length,
)
