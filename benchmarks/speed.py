"""Compare the speed of the package with its lower limits.

Run ``python benchmarks/speed.py`` from the repository root. It takes two minutes.

Methods identify simulated data, and a real recording where ``../shared/data`` has it, with BLAS on
one thread and with its default number of threads. A time is the shortest of several, in ms. Two
floors are measured on one thread:

- product: the matrix product that the method cannot do without, which is that of its regressors,
  one for each effective parameter, or for methods that work at each time, of the angle at all times
  over realizations;
- plain: the version in :mod:`benchmarks.plain`, a loop over time or the dense kernel.

``--against DIR`` also measures another checkout, on the same data with the same Python, and
shows how many times as long it takes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import attrs
import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).parents[1]))  # when run as a script

from benchmarks import plain, special

import tvsysid as tv
from tvsysid.numerics.bases import evaluate
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate

# Processor time and wall time in ms; of a method, its effective parameters too
Measured = dict[str, list[float]]

HERE = Path(__file__).parents[1]
RATE_HZ, RAW_RATE_HZ, PERIOD_S = 100.0, 1000.0, 2.0
ENOUGH_S = 0.4  # time after which a call is not repeated
# samples beyond a realization that the product at each time is given: twice the lags, and one
REACH = 25
WALKING = HERE.parent / "shared/data/walking_ankle_small_reflex.mat"
WALKING_OPTIONS = "--angle POSITION_SIGNAL --torque TORQUE_SIGNAL --period 1.5 --torque-sign -1"
AT_EACH_TIME = ("eirf", "sds", "esm")
METHODS = {
    "20 s": ("kbr",),
    "150 s": ("adaptive", "eirf", "sds", "birf", "esm", "kbr", "cascade", "lpv", "lpvkbi"),
    "600 s": (
        *("adaptive", "eirf", "sds", "birf", "birf:model=irf", "birf:prior=none", "esm", "kbr"),
        *("kbr:reference=reference,weighting=residual", "cascade"),
    ),
    "reflex, 600 s": ("adaptive", "cascade", "sdss"),
    "multisine, 600 s": ("skirt",),
    "impulses, 600 s": ("modal",),
    "walking": ("adaptive", "kbr", "cascade"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of tvsysid beside its floors.")
    parser.add_argument(
        "--against", type=Path, metavar="DIR", help="another checkout to compare with"
    )
    parser.add_argument("--measure", type=Path, metavar="FOLDER", help=argparse.SUPPRESS)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.measure:
        print(json.dumps(measured(given.measure)))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_data(folder)
        here, there = {}, {}
        for threads in ("1", ""):
            here[threads] = measured_apart(folder, HERE, threads)
            if given.against:
                there[threads] = measured_apart(folder, given.against, threads)
        with threadpool_limits(1):
            floors = {case: floor(case, each, folder) for case, each in here["1"].items()}
            table = times_table(here, there, floors)
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def write_data(folder: Path) -> None:
    """Write an ensemble of each name in ``METHODS``, and a recording."""
    joint, noise = (
        tv.simulate.Joint(stiffness=tv.simulate.SquareWave()),
        tv.simulate.FilteredNoise(),
    )
    systems = {
        "20 s": joint,
        "150 s": joint,
        "600 s": joint,
        "reflex, 600 s": tv.simulate.ReflexJoint(),
    }
    for name, system in systems.items():
        seconds = float(name.split()[-2])
        recording = system.simulate(
            seconds, perturbation=noise, snr_db=10, seed=1, rate=RAW_RATE_HZ
        ).recording
        # A slow variable; the angle is imposed, so that it is a reference too.
        slowly = {
            "scheduling": np.sin(2 * np.pi * 0.1 * recording.time),
            "reference": recording.angle,
        }
        ensemble = tv.preprocess.segment(
            tv.preprocess.decimate(attrs.evolve(recording, channels=slowly), RATE_HZ), PERIOD_S
        )
        tv.recordings.write_ensemble(
            folder / f"{name}.nc", tv.preprocess.subtract_mean(ensemble, ["reference"])
        )
        if name == "150 s":
            columns = {"angle": recording.angle, "torque": recording.torque}
            tv.recordings.write_simulation(folder / "recording.mat", columns, RAW_RATE_HZ)
    made = special.ensemble_of(special.Joint(special.SINE), 600, special.FIVE, 10.0, 1)
    tv.recordings.write_ensemble(folder / "multisine, 600 s.nc", made)
    made = special.ensemble_of(special.joint_of(0.2), 600, special.IMPULSES, 30.0, 1)
    tv.recordings.write_ensemble(folder / "impulses, 600 s.nc", made)
    if WALKING.is_file():
        recording = tv.read_recording(
            WALKING,
            angle="POSITION_SIGNAL",
            torque="TORQUE_SIGNAL",
            sampling_rate=RAW_RATE_HZ,
            torque_sign=-1,
        )
        ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, RATE_HZ), 1.5)
        tv.recordings.write_ensemble(folder / "walking.nc", tv.preprocess.subtract_mean(ensemble))


def measured_apart(folder: Path, checkout: Path, threads: str) -> Measured:
    """Times in a process of its own, by a checkout, with so many threads of BLAS.

    The default number if empty.
    """
    settings = os.environ | {"PYTHONPATH": str(checkout.resolve() / "src")}
    settings |= {"OPENBLAS_NUM_THREADS": threads} if threads else {}
    command = [sys.executable, __file__, "--measure", str(folder)]
    done = subprocess.run(command, env=settings, stdout=subprocess.PIPE, check=True, text=True)
    result: Measured = json.loads(done.stdout)
    return result


def measured(folder: Path) -> Measured:
    """Times of everything that is measured."""
    found: Measured = {}
    for name, methods in METHODS.items():
        if not (file := folder / f"{name}.nc").is_file():
            continue
        ensemble = tv.recordings.load_ensemble(file)
        for label in methods:
            method = tv.methods.parse(label)
            model = method.identify(ensemble)
            found[f"{label}, {name}"] = [
                *fastest(partial(method.identify, ensemble)),
                model.diagnostics.parameters,
            ]
    joint, noise = (
        tv.simulate.Joint(stiffness=tv.simulate.SquareWave()),
        tv.simulate.FilteredNoise(),
    )
    simulate = partial(joint.simulate, 600, perturbation=noise, snr_db=10, seed=1, rate=RAW_RATE_HZ)
    found["simulate 600 s"] = fastest(simulate)
    found["decimate 600 s"] = fastest(
        partial(tv.preprocess.decimate, simulate().recording, RATE_HZ)
    )
    files = {
        folder / "recording.mat": "--angle angle --torque torque --period 2",
        WALKING: WALKING_OPTIONS,
    }
    for file, options in files.items():
        if file.is_file():
            more = (
                f"--rate {RAW_RATE_HZ:g} --decimate {RATE_HZ:g} --out {folder / 'identified'} "
                f"{options}"
            ).split()
            command = [sys.executable, "-m", "tvsysid.cli", "identify", str(file), *more]
            name = "walking" if file == WALKING else "150 s"
            found[f"tvsysid identify, {name}"] = fastest(
                partial(subprocess.run, command, capture_output=True, check=True)
            )
    return found


def fastest(call: Callable[[], Any]) -> list[float]:
    """Return the shortest processor time and the shortest wall time of a call in ms.

    Processes that the call starts are included.
    """
    times: list[tuple[float, float]] = []
    started = perf_counter()
    while not times or perf_counter() - started < ENOUGH_S:
        before = processor_seconds(), perf_counter()
        call()
        times.append((processor_seconds() - before[0], perf_counter() - before[1]))
    return [1e3 * min(column) for column in zip(*times, strict=True)]


def processor_seconds() -> float:
    """Processor time of this process and of those that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def floor(case: str, times: list[float], folder: Path) -> dict[str, float]:
    """Processor time in ms of the product and of the plain version of a method.

    Without those that there are not.
    """
    label, _, name = case.partition(", ")
    if len(times) < 3:
        return {}
    ensemble = tv.recordings.load_ensemble(folder / f"{name}.nc")
    if label in AT_EACH_TIME:
        used = slice(ensemble.context - REACH, ensemble.context + ensemble.samples + REACH)
        regressors = np.ascontiguousarray(ensemble.angle[:, used]).T
    else:
        count = max(round(times[2]), 1)
        regressors = np.random.default_rng(1).standard_normal(
            (count, len(ensemble) * ensemble.samples)
        )
    found = {"product": fastest(lambda: regressors @ regressors.T)[0]}
    if version := PLAIN.get(case):
        found["plain"] = fastest(partial(version, ensemble))[0]
    return found


def plain_birf(ensemble: tv.Ensemble) -> plain.Impedance:
    """Least squares on basis functions, without a prior."""
    edge = ensemble.context - HALF_WIDTH
    signals = differentiate(ensemble.angle[:, edge : ensemble.angle.shape[1] - edge], RATE_HZ)
    values = evaluate(tv.CubicBSplines(10), ensemble.samples)
    return plain.birf_parametric(*signals, ensemble.torque[:, ensemble.core], values)


def plain_kbr(ensemble: tv.Ensemble) -> plain.KernelFit:
    """The dense kernel, out of reach for longer records."""
    own = tv.KernelRegression()
    signals = differentiate(plain.join(ensemble.angle, ensemble.context, HALF_WIDTH), RATE_HZ)
    kernel: dict[str, Any] = {
        "l1": own.length_periodic,
        "l2": own.length_decay,
        "gamma": own.gamma,
        "band": own.band,
    }
    torque = plain.join(ensemble.torque, ensemble.context)
    return plain.kbr_dense(*signals, torque, rate=RATE_HZ, period=PERIOD_S, **kernel)


PLAIN: dict[str, Callable[[tv.Ensemble], Any]] = {
    "eirf, 600 s": lambda e: plain.eirf(e.angle, e.torque, e.context, 12, rate=RATE_HZ),
    "sds, 600 s": lambda e: plain.sds(e.angle, e.torque, e.context, 12, half=5, rate=RATE_HZ),
    "esm, 600 s": lambda e: plain.esm(e.angle, e.torque, e.context, 30),
    "birf:prior=none, 600 s": plain_birf,
    "kbr, 20 s": plain_kbr,
}


def times_table(
    here: dict[str, Measured], there: dict[str, Measured], floors: dict[str, dict[str, float]]
) -> Table:
    """A row for everything that was measured."""
    table = Table(
        title="Processor (wall) time in ms",
        caption="/product, plain/: processor times on one thread. other/: times of the other "
        "checkout over these.",
    )
    table.add_column("what")
    headings = ["one thread", "default threads", "product", "/product", "plain", "plain/"]
    headings += ["other/, one thread", "other/, default threads"] if there else []
    for heading in headings:
        table.add_column(heading, justify="right")
    for case, (used, *_) in here["1"].items():
        own = floors[case]
        cells = [f"{each[case][0]:.1f} ({each[case][1]:.1f})" for each in here.values()]
        cells += (
            [f"{own['product']:.2f}", f"{used / own['product']:.1f}"]
            if "product" in own
            else ["", ""]
        )
        cells += (
            [f"{own['plain']:.0f}", f"{own['plain'] / used:.1f}"] if "plain" in own else ["", ""]
        )
        ratios = [
            np.divide(each[case][:2], here[threads][case][:2]) for threads, each in there.items()
        ]
        cells += [f"{processor:.2f} ({wall:.2f})" for processor, wall in ratios]
        table.add_row(case, *cells)
    return table


if __name__ == "__main__":
    main()
