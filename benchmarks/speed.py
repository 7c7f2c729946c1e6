"""Compare the speed of the package with its lower limits, and with another version of it.

Run ``python benchmarks/speed.py --against DIR`` from the repository root, with DIR the checkout of
another commit. It takes a minute and a half, and less than one without ``--against``.

Methods identify simulated data, and a real recording where ``../shared/data`` has it, on one
thread, as ``Method.identify`` always does. A time is the shortest of several. Processor times are
compared with those of two floors, and of the other checkout on the same data:

- product: the matrix product that the method cannot do without, which is that of its regressors,
  one for each effective parameter, or for methods that work at each time, of the angle at all times
  over realizations;
- plain: the version in :mod:`benchmarks.plain`, a loop over time or the dense kernel.
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
# Fields of an ensemble that both checkouts are given
FIELDS = ("angle", "torque", "sampling_rate", "context", "onsets", "trials", "mean_subtracted")
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
        here = measured_apart(folder, HERE)
        there = measured_apart(folder, given.against) if given.against else None
        with threadpool_limits(1):
            floors = {case: floor(case, each, folder) for case, each in here.items()}
    Console(width=None if sys.stdout.isatty() else 100).print(times_table(here, there, floors))


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
        write_fields(folder / f"{name}.npz", tv.preprocess.subtract_mean(ensemble, ["reference"]))
        if name == "150 s":
            columns = {"angle": recording.angle, "torque": recording.torque}
            tv.recordings.write_simulation(folder / "recording.mat", columns, RAW_RATE_HZ)
    made = special.ensemble_of(special.Joint(special.SINE), 600, special.FIVE, 10.0, 1)
    write_fields(folder / "multisine, 600 s.npz", made)
    made = special.ensemble_of(special.joint_of(0.2), 600, special.IMPULSES, 30.0, 1)
    write_fields(folder / "impulses, 600 s.npz", made)
    if WALKING.is_file():
        recording = tv.read_recording(
            WALKING,
            angle="POSITION_SIGNAL",
            torque="TORQUE_SIGNAL",
            sampling_rate=RAW_RATE_HZ,
            torque_sign=-1,
        )
        ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, RATE_HZ), 1.5)
        write_fields(folder / "walking.npz", tv.preprocess.subtract_mean(ensemble))


def write_fields(file: Path, ensemble: tv.Ensemble) -> None:
    """Write an ensemble as plain arrays, which any version of the package can read."""
    fields = {name: getattr(ensemble, name) for name in FIELDS}
    if ensemble.recorded_angle is not None:
        fields["recorded_angle"] = ensemble.recorded_angle
    channels = {f"channel {name}": values for name, values in ensemble.channels.items()}
    np.savez(file, **fields, **channels)


def read_fields(file: Path) -> tv.Ensemble:
    """Return an ensemble that was written by ``write_fields``."""
    channels, fields = {}, {}
    with np.load(file) as stored:
        for name, values in stored.items():
            kind, _, channel = name.partition(" ")
            if kind == "channel":
                channels[channel] = values
            else:
                fields[name] = values if values.ndim else values.item()
    return tv.Ensemble(**fields, channels=channels)


def measured_apart(folder: Path, checkout: Path) -> Measured:
    """Return the times of a checkout, measured in a process of its own on one thread."""
    settings = os.environ | {
        "PYTHONPATH": str(checkout.resolve() / "src"),
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, __file__, "--measure", str(folder)]
    done = subprocess.run(command, env=settings, stdout=subprocess.PIPE, check=True, text=True)
    result: Measured = json.loads(done.stdout)
    return result


def measured(folder: Path) -> Measured:
    """Times of everything that is measured."""
    found: Measured = {}
    for name, methods in METHODS.items():
        if not (file := folder / f"{name}.npz").is_file():
            continue
        ensemble = read_fields(file)
        for label in methods:
            try:
                method = tv.methods.parse(label)
                model = method.identify(ensemble)
            except Exception as error:  # another version may lack a method, a setting or a library
                print(f"{tv.__file__}: {label}, {name}: {error}", file=sys.stderr)
                continue
            found[f"{label}, {name}"] = [
                *fastest(partial(identify, method, ensemble)),
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
            run = partial(subprocess.run, command, capture_output=True, check=True)
            try:
                found[f"tvsysid identify, {name}"] = fastest(run)
            except subprocess.CalledProcessError as error:  # of another version, as above
                print(f"{tv.__file__}: {error.stderr.decode().splitlines()[-1]}", file=sys.stderr)
    return found


def identify(method: tv.methods.Method, ensemble: tv.Ensemble) -> tv.Model:
    """Identify a copy of an ensemble, because fits of the same ensemble are cached."""
    return method.identify(ensemble.select(range(len(ensemble))))


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
    ensemble = read_fields(folder / f"{name}.npz")
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
    here: Measured, there: Measured | None, floors: dict[str, dict[str, float]]
) -> Table:
    """Return a row for everything that was measured."""
    table = Table(
        title="Speed on one thread",
        caption="over ...: times as long as the floor or the other checkout (old); below 1: faster",
    )
    table.add_column("what")
    headings = ["processor (ms)", "wall (ms)", "over product", "over plain"]
    headings += ["over old"] if there else []
    for heading in headings:
        table.add_column(heading, justify="right")
    for case, (processor, wall, *_) in here.items():
        floor_times = floors[case]
        compared = [floor_times.get("product"), floor_times.get("plain")]
        if there:
            compared.append(there[case][0] if case in there else None)
        ratios = (f"{processor / each:.2f}" if each else "" for each in compared)
        table.add_row(case, f"{processor:.1f}", f"{wall:.1f}", *ratios)
    return table


if __name__ == "__main__":
    main()
