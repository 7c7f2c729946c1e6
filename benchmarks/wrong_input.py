"""Test whether identify states a wrong stiffness without a warning.

Run ``python benchmarks/wrong_input.py`` from the repository root.

Twelve ways to go wrong, on a simulated joint and, with ``--data FOLDER``, on a tonic ankle and a
walking one, which are not part of this repository (tests say where to get them); the closed
loops are simulated only. For each: the stiffness that is stated, its error over time (root mean
square over that of the true stiffness, as far as that is known), and the answer's first three
lines. Then sound simulated joints, of which no stiffness may be withdrawn. Ends with 1 if one
is, or if a stiffness is wrong by a fifth and the first three lines do not say why.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

import tvsysid as tv
from tvsysid.recommendation import Answer

Array = NDArray[np.float64]

FIFTH = 0.2
RATE = 100.0  # Hz
LATE = 0.005  # s
CLIPPED_AT = 1.0  # standard deviations
PERIOD = 2.0  # s, of simulated joints
KINDS = ("constant", "square", "sine", "reflex")
PERTURBATIONS = ("noise", "prbs", "pulses")


class Case(NamedTuple):
    """A recording, its period in s, and limits of its true stiffness in N·m/rad.

    Each limit is a function of time in s.
    """

    name: str
    recording: tv.Recording
    period: float
    limits: tuple[Callable[[Array], Array], Callable[[Array], Array]]


def main() -> None:
    parser = argparse.ArgumentParser(description="What identify says of wrong input.")
    parser.add_argument("--data", type=Path, help="folder with the real recordings")
    parser.add_argument("--sound", type=int, default=50, help="sound simulated recordings")
    chosen = parser.parse_args()
    console = Console(highlight=False, soft_wrap=True)
    warnings.simplefilter("ignore")
    silent = [look(console, *each) for each in faulty(chosen.data)].count(False)
    answers = [identified(sound(seed), PERIOD) for seed in range(chosen.sound)]
    withdrawn = [each.reasons for each in answers if each.trust == "none"]
    doubtful = sum(each.trust == "doubtful" for each in answers)
    console.print(f"{silent} wrong by a fifth without a word")
    console.print(
        f"{len(withdrawn)} of {chosen.sound} sound ones withdrawn, {doubtful} doubtful", *withdrawn
    )
    sys.exit(int(silent + len(withdrawn) > 0))


def faulty(data: Path | None) -> Iterator[tuple[str, Case, float]]:
    """Yield each fault, the case with it, and the ratio of true seconds to seconds as read."""
    for case in cases(data):
        recording = case.recording
        yield "nothing is wrong", case, 1
        yield "swapped channels", with_signals(case, recording.torque, recording.angle), 1
        yield "degrees", with_signals(case, np.degrees(recording.angle), recording.torque), 1
        yield "N·mm", with_signals(case, recording.angle, 1000 * recording.torque), 1
        yield "reversed sign", with_signals(case, recording.angle, -recording.torque), 1
        yield "period 1 % off", case._replace(period=round(1.01 * case.period + 0.001, 2)), 1
        yield "period doubled", case._replace(period=2 * case.period), 1
        for name, share in (("half the rate", 0.5), ("double rate", 2.0)):
            stated = attrs.evolve(
                recording,
                sampling_rate=share * recording.sampling_rate,
                start=recording.start / share,
            )
            yield name, case._replace(recording=stated), share
        late = np.roll(recording.torque, round(LATE * recording.sampling_rate))
        yield "delay of 5 ms", with_signals(case, recording.angle, late), 1
        centre, range_ = recording.angle.mean(), CLIPPED_AT * recording.angle.std()
        clipped = np.clip(recording.angle, centre - range_, centre + range_)
        yield "clipped angle", with_signals(case, clipped, recording.torque), 1
    for bandwidth, snr_db, cutoff in (
        (40.0, 0.0, 5.0),
        (5.0, 5.0, 20.0),
        (5.0, 0.0, 20.0),
        (5.0, 0.0, 5.0),
    ):
        joint = tv.simulate.CompliantActuator(
            tv.simulate.Constant(100.0), noise_bandwidth=bandwidth
        )
        with_command = joint.simulate(
            120, perturbation=tv.simulate.FilteredNoise(cutoff), snr_db=snr_db, seed=1
        ).recording
        name, limits = (
            f"noise of {bandwidth:g} Hz, {snr_db:g} dB, perturbed up to {cutoff:g} Hz",
            (constant(100.0),) * 2,
        )
        yield "closed loop", Case(name, attrs.evolve(with_command, channels={}), PERIOD, limits), 1
        yield "closed loop, its command unnamed", Case(name, with_command, PERIOD, limits), 1


def constant(value: float) -> Callable[[Array], Array]:
    return lambda time: np.full(len(time), value)


def with_signals(case: Case, angle: Array, torque: Array) -> Case:
    return case._replace(recording=attrs.evolve(case.recording, angle=angle, torque=torque))


def cases(data: Path | None) -> Iterator[Case]:
    """Yield a simulated joint and, from a folder, a tonic ankle and a walking one."""
    square = tv.simulate.SquareWave()
    joint = tv.simulate.Joint(stiffness=square)
    recording = joint.simulate(
        120, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1
    ).recording
    yield Case("simulated", recording, PERIOD, (square, square))
    if data is None:
        return
    recording = tv.read_recording(
        data / "tonic_ankle.mat",
        angle="plantarflexor_angle",
        torque="plantarflexor_torque",
        sampling_rate=1000,
        torque_sign=-1,
    )
    yield Case("tonic", recording, 2.0, (constant(50.0), constant(73.0)))  # published
    recording = tv.read_recording(
        data / "walking_ankle_small_reflex.mat",
        angle="POSITION_SIGNAL",
        torque="TORQUE_SIGNAL",
        sampling_rate=1000,
        torque_sign=-1,
    )
    model = tv.AdaptiveRegression().identify(ensemble_of(recording, 1.5))

    def known(time: Array) -> Array:
        return np.asarray(np.interp(time, model.time, model.stiffness, period=1.5))

    yield Case("walking", recording, 1.5, (known, known))


def sound(seed: int) -> tv.Recording:
    """Simulate a joint with nothing wrong.

    Its stiffness is constant, square, sine, or constant beside a reflex.
    """
    random = np.random.default_rng(seed)
    kind, perturbation = KINDS[seed % 4], PERTURBATIONS[seed // 4 % 3]
    joint: tv.simulate.Joint = tv.simulate.ReflexJoint(tv.simulate.Constant(100.0), reflex_gain=8.0)
    if kind != "reflex":
        joint = tv.simulate.Joint(stiffness=tv.simulate.PROFILES[kind])
    duration, snr_db = PERIOD * round(random.uniform(30, 75)), random.uniform(5, 20)
    perturbed = tv.simulate.PERTURBATIONS[perturbation]
    return joint.simulate(duration, perturbation=perturbed, snr_db=snr_db, seed=seed).recording


def ensemble_of(recording: tv.Recording, period: float) -> tv.Ensemble:
    cut = tv.preprocess.segment(tv.preprocess.decimate(recording, RATE), period)
    return tv.preprocess.subtract_mean(cut, cut.channels)


def identified(recording: tv.Recording, period: float) -> Answer:
    """Return the answer by the default methods."""
    return tv.compare(ensemble_of(recording, period)).answer


def look(console: Console, fault: str, case: Case, speed: float) -> bool:
    """Print what is said of a case.

    Return whether its stiffness is right, or the first three lines say why not.
    """
    answer = identified(case.recording, case.period)
    model, lines = answer.model, answer.lines[:3]
    low, high = (limit(model.time * speed) for limit in case.limits)
    outside = np.maximum(0, np.maximum(low - model.stiffness, model.stiffness - high))
    error = float(np.sqrt(np.mean(outside**2) / np.mean(high**2)))
    said = not answer.is_stated or any(reason in lines for reason in answer.reasons)
    verdict = "right" if error < FIFTH else "WRONG" if not said else "wrong, and said"
    stated = f"{model.stiffness.min():.3g} to {model.stiffness.max():.3g} N·m/rad, "
    stated += {"none": "withdrawn", "doubtful": "doubtful", "good": "stated"}[answer.trust]
    console.print(f"{case.name}, {fault}: {stated}; error {100 * error:.0f} %: {verdict}")
    for line in lines:
        console.print(f"    {line}")
    return said or error < FIFTH


if __name__ == "__main__":
    main()
