"""Check that a refactoring changes no result.

Run ``python benchmarks/frozen.py FILE`` before the refactoring and after it.

The first run writes reference results to FILE (NetCDF). Later runs compute the results again,
compare them with FILE, and end with exit code 1 if a difference exceeds ``--tolerance``. To compare
an older checkout, write FILE with that checkout's Python. Use the same machine for both: another
BLAS kernel rounds differently. ``frozen.py FILE NEW`` also writes the new results to NEW. If NEW
exists, the command only compares the two files.

Sections (``--only``): ``methods``, every method on simulated joints and real recordings;
``diagnosis``, faults and recommendations of 20 ensembles; ``plan``; ``benchmark``, four studies on
the command line; ``experiment``, one virtual participant. All take some 6 minutes of processor
time.

A difference is relative to the largest value of its array. Texts must be equal. A quantity that
disappears counts as a difference; a new one does not. Numbers in CSV files have six digits only.

Some results amplify rounding. If the signals change by one part in 3e15, ``eirf`` of the tonic
ankle changes by 2e-6, standard errors of ``cascade`` of the reflex joint by 2e-6, those of
``cascade`` and ``adaptive`` of walking by 1e-7, and ``bpc`` may take another number of iterations.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import attrs
import h5py
import numpy as np
import pandas as pd
import scipy.linalg  # loads SciPy's BLAS, so that threadpool_limits finds it
import xarray as xr
from threadpoolctl import threadpool_info, threadpool_limits

import tvsysid as tv
from tvsysid.simulate import PERTURBATIONS, PROFILES, SYSTEMS

Results = dict[str, Any]  # arrays of numbers, and texts, by path: "methods/square/sds/stiffness"
Items = Iterator[tuple[str, Any]]

DATA = Path(os.environ.get("TVSYSID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
# Variables that differ from run to run
TIMINGS = {"seconds", "stage_seconds", "stage", "digest"}
# Dimensions of study results that become part of the path
SPLIT_AXES = ("method_key", "analysis", "quantity")
SCHEDULED = ["lpv", "lpvkbi"]  # methods that need a scheduling variable
RINGING = {"inertia": 0.1, "viscosity": 1.2, "noise_bandwidth": 40.0}
RINGING |= {"actuator_stiffness": 0.0, "actuator_inertia": 0.0, "actuator_viscosity": 0.0}
IMPULSES = attrs.evolve(PERTURBATIONS["pulses"], duration=0.02, interval=1.0)
# System, perturbation, methods.
JOINTS: dict[str, tuple[Any, Any, Iterable[str]]] = {
    "square": (
        attrs.evolve(SYSTEMS["joint"], stiffness=PROFILES["square"]),
        PERTURBATIONS["noise"],
        tv.methods.METHODS,
    ),
    "sine": (
        attrs.evolve(SYSTEMS["joint"], stiffness=PROFILES["sine"]),
        PERTURBATIONS["noise"],
        tv.methods.METHODS,
    ),
    "reflex": (SYSTEMS["reflex"], PERTURBATIONS["noise"], tv.methods.METHODS),
    "scheduled": (
        attrs.evolve(SYSTEMS["scheduled"], variable="scheduling"),
        PERTURBATIONS["noise"],
        SCHEDULED,
    ),
    "multisine": (
        attrs.evolve(SYSTEMS["joint"], stiffness=PROFILES["sine"]),
        PERTURBATIONS["multisine"],
        ["skirt"],
    ),
    "ringing": (attrs.evolve(SYSTEMS["loaded"], **RINGING), IMPULSES, ["modal"]),
}
POSTURE = {"scheduling": "sv.Scheduling Variable (SV) - Ankle Position (rad)"}
# File, angle, torque, further channels, duration of a realization in s, methods.
RECORDINGS: dict[str, tuple[str, str, str, dict[str, str], float | None, Iterable[str]]] = {
    muscle: ("tonic_ankle.mat", f"{muscle}_angle", f"{muscle}_torque", {}, 2.0, tv.methods.METHODS)
    for muscle in ("plantarflexor", "dorsiflexor", "dorsiflexor_2")
} | {
    "walking": (
        "walking_ankle_small_reflex.mat",
        "POSITION_SIGNAL",
        "TORQUE_SIGNAL",
        {},
        1.5,
        tv.methods.METHODS,
    ),
    "moving": ("moving_ankle_nldat.mat", "io.posPert1", "io.tqPert1", POSTURE, None, SCHEDULED),
}
BENCHMARKS = {"quick": 20, "paper": 5, "reflex": 3, "closed-loop": 3}  # trials of each preset


def prepared(
    recording: tv.Recording, period: float | None, reference: str | None = None
) -> tv.Ensemble:
    """Decimate and cut a recording; subtract the mean if the movement repeats."""
    ensemble = tv.preprocess.segment(
        tv.preprocess.decimate(recording, 100, sharp=period is None), period
    )
    return (
        tv.preprocess.subtract_mean(ensemble, [reference] if reference else [])
        if period
        else ensemble
    )


def methods() -> Items:
    """Identify simulated joints and real recordings by each method with default settings."""
    for name, (system, perturbation, keys) in JOINTS.items():
        made = system.simulate(100, perturbation=perturbation, snr_db=10, seed=1)
        yield from identified(name, prepared(made.recording, 2.0), keys)
    for name, (file, angle, torque, channels, period, keys) in RECORDINGS.items():
        if (DATA / file).exists():
            signals: dict[str, Any] = {"angle": angle, "torque": torque, "channels": channels}
            recording = tv.read_recording(
                DATA / file, sampling_rate=1000, torque_sign=-1, **signals
            )
            yield from identified(name, prepared(recording, period), keys)


def identified(name: str, ensemble: tv.Ensemble, keys: Iterable[str]) -> Items:
    """Yield all estimates of each method, with standard errors, torque, details and warnings."""
    yield f"{name}/ensemble/angle", ensemble.angle
    yield f"{name}/ensemble/torque", ensemble.torque
    for key in keys:
        try:
            model = tv.methods.parse(key).identify(ensemble).to_xarray(ensemble)
        except tv.InputError as error:
            yield f"{name}/{key}/refused", str(error)
            continue
        for what, value in (*model.variables.items(), *model.attrs.items()):
            yield f"{name}/{key}/{what}", getattr(value, "values", value)


def diagnosis() -> Items:
    """Diagnose 20 simulated ensembles, and recommend a method for each."""
    systems = ("joint", "reflex", "compliant", "loaded", "scheduled")
    for seed, (system, perturbation, snr_db) in enumerate(
        product(systems, ("noise", "prbs"), (10, 0))
    ):
        made = SYSTEMS[system].simulate(
            60, perturbation=PERTURBATIONS[perturbation], snr_db=snr_db, seed=seed
        )
        reference = "disturbance" if system == "loaded" else None
        scheduling = "emg" if system == "scheduled" else None
        ensemble = prepared(made.recording, 2.0, reference)
        diagnosed = tv.diagnose(ensemble, reference=reference)
        path = f"{system} {perturbation} {snr_db} dB"
        for check in diagnosed.table.to_dict("records"):
            yield f"{path}/{check['name']}", check["value"]
            yield f"{path}/{check['name']} finding", f"{check['state']}: {check['what']}"
        found = tv.recommend(ensemble, reference, scheduling, diagnosis=diagnosed)
        yield f"{path}/recommendation", repr(found).splitlines()


def plan() -> Items:
    """Plan a recording with default settings."""
    yield from columns("default", tv.plan(tv.planning.Protocol()).table())


def benchmark() -> Items:
    """Run studies of simulated joints on the command line."""
    for preset, trials in BENCHMARKS.items():
        yield from written(preset, "benchmark", "--preset", preset, "--trials", str(trials))


def experiment() -> Items:
    """Run the experiment of one virtual participant on the command line."""
    yield from written("virtual", "experiment", "--virtual", "1", "--bootstraps", "10")


def written(name: str, *command: str) -> Items:
    """Run a command of the installed package; yield its results and tables."""
    with tempfile.TemporaryDirectory() as folder:
        words = [
            str(Path(sys.executable).with_name("tvsysid")),
            *command,
            "--workers",
            "1",
            "--out",
            folder,
        ]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise SystemExit(f"{' '.join(words)} failed:\n{ended.stderr}")
        with xr.open_dataset(next(Path(folder).glob("results.*"))) as results:
            yield from split(f"{name}/results", results)
        for file in sorted(Path(folder).glob("*.csv")):
            table = pd.read_csv(file)
            for metric, rows in (
                table.groupby("metric") if "metric" in table else [("table", table)]
            ):
                if metric not in TIMINGS:
                    yield from columns(f"{name}/{file.name}/{metric}", rows)


def split(path: str, results: xr.Dataset) -> Items:
    """Yield the variables of a dataset, those of each method and quantity apart."""
    axis = next((axis for axis in SPLIT_AXES if axis in results.dims), None)
    if axis is None:
        yield from (
            (f"{path}/{name}", variable.values) for name, variable in results.variables.items()
        )
    else:
        for index, label in enumerate(results[axis].values):
            yield from split(f"{path}/{label}", results.isel({axis: index}))


def columns(path: str, table: pd.DataFrame) -> Items:
    """Yield the columns of a table."""
    for name, column in table.items():
        numeric = pd.api.types.is_numeric_dtype(column)
        values = (
            column.to_numpy(float, na_value=np.nan)
            if numeric
            else column.fillna("").to_numpy(object)
        )
        yield f"{path}/{str(name).replace('/', ' per ')}", values


SECTIONS = {each.__name__: each for each in (methods, diagnosis, plan, benchmark, experiment)}


def computed(sections: Iterable[str]) -> Results:
    """Compute the results of these sections, on one thread."""
    kernels = sorted(
        {str(each.get("architecture")) for each in threadpool_info() if each["user_api"] == "blas"}
    )
    results = {
        "machine/versions": f"numpy {np.__version__}, scipy {scipy.__version__}, BLAS "
        f"{' '.join(kernels)}"
    }
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for section in sections:
            print(f"{section} ...", end=" ", flush=True)
            started = time.perf_counter()
            items = (
                (path, value)
                for path, value in SECTIONS[section]()
                if path.split("/")[-1] not in TIMINGS
            )
            results |= {f"{section}/{path}": plain(value) for path, value in items}
            print(f"{time.perf_counter() - started:.0f} s", flush=True)
    return results


def plain(value: Any) -> Any:
    """Return an array of floats, or the lines of a text."""
    array = np.asarray(value)
    if array.dtype.kind in "OUST":
        return "\n".join(map(str, array.ravel()))
    return (np.stack([array.real, array.imag]) if array.dtype.kind == "c" else array).astype(
        np.float64
    )


def write(results: Results, file: Path) -> None:
    """Write results as NetCDF: a group for each path, a variable for its last part."""
    groups: dict[str, dict[str, xr.Variable]] = {}
    for path, value in results.items():
        group, _, name = path.rpartition("/")
        axes = [f"{name} {axis}" for axis in range(np.ndim(value))]
        groups.setdefault(group, {})[name] = xr.Variable(axes, value)
    tree = xr.DataTree.from_dict(
        {group: xr.Dataset(variables) for group, variables in groups.items()}
    )
    tree.to_netcdf(file, engine="h5netcdf")


def read(file: Path, sections: Iterable[str]) -> Results:
    """Read the results of these sections."""
    results: Results = {}

    def add(path: str, item: Any) -> None:
        if (
            isinstance(item, h5py.Dataset)
            and not item.is_scale
            and path.partition("/")[0] in ("machine", *sections)
            and path.rpartition("/")[2] not in TIMINGS
        ):
            results[path] = item.asstr()[()] if item.dtype.kind == "O" else item[()]

    with h5py.File(file) as content:  # xarray takes a minute to open so many groups
        content.visititems(add)
    return results


def difference(old: Any, new: Any) -> float:
    """Return the largest difference relative to the largest old value.

    Infinity where the two cannot be compared.
    """
    if new is None or isinstance(old, str) or isinstance(new, str) or old.shape != new.shape:
        return 0.0 if np.array_equal(old, new) else np.inf
    with np.errstate(invalid="ignore"):
        gaps = np.where((old == new) | (np.isnan(old) & np.isnan(new)), 0.0, np.abs(new - old))
    scale = np.max(np.abs(old), initial=np.finfo(float).tiny, where=np.isfinite(old))
    return float(np.max(np.nan_to_num(gaps / scale, nan=np.inf), initial=0.0))


def report(old: Results, new: Results, tolerance: float) -> int:
    """Print the largest difference of each item, and what exceeds the tolerance.

    Return how many quantities do.
    """
    differences = {path: difference(value, new.get(path)) for path, value in old.items()}
    items: dict[str, list[str]] = {}
    for path in dict.fromkeys([*old, *new]):
        items.setdefault("/".join(path.split("/")[:2]), []).append(path)
    for item, paths in items.items():
        largest = max((differences[path] for path in paths if path in old), default=0.0)
        print(f"{item}: {len(paths)} quantities, largest difference {largest:.1e}")
        numbers: dict[str, list[tuple[float, str]]] = {}
        for path in paths:
            group, _, name = path.rpartition("/")
            if path in old and tolerance < differences[path] < np.inf:
                numbers.setdefault(group, []).append((differences[path], name))
            elif path not in old or differences[path] > tolerance:
                print(f"    {path}: {explained(old.get(path), new.get(path))}")
        for group, beyond in numbers.items():
            shown = ", ".join(f"{name} {gap:.1e}" for gap, name in sorted(beyond, reverse=True)[:5])
            print(f"    {group}: {len(beyond)} differ: {shown}{', ...' * (len(beyond) > 5)}")
    count = sum(each > tolerance for each in differences.values())
    print(f"{count} of {len(differences)} quantities differ by more than {tolerance:g}")
    return count


def explained(old: Any, new: Any) -> str:
    """Say how a quantity differs that cannot be compared as numbers."""
    if old is None or new is None:
        return "new" if old is None else "gone"
    if isinstance(old, str) and isinstance(new, str):
        before, after = old.splitlines(), new.splitlines()
        lines = [f"- {line}" for line in before if line not in after]
        lines += [f"+ {line}" for line in after if line not in before]
        return (
            "".join(f"\n        {line}" for line in lines)
            or "the same lines, repeated or in another order"
        )
    return (
        f"shape {np.shape(old)}, now {np.shape(new)}"
        if np.shape(old) != np.shape(new)
        else "NaN at other places"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Check that a refactoring moves no result.")
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="reference results; written if the file is absent"
    )
    parser.add_argument(
        "new",
        type=Path,
        nargs="?",
        metavar="NEW",
        help="new results; written if the file is absent",
    )
    parser.add_argument(
        "--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), help="sections to check"
    )
    parser.add_argument(
        "--tolerance", type=float, default=1e-9, help="largest relative difference allowed"
    )
    options = parser.parse_args()
    if not options.file.exists():
        write(computed(options.only), options.file)
        return
    new = (
        read(options.new, options.only)
        if options.new and options.new.exists()
        else computed(options.only)
    )
    if options.new and not options.new.exists():
        write(new, options.new)
    sys.exit(report(read(options.file, options.only), new, options.tolerance) > 0)


if __name__ == "__main__":
    main()
