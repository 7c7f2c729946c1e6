"""Test skirt and modal decomposition on the perturbations that they are made for.

Run ``python benchmarks/special.py`` from the repository root; some 20 s. Tables of
docs/special-perturbations.md.
"""

import math
import warnings
from time import process_time
from typing import Any

import attrs
import numpy as np
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.simulate import (
    CompliantActuator,
    Constant,
    FilteredNoise,
    Joint,
    Multisine,
    Pulses,
    SineWave,
    SquareWave,
)

SINE, SQUARE = SineWave(), SquareWave()
FIVE, FOUR = Multisine(), Multisine((1.2, 6.2, 11.2, 16.2))
SMOOTH = "kbr:length_periodic=1,gamma=(4.5,1e-4,1e-8)"
SKIRTS: tuple[tuple[str, Any, Any], ...] = (
    ("skirt", SINE, FIVE),
    ("skirt", SINE, FOUR),
    ("skirt", SQUARE, FIVE),
    ("skirt", SQUARE, FOUR),
    ("kbr", SINE, FIVE),
    (SMOOTH, SINE, FIVE),
    ("kbr", SQUARE, FIVE),
    ("kbr", SINE, FilteredNoise()),
    (SMOOTH, SINE, FilteredNoise()),
    ("kbr", SQUARE, FilteredNoise()),
)
IMPULSES = Pulses(duration=0.02, interval=1.0)
FREE: dict[str, Any] = {"disturbance": "torque", "actuator_stiffness": 0.0, "actuator_inertia": 0.0}
INERTIA = 0.1


def ensemble_of(
    joint: Joint, duration: float, perturbation: Any, snr_db: float, seed: int
) -> tv.Ensemble:
    """Realizations of 2 s at 100 Hz."""
    recording = joint.simulate(
        duration, perturbation=perturbation, snr_db=snr_db, seed=seed
    ).recording
    return tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)


def scored(models: list[tv.Model], truth: np.ndarray[Any, Any]) -> list[float]:
    """Return bias freed of the random error, random and total error in N·m/rad, coverage in %."""
    stiffness = np.stack([model.stiffness for model in models])
    bands = np.stack([model.estimates["stiffness"].band() for model in models])
    known = np.isfinite(bands[:, 0])
    covered = np.sum((bands[:, 0] <= truth) & (truth <= bands[:, 1])) / max(known.sum(), 1)
    random = math.sqrt(np.nanmean(np.nanvar(stiffness, axis=0, ddof=1)))
    bias = np.nanmean((np.nanmean(stiffness, axis=0) - truth) ** 2) - random**2 / len(models)
    total = math.sqrt(np.nanmean((stiffness - truth) ** 2))
    return [math.sqrt(max(bias, 0.0)), random, total, 100 * float(covered)]


def skirts(trials: int = 12) -> None:
    """40 s of the paper's joint at 10 dB."""
    print(
        "| method | stiffness | perturbation | bias | random | total | coverage (%) "
        "|\n|---|---|---|---|---|---|---|"
    )
    for text, profile, perturbation in SKIRTS:
        method = tv.methods.parse(text)
        every = [
            ensemble_of(Joint(profile), 40.0, perturbation, 10.0, 300 + trial)
            for trial in range(trials)
        ]
        models = [method.identify(ensemble) for ensemble in every]
        bias, random, total, covered = scored(models, profile(models[0].time))
        lines = len(getattr(perturbation, "frequencies", ()))
        what = f"{lines} lines" if lines else "noise"
        name = type(profile).__name__
        print(
            f"| `{text}` | {name} | {what} | {bias:.1f} | {random:.1f} | {total:.1f} | "
            f"{covered:.0f} |",
            flush=True,
        )


def joint_of(damping: float, stiffness: Any = None) -> CompliantActuator:
    """Free joint of 100 N·m/rad on average with this damping ratio there."""
    viscosity = 2 * damping * math.sqrt(100.0 * INERTIA)
    free = CompliantActuator(
        stiffness or Constant(100.0), viscosity, INERTIA, **FREE, actuator_viscosity=0.0
    )
    return attrs.evolve(free, noise_bandwidth=40.0)


def ringing(trials: int = 6) -> None:
    """Impulses every second for 80 s, by damping ratio, noise and window."""
    print(
        "\n| damping ratio | stiffness | SNR (dB) | window (s) | bias | random | total | coverage "
        "(%) |\n" + "|---" * 8 + "|"
    )
    cases = [(ratio, None, 30.0, 0.05) for ratio in (0.1, 0.2, 0.3, 0.5)]
    cases += [
        (0.2, None, snr, window)
        for snr, window in ((30.0, 0.08), (30.0, 0.12), (20.0, 0.05), (10.0, 0.05))
    ]
    cases += [(0.2, SINE, 30.0, 0.05), (0.2, SQUARE, 30.0, 0.05)]
    for damping, profile, snr, window in cases:
        joint, method = joint_of(damping, profile), tv.ModalDecomposition(window=window)
        every = [ensemble_of(joint, 80.0, IMPULSES, snr, 100 + trial) for trial in range(trials)]
        head = f"| {damping:g} | {type(joint.stiffness).__name__} | {snr:g} | {window:g} "
        if reason := method.skip(every[0]):
            print(f"{head}| {reason} | | | |")
            continue
        models = [method.identify(ensemble) for ensemble in every]
        numbers = scored(models, joint.stiffness(models[0].time))
        print(
            head + "".join(f"| {number:.1f} " for number in numbers[:3]) + f"| {numbers[3]:.0f} |",
            flush=True,
        )


def after_one_impulse(trials: int = 40) -> None:
    """Print the mean and the random error at times after a single impulse.

    White noise on the angle is at 30 dB (RMS over 1 s).
    """
    from tvsysid.methods.modal import track  # noqa: PLC0415  # beside what a user needs
    from tvsysid.simulate.motion import driven_motion  # noqa: PLC0415

    rate, samples = 100.0, 250
    force = np.zeros(10 * samples)
    force[500] = 10 * rate / INERTIA
    viscosity = 0.4 * math.sqrt(100.0 / INERTIA)
    full = np.ones(10 * samples)
    angle = driven_motion(100.0 / INERTIA * full, viscosity * full, force[None], 10 * rate)[
        0, 0, ::10
    ]
    size = 10 ** (-30 / 20) * math.sqrt(np.mean(angle[50:150] ** 2))
    print("\n| window (s) | 0.1-0.4 s | 0.4-0.7 s | 0.7-1.0 s |\n|---|---|---|---|")
    for window in (0.05, 0.08, 0.12):
        times = 50 + np.arange(10, 101)
        noisy = [
            angle + size * np.random.default_rng(seed).standard_normal(samples)
            for seed in range(trials)
        ]
        errors = np.stack(
            [
                track(each, times, window, rate, (100.0, viscosity * INERTIA, INERTIA))[:, 0]
                - 100.0
                for each in noisy
            ]
        )
        parts = [errors[:, first : first + 31] for first in (0, 30, 60)]
        cells = [
            f"{part.mean():.1f} / {math.sqrt(np.mean(part.std(axis=0) ** 2)):.1f}" for part in parts
        ]
        print(f"| {window:g} | {' | '.join(cells)} |")


def speed() -> None:
    """Processor time for 600 s."""
    made = (
        (tv.SkirtDecomposition(), Joint(SINE), FIVE),
        (tv.ModalDecomposition(), joint_of(0.2), IMPULSES),
    )
    for method, joint, perturbation in made:
        ensemble = ensemble_of(joint, 600.0, perturbation, 30.0, 1)
        started = process_time()
        method.identify(ensemble)
        print(f"\n{method.key}: {process_time() - started:.2f} s of processor time for 600 s")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    with threadpool_limits(1):
        skirts()
        ringing()
        after_one_impulse()
        speed()
