"""Speed and memory of the package, as ratios: run ``python benchmarks/speed.py`` from the repository root.

Each method identifies 600 s of simulated data on one thread, and is compared in the same run with

- the plain version of it in :mod:`benchmarks.plain`: a loop over time, or the dense kernel;
- the one matrix product that it cannot do without;
- itself on ten times the data, in time and in peak memory.

What a band costs is measured at 150 s: identification with its band against identification alone.

The simulation before it is compared with its random numbers and filters alone. ``--quick`` repeats less, and
leaves out the longest of the plain versions.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tracemalloc
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))  # when run as a script

from benchmarks import plain, special

import tvsysid as tv
from tvsysid.numerics.bases import evaluate
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate

Array = NDArray[np.float64]
Call = Callable[[], Any]

RATE = 100.0
RAW_RATE = 1000.0
PERIOD = 2.0
DURATION = 600.0
BAND_DURATION = 150.0
MOVING = 106.0
TENFOLD = 6000.0
LAGS = 12
HALF = 5
SEGMENT = 30
REACH = 25
"""Samples beyond a realization that the product of all ensemble methods is given: twice the lags, and one."""
BLOCK = 16384
"""Samples filtered at once in the bare stages, so that they too stay in the cache."""

PERTURBATIONS = {"filtered noise": tv.simulate.FilteredNoise(), "PRBS": tv.simulate.PRBS()}


@dataclass(frozen=True)
class Case:
    """A method on a record of so many seconds; its plain version, whether that takes long, who makes its ensemble."""

    name: str
    method: tv.methods.Method
    duration: float = DURATION
    plain: Callable[[tv.Ensemble], Any] | None = None
    long: bool = False
    made: Callable[[float], tv.Ensemble] | None = None


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed and memory of tvsysid, as ratios.")
    parser.add_argument("--quick", action="store_true", help="repeat less, leave out the longest")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    console = Console(width=None if sys.stdout.isatty() else 120)
    with threadpool_limits(1):
        console.print(methods_table(quick))
        console.print(bands_table(quick))
        console.print(stages_table(quick))


def cases() -> Iterator[Case]:
    """Rows of the first table."""
    yield Case("eirf", tv.EnsembleIRF(), plain=plain_eirf)
    yield Case("sds", tv.ShortDataSegments(), plain=plain_sds)
    yield Case("esm", tv.EnsembleSpectral(), plain=plain_esm)
    yield Case("birf parametric, no prior", tv.BasisIRF(prior="none"), plain=plain_birf_parametric)
    yield Case("birf parametric, sparse", tv.BasisIRF())
    response = tv.BasisIRF(model="irf", prior="none")
    yield Case("birf irf, no prior", response, plain=plain_birf_irf, long=True)
    yield Case("birf irf, sparse", tv.BasisIRF(model="irf"))
    yield Case("kbr", tv.KernelRegression())
    yield Case("kbr, closed loop", tv.KernelRegression(reference="reference", weighting="residual"))
    decaying = tv.KernelRegression.preset("experiment")
    for name, method in (("kbr", tv.KernelRegression()), ("kbr, decaying kernel", decaying)):
        for duration in (20.0, 40.0):
            yield Case(name, method, duration, partial(plain_kbr, method=method), long=duration > 20)
    yield Case("lpv", tv.ScheduledIRF(), MOVING)
    yield Case("lpvkbi", tv.ScheduledImpedance(), MOVING)
    yield Case("skirt", tv.SkirtDecomposition(), made=multisine)
    yield Case("modal", tv.ModalDecomposition(), made=ringing)


def methods_table(quick: bool) -> Table:
    """Each method against its plain version, its matrix product, and itself on ten times the data."""
    table = Table(
        title=f"Identification on one thread, {RATE:g} Hz",
        caption="Median times in ms. plain: loop over time, or dense kernel, which is out of reach for "
        "longer records than those shown. product: the matrix product that the method cannot do without. "
        f"10 x: {TENFOLD:g} s against {DURATION:g} s, in time and in peak memory.",
    )
    table.add_column("method")
    ratios = "plain/fast", "product", "fast/product", "10 x: time", "memory"
    for heading in ("record, s", "fast", "plain", *ratios):
        table.add_column(heading, justify="right")
    tenfold = simulated(TENFOLD)
    wanted = {(case.duration, case.made or simulated) for case in cases()}
    ensembles = {(duration, made): made(duration) for duration, made in wanted}
    for case in cases():
        ensemble = ensembles[case.duration, case.made or simulated]
        larger = tenfold if case.duration == DURATION and case.made is None else None
        table.add_row(case.name, f"{case.duration:g}", *measured(case, ensemble, larger, quick))
    return table


def measured(case: Case, ensemble: tv.Ensemble, tenfold: tv.Ensemble | None, quick: bool) -> list[str]:
    """Cells of one row."""

    def identify() -> Any:
        return case.method.identify(ensemble)

    fast = milliseconds(identify, 5 if quick else 25)
    cells = [f"{fast:.1f}", *[""] * 6]
    if case.made is None:
        product = milliseconds(needed_product(case.method, ensemble), 5 if quick else 25)
        cells[3:5] = [f"{product:.2f}", f"{fast / product:.1f}"]
    if case.plain is not None and not (quick and case.long):
        version = case.plain
        slow = milliseconds(lambda: version(ensemble), 1 if quick or case.long else 3, warm=False)
        cells[1:3] = [f"{slow:.0f}", f"{slow / fast:.0f}"]
    if tenfold is not None:
        larger = tenfold
        slower = milliseconds(lambda: case.method.identify(larger), 2 if quick else 5)
        peak = peak_bytes(lambda: case.method.identify(larger)) / peak_bytes(identify)
        cells[5:] = [f"{slower / fast:.1f}", f"{peak:.1f}"]
    return cells


def bands_table(quick: bool) -> Table:
    """Identification with the band of stiffness against identification alone, in turns."""
    table = Table(
        title=f"Band of stiffness, {BAND_DURATION:g} s",
        caption="alone: nobody asks for a band. Medians of processor times in ms, and of ratios.",
    )
    table.add_column("method")
    for heading in ("alone", "with band", "with/alone"):
        table.add_column(heading, justify="right")
    ensemble = simulated(BAND_DURATION)
    methods = {
        "eirf": tv.EnsembleIRF(),
        "sds": tv.ShortDataSegments(),
        "sds, window 0.4 s": tv.ShortDataSegments(window=0.4),
        "birf": tv.BasisIRF(),
        "birf, no prior": tv.BasisIRF(prior="none"),
        "esm": tv.EnsembleSpectral(),
        "kbr": tv.KernelRegression(),
    }
    for name, method in methods.items():
        alone, banded = [], []
        for _ in range(20 if quick else 100):
            alone.append(seconds(lambda m=method: m.identify(ensemble)))
            banded.append(seconds(lambda m=method: m.identify(ensemble).estimates["stiffness"].band()))
        ratio = statistics.median(both / one for one, both in zip(alone, banded, strict=True))
        times = (f"{1e3 * statistics.median(values):.2f}" for values in (alone, banded))
        table.add_row(name, *times, f"{ratio:.2f}")
    return table


def seconds(call: Call) -> float:
    """Processor time of a call, which others on the machine disturb less than the time that passes."""
    started = process_time()
    call()
    return process_time() - started


def stages_table(quick: bool) -> Table:
    """Simulation against its random numbers and filters alone; decimation and segmentation."""
    table = Table(
        title=f"Stages before identification, {DURATION:g} s",
        caption="bare: random numbers and recursive filters of the simulation alone.",
    )
    table.add_column("stage")
    for heading in ("ms", "bare, ms", "ms/bare", "simulated seconds per second"):
        table.add_column(heading, justify="right")
    repetitions = 3 if quick else 9
    for name, perturbation in PERTURBATIONS.items():
        whole = milliseconds(lambda p=perturbation: simulation(DURATION, p), repetitions)
        bare = milliseconds(lambda p=perturbation: bare_simulation(DURATION, p), repetitions)
        cells = f"{whole:.0f}", f"{bare:.0f}", f"{whole / bare:.2f}", f"{DURATION / whole * 1e3:.0f}"
        table.add_row(f"simulate, {name}", *cells)
    recording = simulation(DURATION).recording
    lower = tv.preprocess.decimate(recording, RATE)
    ensemble = tv.preprocess.segment(lower, PERIOD)
    stages: dict[str, Call] = {
        f"decimate {RAW_RATE:g} to {RATE:g} Hz": lambda: tv.preprocess.decimate(recording, RATE),
        f"segment by {PERIOD:g} s": lambda: tv.preprocess.segment(lower, PERIOD),
        "subtract mean": lambda: tv.preprocess.subtract_mean(ensemble),
    }
    for name, stage in stages.items():
        time = milliseconds(stage, repetitions)
        table.add_row(name, f"{time:.2f}", "", "", f"{DURATION / time * 1e3:.0f}")
    return table


def milliseconds(call: Call, repetitions: int, warm: bool = True) -> float:
    """Median time of a call."""
    if warm:
        call()
    times = []
    for _ in range(repetitions):
        started = perf_counter()
        call()
        times.append(perf_counter() - started)
    return 1e3 * statistics.median(times)


def peak_bytes(call: Call) -> int:
    """Most memory that a call holds at once, beyond what was held before."""
    tracemalloc.start()
    call()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def simulation(duration: float, perturbation: Any = None) -> tv.simulate.Simulation:
    perturbation = perturbation or tv.simulate.FilteredNoise()
    square = tv.simulate.SquareWave()
    return tv.simulate.Joint(stiffness=square).simulate(
        duration, perturbation=perturbation, snr_db=10, seed=1, rate=RAW_RATE
    )


def simulated(duration: float) -> tv.Ensemble:
    """Realizations with a slow variable; the angle is imposed, so that it is a reference too."""
    recording = simulation(duration).recording
    slowly = {"scheduling": np.sin(2 * np.pi * 0.1 * recording.time), "reference": recording.angle}
    return tv.preprocess.segment(tv.preprocess.decimate(replace(recording, channels=slowly), RATE), PERIOD)


def multisine(duration: float) -> tv.Ensemble:
    """Realizations for the skirt decomposition."""
    return special.ensemble_of(special.Joint(special.SINE), duration, special.FIVE, 10.0, 1)


def ringing(duration: float) -> tv.Ensemble:
    """Realizations for the modal decomposition."""
    return special.ensemble_of(special.joint_of(0.2), duration, special.IMPULSES, 30.0, 1)


def bare_simulation(duration: float, perturbation: Any) -> None:
    """Perturbation; position and velocity by one second-order filter each; noise by another."""
    samples = round((duration + 3) * RAW_RATE)  # the simulation's own margins
    random = np.random.default_rng(1)
    drive = perturbation.generate(samples, RAW_RATE, random)
    numerator, denominator = np.array([0.1, 0.2, 0.1]), np.array([1.0, -1.0, 0.4])
    states = [np.zeros(2) for _ in range(3)]
    for first in range(0, samples, BLOCK):
        block = drive[first : first + BLOCK]
        for number, signal in enumerate((block, block, random.standard_normal(len(block)))):
            _, states[number] = lfilter(numerator, denominator, signal, zi=states[number])


def needed_product(method: tv.methods.Method, ensemble: tv.Ensemble) -> Call:
    """Second moments over realizations; for methods with regressors, their Gram matrix."""
    if isinstance(method, tv.KernelRegression):
        columns = 3 * method.identify(ensemble).kernel.columns + plain.EXTERNAL_TERMS
        bins = round((method.band[1] - method.band[0]) * len(ensemble) * ensemble.duration) + 1
        regressors = np.random.default_rng(1).standard_normal((columns, 2 * bins))
        return lambda: regressors @ regressors.T
    if isinstance(method, tv.ScheduledIRF | tv.ScheduledImpedance):
        columns = round(method.identify(ensemble).diagnostics.parameters)
        regressors = np.random.default_rng(1).standard_normal((columns, len(ensemble) * ensemble.samples))
        return lambda: regressors @ regressors.T
    used = slice(ensemble.context - REACH, ensemble.context + ensemble.samples + REACH)
    u = np.ascontiguousarray(ensemble.angle[:, used])
    return lambda: u.T @ u


def plain_eirf(ensemble: tv.Ensemble) -> Array:
    return plain.eirf(ensemble.angle, ensemble.torque, ensemble.context, LAGS, rate=RATE)


def plain_sds(ensemble: tv.Ensemble) -> Array:
    return plain.sds(ensemble.angle, ensemble.torque, ensemble.context, LAGS, half=HALF, rate=RATE)


def plain_esm(ensemble: tv.Ensemble) -> plain.ComplexArray:
    return plain.esm(ensemble.angle, ensemble.torque, ensemble.context, SEGMENT)


def plain_birf_irf(ensemble: tv.Ensemble) -> Array:
    values = evaluate(tv.CubicBSplines(10), ensemble.samples)
    signals = ensemble.angle, ensemble.torque
    return plain.birf_irf(*signals, ensemble.context, LAGS, basis_values=values, rate=RATE)


def plain_birf_parametric(ensemble: tv.Ensemble) -> plain.Impedance:
    values = evaluate(tv.CubicBSplines(10), ensemble.samples)
    edge = ensemble.context - HALF_WIDTH
    signals = differentiate(ensemble.angle[:, edge : ensemble.angle.shape[1] - edge], RATE)
    return plain.birf_parametric(*signals, ensemble.torque[:, ensemble.core], values)


def plain_kbr(ensemble: tv.Ensemble, method: tv.KernelRegression) -> plain.KernelFit:
    signals = differentiate(plain.join(ensemble.angle, ensemble.context, HALF_WIDTH), RATE)
    return plain.kbr_dense(
        *signals,
        plain.join(ensemble.torque, ensemble.context),
        rate=RATE,
        period=PERIOD,
        l1=method.length_periodic,
        l2=method.length_decay,
        gamma=method.gamma,
        band=method.band,
    )


if __name__ == "__main__":
    main()
