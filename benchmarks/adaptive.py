"""Compare the adaptive method with the paper's five and tuned ones.

Run ``python benchmarks/adaptive.py`` from the repository root.

Simulated joints, their mean over realizations subtracted. Parts (``--part``): the paper's
``square`` and ``sine``, 40 to 600 s; ``waves``, twelve that no method was made for, 150 s;
``fresh``, three more; ``coverage``, with more and less noise, at 200 Hz, with slow noise, and with
noise that is louder at some times; ``speed``.

For each scenario, in N·m/rad: total error of the best of the five, of kbr and birf with settings
chosen anew in each trial, and bias, random and total error of ``--method``, the last also relative
to theirs; its random error without the samples beside a switch, and that relative to least squares
that knows the waveform (the oracle), and how the same of an estimate that knows all but two levels
and when they switch (the finder) compares; coverage of its 95 % bands in per cent at all times,
within 0.05 s of a switch, and 0.3 s and more away from one; seconds an identification.

``--store FOLDER`` keeps all results for later runs, those of ``--method`` too, unless
``--anew``. Tuned methods take 3 s a trial, 7 s with 600 s of data: ``--beside five`` leaves them
out, ``--beside`` by itself the five too.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.methods.adaptive.prior import Axis
from tvsysid.study.scores import AT_SWITCH, AWAY

Array = NDArray[np.float64]
Profile = Callable[[Array], Array]

GROUPS = {"five": list(tv.methods.PAPER_METHODS), "tuned": ["kbr:tuned=true", "birf:tuned=true"]}
SEED = 14
SWITCH = 7.0  # N·m/rad from one sample to the next
# Centre (s) and duration (s) of the louder noise in a realization, and its factor
LOUD = (1.3, 0.3, 5.0)


@dataclass(frozen=True)
class Wave:
    """A stiffness in N·m/rad over the time in a period."""

    name: str
    shape: Profile
    period: float | None = 2.0

    def __call__(self, time: Array) -> Array:
        """Value at each time."""
        # Rounding keeps a sample that lies on a switch on the switch's far side.
        return np.asarray(
            self.shape(np.round(np.asarray(time), 6) % (self.period or np.inf)), dtype=np.float64
        )

    def __repr__(self) -> str:
        return self.name


def levels(times: list[float], values: list[float]) -> Profile:
    """Steps at times to values; before the first, the last value."""
    return lambda time: np.array([values[-1], *values])[np.searchsorted(times, time, side="right")]


def bump(time: Array, middle: float, width: float) -> Array:
    """Gaussian of height 1, repeated every 2 s."""
    return np.exp(-0.5 * ((time - middle + 1) % 2 - 1) ** 2 / width**2)


def _jittered(time: Array) -> Array:
    """Return a square wave whose switches are 30 ms early or late (standard deviation).

    They differ in each realization.
    """
    with np.errstate(invalid="ignore"):  # a study also asks for the value at no time at all
        cycle, phase = np.floor(time / 2).astype(int), time % 2
    late = 0.03 * np.random.default_rng(0).standard_normal((1000, 2))[cycle % 1000]
    return np.where((phase >= 0.504 + late[:, 0]) & (phase < 1.337 + late[:, 1]), 150.0, 50.0)


OFF_GRID = Wave("off-grid", levels([0.374, 1.237], [150, 50]))
SMOOTH = Wave(
    "smooth+switch", lambda t: 80 + 25 * np.sin(np.pi * t + 0.7) + 50 * ((t >= 0.613) & (t < 1.488))
)
WAVES = [
    OFF_GRID,
    Wave("three levels", levels([0.253, 0.871, 1.554], [120, 60, 160])),
    Wave("bursts", levels([0.407, 0.468, 1.313, 1.374], [140, 60, 140, 60])),
    Wave("sawtooth", lambda t: 50 + 50 * ((t - 0.633) % 2)),
    Wave("triangle", lambda t: 50 + 100 * np.abs((t - 0.317) % 2 - 1)),
    Wave("ramps", partial(np.interp, xp=[0.2, 0.5, 1.1, 1.4], fp=[60, 140, 140, 60])),
    SMOOTH,
    Wave("constant", lambda t: np.full(np.shape(t), 100.0)),
    Wave("small switch", levels([0.547, 1.321], [104, 96])),
    Wave("bumps", lambda t: 60 + 80 * bump(t, 0.45, 0.08) + 50 * bump(t, 1.4, 0.15)),
    Wave("square, 1 s", levels([0.287, 0.704], [140, 60]), 1.0),
    Wave("square, 4 s", levels([0.893, 2.762], [140, 60]), 4.0),
]
FRESH = [
    Wave("relaxing", lambda t: 60 + 90 * np.exp(-((t - 0.428) % 2) / 0.25)),
    Wave(
        "rise and fall",
        lambda t: np.where(t < 1.106, 50 + 80 * np.sin(np.pi * t / 2.212) ** 2, 70.0),
    ),
    Wave("two tones", lambda t: 100 + 30 * np.sin(np.pi * t + 1) + 18 * np.sin(5 * np.pi * t)),
]


@dataclass(frozen=True)
class UnevenJoint(tv.simulate.Joint):
    """A joint whose noise is louder at one time of the movement."""

    def simulate(self, duration: float, **settings: Any) -> tv.simulate.Simulation:
        """As a joint, but for the noise."""
        made = super().simulate(duration, **settings)
        middle, width, times = LOUD
        louder = 1 + (times - 1) * bump(made.recording.time % 2, middle, width / 2)
        noise = made.recording.torque - made.noiseless.torque
        torque = made.noiseless.torque + louder * noise * np.sqrt(
            np.mean(noise**2) / np.mean((louder * noise) ** 2)
        )
        return attrs.evolve(made, recording=attrs.evolve(made.recording, torque=torque))

    def __repr__(self) -> str:
        return "uneven noise"


@dataclass(frozen=True)
class SlowJoint(tv.simulate.ReflexJoint):
    """A joint without a reflex, whose noise is below 3 Hz."""

    reflex_gain: float = 0.0
    noise_bandwidth: float = 3.0

    def __repr__(self) -> str:
        return "slow noise"


PAPER = (40.0, 80.0, 150.0, 300.0, 600.0)
HARD = ["square", "sine", OFF_GRID, SMOOTH]
JITTERED = Wave("jittered", _jittered, None)
PARTS: dict[str, list[dict[str, Any]]] = {
    "square": [{"stiffness": "square", "duration_s": PAPER}],
    "sine": [{"stiffness": "sine", "duration_s": PAPER}],
    "waves": [
        {"stiffness": WAVES[:10]},
        {"stiffness": WAVES[10], "period": 1.0},
        {"stiffness": WAVES[11], "period": 4.0, "duration_s": 152.0},
    ],
    "fresh": [{"stiffness": FRESH}],
    "coverage": [
        {
            "stiffness": HARD,
            "snr_db": (0.0, 10.0, 20.0),
            "also": [{"stiffness": [JITTERED], "snr_db": [10.0]}],
        },
        {"stiffness": HARD, "rate": 200.0},
        {"stiffness": HARD, "system": [SlowJoint(), UnevenJoint()]},
    ],
}


def main() -> None:
    parser = argparse.ArgumentParser(description="How well the adaptive method does.")
    parser.add_argument("--part", choices=[*PARTS, "speed"], default="square")
    parser.add_argument("--method", default="adaptive", help="key of the method in question")
    parser.add_argument(
        "--beside", nargs="*", choices=GROUPS, default=list(GROUPS), help="others to compare with"
    )
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--store", type=Path, help="folder that keeps the results")
    parser.add_argument("--anew", action="store_true", help="discard what the method gave before")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    console = Console(width=None if sys.stdout.isatty() else 190)
    if chosen.part == "speed":
        console.print(speed(chosen.method))
        return
    groups = {chosen.method: [chosen.method]} | {name: GROUPS[name] for name in chosen.beside}
    shown = table(f"{chosen.part}: {chosen.method}, {chosen.trials} trials")
    for number, settings in enumerate(PARTS[chosen.part]):
        found = {}
        for name, methods in groups.items():
            store = (
                chosen.store / f"{chosen.part}-{number}-{name}-{chosen.trials}"
                if chosen.store
                else None
            )
            if store is not None and name == chosen.method and chosen.anew:
                shutil.rmtree(store, ignore_errors=True)
            study = study_of(settings, methods, chosen.trials)
            found[name] = tv.study.run(study, folder=store, workers=1)
        add_rows(
            shown,
            study_of(settings, [chosen.method], chosen.trials),
            found,
            chosen.part in ("square", "sine"),
        )
    console.print(shown)


def study_of(settings: dict[str, Any], methods: list[str], trials: int) -> tv.study.Study:
    """Study whose data do not depend on the methods."""
    return tv.study.Study(**settings, methods=methods, trials=trials, seed=SEED, subtract_mean=True)


def table(title: str) -> Table:
    shown = Table(title=title, title_justify="left")
    shown.add_column("scenario", no_wrap=True)
    columns = (
        "best of five",
        "tuned kbr",
        "tuned birf",
        "bias",
        "random",
        "total",
        "/ five",
        "/ tuned",
    )
    for column in (
        *columns,
        "without",
        "/ oracle",
        "finder",
        "covered",
        "near",
        "away",
        "seconds",
        "failed",
    ):
        shown.add_column(column, justify="right")
    return shown


def add_rows(
    shown: Table, study: tv.study.Study, found: dict[str, xr.Dataset], beside_oracle: bool
) -> None:
    """Add a row for each scenario."""
    totals = {
        name: tv.study.score(each).value.sel(metric="total_error") for name, each in found.items()
    }
    for place, scenario in enumerate(study.scenarios):
        five, tuned = (
            totals[name].isel(scenario=place).to_series() if name in totals else None
            for name in ("five", "tuned")
        )
        here = found[str(study.methods[0])].isel(scenario=place, method_key=0)
        numbers = errors(here, *(oracles(study, scenario) if beside_oracle else (None, None)))
        cells = [f"{five.idxmin()} {five.min():.2f}" if five is not None else ""]
        cells += [f"{value:.2f}" for value in tuned] if tuned is not None else ["", ""]
        cells += [f"{numbers[name]:.2f}" for name in ("bias", "random", "total")]
        cells += [
            f"{numbers['total'] / each.min():.2f}" if each is not None else ""
            for each in (five, tuned)
        ]
        cells += [f"{numbers[name]:.2f}" for name in ("without", "oracle", "finder")]
        cells += [f"{numbers[name]:.1f}" for name in ("covered", "near", "away")]
        cells += [f"{float(here.seconds.mean()):.2f}", str(int((here.failure != "").sum()))]
        shown.add_row(label(scenario, study.rate), *(cell.replace("nan", "") for cell in cells))


def label(scenario: Any, rate: float) -> str:
    words = [scenario.stiffness, scenario.perturbation, f"{scenario.duration_s:g} s"]
    words += [f"{scenario.snr_db:g} dB"] if scenario.snr_db != 10 else []
    words += [f"{rate:g} Hz"] if rate != 100 else []
    return ", ".join(words + ([scenario.system] if scenario.system != "joint" else []))


def errors(here: xr.Dataset, known: Array | None, found: Array | None) -> dict[str, float]:
    """Errors of stiffness in N·m/rad, and how often its bands hold it.

    One method in one scenario.
    """
    of = here.sel(quantity="stiffness")
    truth, estimates, inside = of.truth.values, of.estimate.values, of.covered.values
    if "trial_truth" in of:
        estimates = estimates - (of.trial_truth.values - truth)
    fine = np.isfinite(estimates).all(axis=1)
    distance = from_switch(truth, float(here.time[1] - here.time[0]))
    beside = distance < 0.5 * float(here.time[1] - here.time[0])
    without = tv.metrics.random_error(estimates[fine][:, ~beside])
    return {
        "bias": tv.metrics.debiased_bias_error(estimates[fine], truth),
        "random": tv.metrics.random_error(estimates[fine]),
        "total": tv.metrics.total_error(estimates[fine], truth),
        "without": without,
        "oracle": np.nan if known is None else without / tv.metrics.random_error(known[:, ~beside]),
        "finder": np.nan
        if known is None or found is None or not beside.any()
        else tv.metrics.random_error(found[:, ~beside])
        / tv.metrics.random_error(known[:, ~beside]),
        "covered": share(inside[fine]),
        "near": share(inside[fine][:, distance <= AT_SWITCH + 1e-9]),
        "away": share(inside[fine][:, (distance >= AWAY) & np.isfinite(distance)]),
    }


def share(inside: Array) -> float:
    """Per cent of the times and trials with a band."""
    return float(100 * np.nanmean(inside)) if np.isfinite(inside).any() else np.nan


def from_switch(truth: Array, step: float) -> Array:
    """Seconds from each sample to the nearest one on or after a switch, around the period.

    Inf without one.
    """
    switches = np.flatnonzero(np.abs(truth - np.roll(truth, 1)) > SWITCH)
    if not len(switches):
        return np.full(len(truth), np.inf)
    apart = np.abs(np.arange(len(truth))[:, None] - switches)
    return np.asarray(step * np.minimum(apart, len(truth) - apart).min(axis=1))


def oracles(study: tv.study.Study, scenario: Any) -> tuple[Array, Array]:
    """Estimate stiffness by least squares with a known waveform, and by :func:`finder`.

    Least squares knows the waveform but for its mean and size.
    """
    rows, found = [], []
    for number in range(study.trials):
        made = tv.study.trials.simulate(study, scenario, number)
        ensemble, _ = tv.study.trials.draw(study, scenario, number)
        wave = made.truth_of(ensemble)["stiffness"][0]
        angle, velocity, acceleration = ensemble.derivatives()
        columns = np.stack([angle, angle * wave, velocity, acceleration]).reshape(4, -1).T
        torque = ensemble.torque[:, ensemble.core]
        mean, size, viscosity, inertia = np.linalg.lstsq(columns, torque.ravel())[0]
        rows.append(mean + size * wave)
        found.append(finder(angle, torque - viscosity * velocity - inertia * acceleration, wave))
    return np.array(rows), np.array(found)


def finder(angle: Array, torque: Array, wave: Array) -> Array:
    """Posterior mean of a periodic stiffness of two levels that switches twice.

    The noise's variance is known.

    Each switch is within 8 samples of that of the true wave, at sixteenths, and seen as a
    decimation smears it.
    """
    times, power = len(wave), (angle**2).sum(axis=0)
    seen = (angle * torque).sum(axis=0) / power
    weight = power / np.mean((torque - wave * angle) ** 2)
    axis = Axis(times, periodic=True)
    positions = [
        np.mod(k + np.arange(-8, 8, 1 / 16), times)
        for k in np.flatnonzero(np.abs(np.diff(wave, prepend=wave[-1])) > SWITCH)
    ]
    if len(positions) != 2:
        return np.full(times, np.nan)
    early, late = (axis.steps(each, recorded=True) for each in positions)
    mixed = (weight @ early)[:, None] - weight @ late
    cross = (weight * seen @ early)[:, None] - weight * seen @ late
    square = (weight @ early**2)[:, None] + weight @ late**2 - 2 * (early.T * weight) @ late
    total, sums = weight.sum(), weight @ seen
    determinant = np.maximum(total * square - mixed**2, 1e-9)
    level, jump = (
        (square * sums - mixed * cross) / determinant,
        (total * cross - mixed * sums) / determinant,
    )
    evidence = 0.5 * (level * sums + jump * cross - np.log(determinant))
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    steps = [axis.steps(each) for each in positions]
    return np.asarray(
        (share * level).sum()
        + steps[0] @ (share * jump).sum(axis=1)
        - steps[1] @ (share * jump).sum(axis=0)
    )


def speed(key: str) -> Table:
    """Processor seconds and memory of an identification, as the data grow."""
    columns = "wave", "samples", "data, s", "processor, s", "data, MB", "memory, MB"
    shown = Table(*columns, title=f"{key}: on one thread, the least of three", title_justify="left")
    sizes = [(100.0, 600.0), (200.0, 600.0), (100.0, 6000.0)]
    for wave, (rate, duration) in ((wave, size) for wave in ("square", "sine") for size in sizes):
        study = study_of({"stiffness": wave, "duration_s": duration, "rate": rate}, [key], 1)
        ensemble, _ = tv.study.trials.draw(study, study.scenarios[0], 0)
        method, taken = tv.methods.parse(key), []
        with threadpool_limits(1):
            for _ in range(3):
                # A new object: an ensemble caches the result of the reflex test
                new = attrs.evolve(ensemble)
                started = time.process_time()
                method.identify(new).estimates["stiffness"].band()
                taken.append(time.process_time() - started)
            new = attrs.evolve(ensemble)
            tracemalloc.start()
            method.identify(new).estimates["stiffness"].band()
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        held = ensemble.angle.nbytes + ensemble.torque.nbytes + ensemble.angle_as_recorded.nbytes
        shown.add_row(
            wave,
            f"{ensemble.samples}",
            f"{duration:g}",
            f"{min(taken):.2f}",
            f"{held / 1e6:.1f}",
            f"{peak / 1e6:.1f}",
        )
    return shown


if __name__ == "__main__":
    main()
