"""Measure how often a diagnosis raises a false alarm.

Run ``python benchmarks/diagnosis.py`` from the repository root.

Diagnoses clean simulated joints and prepared virtual participants, and prints every finding
(each of which is false), how near to its limit each check came, and how long a diagnosis took.
Clean is meant widely: constant, sinusoidal and square-wave stiffness; filtered noise and PRBS;
periods of 1 to 3 s; 40 to 300 s; 5 to 30 dB; noise in the torque that is wide, pink, slow, varies
over the cycle, or is louder in some realizations; both channels through the same low-pass; an angle
in steps of up to 8 % of its SD; recorded at 500 to 2000 Hz; diagnosed at 100 to 500 Hz, and at 1
kHz with periods that divide by nothing. The torque is 2 ms early to 2 ms late, as filters that
do not match leave it: if that is found, to a millisecond, it is no false alarm. Ends with 1 if
more than 5 % of the joints have a false finding.
"""

from __future__ import annotations

import argparse
import sys
import time

import attrs
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.signal import butter, filtfilt, lfilter

import tvsysid as tv

Array = NDArray[np.float64]

PROFILES = (tv.simulate.SquareWave(), tv.simulate.SineWave(), tv.simulate.Constant(100.0))
PERTURBATIONS = (tv.simulate.FilteredNoise(), tv.simulate.PRBS())
PERIODS = (1.0, 1.5, 2.0, 2.5, 3.0)
UNDIVIDED = (1.111, 1.487, 2.003)
AS_NEAR = 1.0  # ms by which a delay that is there and found may be off
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
    false = survey(
        console, "clean joints", ((f"joint {seed}", *clean_joint(seed)) for seed in seeds)
    )
    people = ((n, kind) for n in range(1, chosen.participants + 1) for kind in ("noise", "prbs"))
    survey(
        console,
        "virtual participants",
        ((f"participant {n}, {kind}", participant(n, kind), 0.0) for n, kind in people),
    )
    sys.exit(int(false > ALLOWED * chosen.joints))


def clean_joint(seed: int) -> tuple[tv.Ensemble, float]:
    """Joint with nothing wrong but a delay, and that in ms.

    A twentieth at 1 kHz with odd periods.
    """
    random = np.random.default_rng(seed)
    undivided = seed % 20 == 19
    period = float(random.choice(UNDIVIDED if undivided else PERIODS))
    duration = period * round(
        random.uniform(max(40, 20 * period), 65 if undivided else 300) / period
    )
    profile = PROFILES[seed % 3]
    stiffness = (
        profile
        if isinstance(profile, tv.simulate.Constant)
        else attrs.evolve(profile, period=period)
    )
    joint = tv.simulate.Joint(stiffness=stiffness)
    own = np.random.default_rng([seed, 1])
    kind = KINDS[seed // 24 % len(KINDS)]
    rate, lower = (
        (1000.0, 100.0) if undivided or kind != "rates" else RATES[own.integers(len(RATES))]
    )
    recording = joint.simulate(
        duration,
        perturbation=PERTURBATIONS[seed // 3 % 2],
        snr_db=random.uniform(5, 30),
        seed=seed,
        rate=rate,
    ).recording
    late = int(random.integers(-2, 3))
    torque = np.roll(recording.torque, round(late * rate / 1000))
    recording = attrs.evolve(
        recording, torque=torque + NOISES[seed // 6 % len(NOISES)](recording, period, random)
    )
    if kind == "filtered":
        recording = filtered(recording, own)
    if kind == "coarse":
        step = own.uniform(0.02, 0.08) * recording.angle.std()
        recording = attrs.evolve(recording, angle=np.round(recording.angle / step) * step)
    if not undivided:
        recording = tv.preprocess.decimate(recording, lower)
    return tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period)), late


KINDS = ("plain", "filtered", "coarse", "rates")
RATES = ((500.0, 100.0), (2000.0, 100.0), (1000.0, 200.0), (1000.0, 250.0), (500.0, 500.0))


def filtered(recording: tv.Recording, random: np.random.Generator) -> tv.Recording:
    """Both channels through one low-pass, causal or both ways in time."""
    taps = butter(int(random.integers(2, 5)), random.uniform(15, 45), fs=recording.sampling_rate)
    through = filtfilt if random.random() < 0.5 else lfilter
    return attrs.evolve(
        recording, angle=through(*taps, recording.angle), torque=through(*taps, recording.torque)
    )


def no_more(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """The simulation's own noise, of 40 Hz."""
    return np.zeros(len(recording))


def slow(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Voluntary torque that wanders: first order at 0.5 Hz, 60 % of the torque's RMS."""
    return (
        0.6
        * recording.torque.std()
        * coloured(recording, butter(1, 0.5, fs=recording.sampling_rate), random)
    )


def pink(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Return noise of one over the frequency up to 200 Hz, 40 % of the torque's RMS."""
    spectrum = np.fft.rfft(random.standard_normal(len(recording)))
    frequency = np.fft.rfftfreq(len(recording), 1 / recording.sampling_rate)
    spectrum[0], spectrum[frequency > 200] = 0, 0
    spectrum[1:] /= np.sqrt(np.maximum(frequency[1:], 0.1))
    noise = np.fft.irfft(spectrum, len(recording))
    return np.asarray(0.4 * recording.torque.std() * noise / noise.std())


def cyclic(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Noise of 0.3 to 10 Hz at 10 to 20 dB that is up to five times louder once a cycle."""
    band = butter(2, [0.3, 10], "bandpass", fs=recording.sampling_rate)
    phase = recording.time / period - random.uniform()
    apart = (phase - np.round(phase)) * period
    louder = 1 + (random.uniform(2, 5) - 1) * np.exp(-0.5 * (apart / 0.2) ** 2)
    noise = louder * coloured(recording, band, random)
    return recording.torque.std() * 10 ** (-random.uniform(10, 20) / 20) * noise / noise.std()


def uneven(recording: tv.Recording, period: float, random: np.random.Generator) -> Array:
    """Return noise below 10 Hz whose level differs between realizations.

    Its median level is 30 % of the torque's RMS.
    """
    noise = coloured(recording, butter(2, 10, fs=recording.sampling_rate), random)
    number = np.floor(recording.time / period).astype(int)
    levels = np.exp(0.3 * random.standard_normal(np.ptp(number) + 1))
    return 0.3 * recording.torque.std() * levels[number - number.min()] * noise


def coloured(
    recording: tv.Recording, taps: tuple[Array, Array], random: np.random.Generator
) -> Array:
    """Filtered noise with an RMS of one."""
    noise = lfilter(*taps, random.standard_normal(len(recording) + 10_000))[10_000:]
    return np.asarray(noise / noise.std())


NOISES = (no_more, slow, cyclic, uneven, pink)


def participant(number: int, perturbation: str) -> tv.Ensemble:
    simulation = tv.simulate.Participant(number).simulate(
        perturbation=tv.simulate.PERTURBATIONS[perturbation]
    )
    return tv.preprocess.prepare_experiment(simulation.recording).ensemble


def survey(console: Console, title: str, ensembles) -> int:  # type: ignore[no-untyped-def]
    """Number of ensembles with a finding that is false."""
    false, true, unsure, seconds, values = 0, 0, 0, [], {name: [] for name in tv.quality.FAULTS}
    alarms, uncertain = dict.fromkeys(tv.quality.FAULTS, 0), dict.fromkeys(tv.quality.FAULTS, 0)
    for name, ensemble, late in ensembles:
        started = time.perf_counter()
        diagnosis = tv.diagnose(ensemble)
        seconds.append(time.perf_counter() - started)
        wrong = [
            each
            for each in diagnosis.findings
            if each.name != "delay" or not late or abs(each.value - late) > AS_NEAR
        ]
        false, true = false + bool(wrong), true + (len(wrong) < len(diagnosis.findings))
        for check in wrong:
            alarms[check.name] += 1
            console.print(f"{name}: {check.name}: {check.what}", highlight=False)
        unsure += any(check.state == "uncertain" for check in diagnosis.checks)
        for check in diagnosis.checks:
            if check.state == "uncertain":
                uncertain[check.name] += 1
            if check.state != "not judged":
                values[check.name].append(
                    abs(check.value) if check.name in TWO_SIDED else check.value
                )
    if not seconds:
        return 0
    told = (
        f"{false} of {len(seconds)} with a false finding, {true} with a true delay, {unsure} "
        "uncertain"
    )
    table = Table(title=f"{title}: {told}", title_justify="left")
    for heading in ("check", "judged", "false", "uncertain", "nearest", "limit", "unit"):
        table.add_column(heading, justify="left" if heading in ("check", "unit") else "right")
    for name, fault in tv.quality.FAULTS.items():
        seen = values[name]
        nearest = f"{(max if fault.wrong == 'above' else min)(seen):.3g}" if seen else "-"
        table.add_row(
            name,
            str(len(seen)),
            str(alarms[name]),
            str(uncertain[name]),
            nearest,
            f"{fault.limit:g}",
            fault.unit,
        )
    console.print(table)
    console.print(
        f"a diagnosis took {np.mean(seconds):.2f} s on average, {max(seconds):.2f} s at most\n",
        highlight=False,
    )
    return false


if __name__ == "__main__":
    main()
