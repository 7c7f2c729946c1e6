"""How often a diagnosis raises a false alarm: run ``python benchmarks/diagnosis.py`` from the repository root.

Diagnoses clean simulated joints and prepared virtual participants, and prints every finding (each of which is false),
how near to its limit each check came, and how long a diagnosis took. Clean is meant widely: constant, sinusoidal
and square-wave stiffness; filtered noise and PRBS; periods of 1 to 3 s; 40 to 300 s; 5 to 30 dB; delays of less than
3 ms, as filters that do not match leave them; noise in the torque that is wide, slow, varies over the cycle, or is
louder in some realizations; 100 Hz, and 1 kHz with periods that divide by nothing. Ends with 1 if more than 5 % of the
clean joints have a finding.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.signal import butter, lfilter

import tvsysid as tv

Array = NDArray[np.float64]

PROFILES = (tv.simulate.SquareWave(), tv.simulate.SineWave(), tv.simulate.Constant(100.0))
PERTURBATIONS = (tv.simulate.FilteredNoise(), tv.simulate.PRBS())
PERIODS = (1.0, 1.5, 2.0, 2.5, 3.0)
UNDIVIDED = (1.111, 1.487, 2.003)
ALLOWED = 0.05
TWO_SIDED = ("delay", "drift")


def main() -> None:
    parser = argparse.ArgumentParser(description="False alarms of a diagnosis.")
    parser.add_argument("--joints", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first joint")
    parser.add_argument("--participants", type=int, default=6)
    chosen = parser.parse_args()
    console = Console()
    seeds = range(chosen.first, chosen.first + chosen.joints)
    false = survey(console, "clean joints", ((f"joint {seed}", clean_joint(seed)) for seed in seeds))
    people = ((n, kind) for n in range(1, chosen.participants + 1) for kind in ("noise", "prbs"))
    survey(console, "virtual participants", ((f"participant {n}, {kind}", participant(n, kind)) for n, kind in people))
    sys.exit(int(false > ALLOWED * chosen.joints))


def clean_joint(seed: int) -> tv.Ensemble:
    """Joint with nothing wrong; every twentieth is left at 1 kHz and cut with a period that divides by nothing."""
    random = np.random.default_rng(seed)
    undivided = seed % 20 == 19
    period = float(random.choice(UNDIVIDED if undivided else PERIODS))
    duration = period * round(random.uniform(max(40, 20 * period), 65 if undivided else 300) / period)
    profile = PROFILES[seed % 3]
    stiffness = profile if isinstance(profile, tv.simulate.Constant) else replace(profile, period=period)
    joint = tv.simulate.Joint(stiffness=stiffness)
    recording = joint.simulate(
        duration, perturbation=PERTURBATIONS[seed // 3 % 2], snr_db=random.uniform(5, 30), seed=seed
    ).recording
    late = int(random.integers(-2, 3))
    torque = np.roll(recording.torque, late) + NOISES[seed // 6 % len(NOISES)](recording, period, random)
    recording = replace(recording, torque=torque)
    if not undivided:
        recording = tv.preprocess.decimate(recording, 100)
    return tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period))


def no_more(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """The simulation's own noise, of 40 Hz."""
    return np.zeros(len(recording))


def slow(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Voluntary torque that wanders: first order at 0.5 Hz, 60 % of the torque's RMS."""
    return 0.6 * recording.torque.std() * coloured(recording, butter(1, 0.5, fs=recording.sampling_rate), random)


def cyclic(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Noise of 0.3 to 10 Hz at 10 to 20 dB that is up to five times louder once a cycle."""
    band = butter(2, [0.3, 10], "bandpass", fs=recording.sampling_rate)
    phase = recording.time / period - random.uniform()
    apart = (phase - np.round(phase)) * period
    louder = 1 + (random.uniform(2, 5) - 1) * np.exp(-0.5 * (apart / 0.2) ** 2)
    noise = louder * coloured(recording, band, random)
    return recording.torque.std() * 10 ** (-random.uniform(10, 20) / 20) * noise / noise.std()


def uneven(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Noise below 10 Hz, of 30 % of the torque's RMS in the middle, whose level is another in each realization."""
    noise = coloured(recording, butter(2, 10, fs=recording.sampling_rate), random)
    number = np.floor(recording.time / period).astype(int)
    levels = np.exp(0.3 * random.standard_normal(np.ptp(number) + 1))
    return 0.3 * recording.torque.std() * levels[number - number.min()] * noise


def coloured(recording: tv.Recording, taps: tuple[Array, Array], random: np.random.Generator) -> Array:
    """Filtered noise with an RMS of one."""
    noise = lfilter(*taps, random.standard_normal(len(recording) + 10_000))[10_000:]
    return np.asarray(noise / noise.std())


NOISES = (no_more, slow, cyclic, uneven)


def participant(number: int, perturbation: str) -> tv.Ensemble:
    simulation = tv.simulate.Participant(number).simulate(perturbation=tv.simulate.PERTURBATIONS[perturbation])
    return tv.preprocess.prepare(simulation.recording).ensemble


def survey(console: Console, title: str, ensembles) -> int:  # type: ignore[no-untyped-def]
    """Number of ensembles with a finding."""
    false, seconds, values = 0, [], {name: [] for name in tv.quality.FAULTS}
    alarms = dict.fromkeys(tv.quality.FAULTS, 0)
    for name, ensemble in ensembles:
        started = time.perf_counter()
        diagnosis = tv.diagnose(ensemble)
        seconds.append(time.perf_counter() - started)
        false += not diagnosis.clean
        for check in diagnosis.findings:
            alarms[check.name] += 1
            console.print(f"{name}: {check.name}: {check.what}", highlight=False)
        for check in diagnosis.checks:
            if check.judged:
                values[check.name].append(abs(check.value) if check.name in TWO_SIDED else check.value)
    if not seconds:
        return 0
    table = Table(title=f"{title}: {false} of {len(seconds)} with a finding", title_justify="left")
    for heading in ("check", "judged", "found", "nearest", "limit", "unit"):
        table.add_column(heading, justify="left" if heading in ("check", "unit") else "right")
    for name, fault in tv.quality.FAULTS.items():
        seen = values[name]
        nearest = f"{(max if fault.wrong == 'above' else min)(seen):.3g}" if seen else "-"
        table.add_row(name, str(len(seen)), str(alarms[name]), nearest, f"{fault.limit:g}", fault.unit)
    console.print(table)
    console.print(
        f"a diagnosis took {np.mean(seconds):.2f} s on average, {max(seconds):.2f} s at most\n", highlight=False
    )
    return false


if __name__ == "__main__":
    main()
