"""Measure how often the diagnosis reports a reflex, whether there is one or not.

Run ``python benchmarks/reflex_test.py`` from the repository root.

Draws simulated joints without a reflex (perturbed by noise, PRBS and pulses, under wide and slow
noise), joints whose late answer is linear, and joints with weak reflexes, and prints how many
show one. Where there is none, none may be shown; from a gain of 1 N·m·s/rad in 150 s and of 2 in
40 s it must be, perturbed by noise or a PRBS (the weak ones that pulses leave are printed
alone). Ends with 1 if not. With ``--data FOLDER``, prints what the real ankles of
``tonic_ankle.mat`` show.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import attrs
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.signal import butter, lfilter

import tvsysid as tv
from tvsysid.methods.cascade.reflex_test import HARMONICS, reflex_test_of
from tvsysid.methods.cascade.search import one_path_stiffness
from tvsysid.quality.fit import at_diagnosis_rate

RELEASE = tv.simulate.StretchReflex(direction=-1)


class Case(NamedTuple):
    """What is drawn, and in how many of the draws a reflex is expected to be shown."""

    what: str
    perturbation: str
    duration: float = 150.0
    gain: float = 0.0
    profile: str = "sine"
    direction: int = 1
    expected: str = "none"

    @property
    def title(self) -> str:
        """In words."""
        return f"{self.what}: {self.perturbation}, {self.duration:g} s, {self.profile}"


CASES = (
    Case("no reflex", "noise"),
    Case("no reflex", "noise", 40.0),
    Case("no reflex", "prbs"),
    Case("no reflex", "prbs", profile="square"),
    Case("no reflex", "pulses"),
    Case("no reflex", "pulses", 40.0, profile="square"),
    Case("slow noise", "noise"),
    Case("slow noise", "pulses", 60.0, profile="constant"),
    Case("linear late answer", "noise", gain=8.0),
    Case("linear late answer", "prbs", gain=8.0, profile="square"),
    Case("linear late answer", "pulses", gain=8.0),
    Case("gain 1", "noise", gain=1.0, expected="all"),
    Case("gain 1", "prbs", gain=1.0, expected="all"),
    Case("gain 1", "pulses", gain=1.0, expected="some"),
    Case("gain 2", "noise", 40.0, gain=2.0, expected="all"),
    Case("gain 2, to negative velocity", "noise", 40.0, gain=2.0, direction=-1, expected="all"),
    Case("gain 2", "prbs", 40.0, gain=2.0, expected="some"),
    Case("gain 2", "pulses", 40.0, gain=2.0, expected="some"),
    Case("gain 4", "prbs", 40.0, gain=4.0, expected="all"),
    Case("gain 4", "pulses", 40.0, gain=4.0, expected="all"),
)
ENOUGH = 0.95  # share of the draws in which a reflex that must be shown is


def main() -> None:
    parser = argparse.ArgumentParser(description="How often a reflex is detected.")
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--first", type=int, default=5000, help="seed of the first draw")
    parser.add_argument("--data", type=Path, help="folder of tonic_ankle.mat")
    chosen = parser.parse_args()
    console = Console(width=140)
    table = Table(title=f"{chosen.draws} draws each", title_justify="left")
    for heading in (
        "case",
        "shown",
        "p over none\n< 0.0001",
        "p over linear\n< 0.0001",
        "smallest of\nthe larger p",
    ):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    table.add_column("largest of\nthe larger p", justify="right")
    table.add_column("stiffness in %\nwith its torque", justify="right")
    wrong, started = 0, time.process_time()
    for case in CASES:
        draws = range(chosen.first, chosen.first + chosen.draws)
        ensembles = [at_diagnosis_rate(drawn(case, seed)) for seed in draws]
        tests = [reflex_test_of(each) for each in ensembles]
        shown = sum(test.shown and test.direction == case.direction for test in tests)
        chances = np.array([[test.over_none, test.over_linear] for test in tests])
        larger = chances.max(axis=1)
        ratios = [np.divide(*stiffness_of(each)) for each in ensembles]
        table.add_row(
            case.title,
            str(shown),
            *(str(count) for count in (chances < 1e-4).sum(axis=0)),
            *(f"{value:.1e}" for value in (larger.min(), larger.max())),
            f"{100 * np.mean(ratios):.1f}",
        )
        some = any(test.shown for test in tests)
        wrong += {"none": some, "some": False, "all": shown < ENOUGH * chosen.draws}[case.expected]
    console.print(table)
    each = (time.process_time() - started) / chosen.draws / len(CASES)
    console.print(f"{each:.2f} s of the processor a draw, simulation included", highlight=False)
    if chosen.data:
        print_real(console, chosen.data)
    sys.exit(int(wrong > 0))


def drawn(case: Case, seed: int) -> tv.Ensemble:
    """Ensemble of a case, at 10 dB."""
    profile = tv.simulate.PROFILES[case.profile]
    reflex = tv.simulate.StretchReflex(direction=case.direction)
    joint = tv.simulate.ReflexJoint(stiffness=profile, reflex_gain=case.gain, reflex=reflex)
    kind = tv.simulate.PERTURBATIONS[case.perturbation]
    recording = joint.simulate(case.duration, perturbation=kind, snr_db=10, seed=seed).recording
    if case.what == "linear late answer":
        # Reflexes to either direction make a linear answer together.
        velocity = np.gradient(recording.angle, 1 / recording.sampling_rate)
        answer = RELEASE.torque(velocity, case.gain, recording.sampling_rate)
        recording = attrs.evolve(recording, torque=recording.torque + answer)
    if case.what == "slow noise":
        wide = np.random.default_rng([seed, 7]).standard_normal(len(recording) + 10_000)
        noise = lfilter(*butter(1, 1.0, fs=recording.sampling_rate), wide)[10_000:]
        recording = attrs.evolve(
            recording, torque=recording.torque + 0.6 * recording.torque.std() / noise.std() * noise
        )
    return prepared(recording)


def prepared(recording: tv.Recording) -> tv.Ensemble:
    return tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    )


def stiffness_of(ensemble: tv.Ensemble) -> tuple[float, float]:
    """Mean stiffness with the reflex's torque in it, and without."""
    two_paths = np.nanmean(tv.JointCascade(HARMONICS).fit(ensemble).stiffness)
    return one_path_stiffness(ensemble), float(two_paths)


def print_real(console: Console, folder: Path) -> None:
    for muscle in ("plantarflexor", "dorsiflexor", "dorsiflexor_2"):
        names = {"angle": f"{muscle}_angle", "torque": f"{muscle}_torque"}
        recording = tv.read_recording(
            folder / "tonic_ankle.mat", **names, sampling_rate=1000, torque_sign=-1
        )
        ensemble = at_diagnosis_rate(prepared(recording))
        test = reflex_test_of(ensemble)
        console.print(
            f"{muscle}: {test}, stiffness {stiffness_of(ensemble)}",
            highlight=False,
        )


if __name__ == "__main__":
    main()
