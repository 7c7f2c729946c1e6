"""Where a study's results are kept: xarray on Zarr, a chunk of each variable for each trial, whole or absent.

A trial's chunks are written first and its ``checksums`` last: the length and CRC-32 of every chunk's file. A trial is
there if its files are as its checksums say. A file that is missing or cut short is what a kill or a loss of power
leaves, and the trial is run again. A whole file with other content is damage, and is refused.

The metadata depends on the study alone. So a store is known to be that of a study by holding what a new one would
hold, and metadata that was cut short can be written again.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.benchmark.study import PERIOD, RATE, Study
from tvsysid.benchmark.trial import NUMBERS, SAMPLES, STAGES, STATISTICS, STRINGS, Outcome, differences, versions
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

LAYOUT = 1
"""Version of the store's layout."""
MEASURED = (*NUMBERS, "stage_seconds", *STRINGS)
"""Variables with a chunk for each trial."""
UNITS = {
    "stiffness": "N m/rad",
    "time_varying_vaf": "percent",
    "vaf": "percent",
    "bandpassed_vaf": "percent",
    "seconds": "s",
    "stage_seconds": "s",
    "parameters": "1",
}
DIMS = {
    "stiffness": ("method_key", "time"),
    "time_varying_vaf": ("method_key", "time"),
    "vaf": ("method_key", "statistic"),
    "bandpassed_vaf": ("method_key", "statistic"),
    "stage_seconds": ("stage",),
    "checksums": ("variable",),
}
"""Dimensions within a trial; of all others, the method alone."""
MEANING = {
    "stiffness": "estimated stiffness",
    "time_varying_vaf": "variance of the noiseless torque accounted for at each time",
    "vaf": "variance of the noiseless torque accounted for, over the realizations of a trial",
    "bandpassed_vaf": "the same after a band-pass from 1 to 10 Hz",
    "parameters": "effective number of parameters",
    "seconds": "time an identification took",
    "stage_seconds": "time the rest of a trial took",
    "doubts": "warnings of the method",
    "failure": "why the method gave no result",
    "checksums": "length times 2**32 plus CRC-32 of each chunk's file; 0 where there is none",
}


class Store:
    """An open store; made by :func:`open_store`."""

    def __init__(self, path: Path, group: Any) -> None:
        self.path = path
        self._arrays: dict[str, Any] = {name: group[name] for name in (*MEASURED, "checksums")}

    def missing(self) -> list[tuple[int, int]]:
        """Scenario and trial numbers that are to be run: those not there, cut short or with a failure.

        Raises
        ------
        InputError
            If a chunk is whole but not what was written.
        """
        scenarios, trials = self._arrays["checksums"].shape[:2]
        places = ((scenario, trial) for scenario in range(scenarios) for trial in range(trials))
        return [
            place for place in places if _state(self._file, *place) != WHOLE or _content(self._file("failure", *place))
        ]

    def torn(self) -> int:
        """Number of trials whose files are missing in part or cut short.

        Raises
        ------
        InputError
            If a chunk is whole but not what was written.
        """
        scenarios, trials = self._arrays["checksums"].shape[:2]
        return sum(self._is_torn(scenario, trial) for scenario in range(scenarios) for trial in range(trials))

    def _is_torn(self, scenario: int, trial: int) -> bool:
        state = _state(self._file, scenario, trial)
        if state != ABSENT:
            return state == TORN
        # Never finished; what there is of it must be readable all the same.
        sizes = {name: len(_content(self._file(name, scenario, trial))) for name in (*NUMBERS, "stage_seconds")}
        return any(size not in (0, 8 * int(np.prod(self._arrays[name].chunks))) for name, size in sizes.items())

    def write(self, scenario: int, trial: int, outcome: Outcome) -> None:
        """Write one trial; it is there when this returns, and absent until then."""
        place = (scenario, trial)
        if _content(self._file("checksums", *place)):
            outcome = self._kept_where_failed(place, outcome)
        self._file("checksums", *place).unlink(missing_ok=True)
        for name in MEASURED:
            self._arrays[name][place] = outcome[name]
        self._arrays["checksums"][place] = np.array([_checksum(self._file(name, *place)) for name in MEASURED])

    def results(self) -> xr.Dataset:
        """What is there, read from the disk when it is used; the files are not looked through again."""
        return _in_order(_opened(self.path))

    def _kept_where_failed(self, place: tuple[int, int], outcome: Outcome) -> Outcome:
        """Outcome of a trial that is run again, with what is there already of methods that failed this time only."""
        if _state(self._file, *place) != WHOLE:
            return outcome
        failed = np.array([bool(text) for text in outcome["failure"]])
        before = np.array([bool(text) for text in self._arrays["failure"][place]])
        merged = {name: np.array(values) for name, values in outcome.items()}
        for name in (*NUMBERS, *STRINGS):
            merged[name][failed & ~before] = self._arrays[name][place][failed & ~before]
        return merged

    def _file(self, name: str, scenario: int, trial: int) -> Path:
        array = self._arrays[name]
        key = array.metadata.encode_chunk_key((scenario, trial) + (0,) * (array.ndim - 2))
        return self.path / name / str(key)


WHOLE, TORN, ABSENT = "whole", "torn", "absent"


def _state(file_of: Callable[[str, int, int], Path], scenario: int, trial: int) -> str:
    """Whether a trial's files are as its checksums say, missing or cut short, or it has no checksums.

    Raises
    ------
    InputError
        If a file is of full length but holds something else.
    """
    recorded = _content(file_of("checksums", scenario, trial))
    if len(recorded) != 8 * len(MEASURED):
        return TORN if recorded else ABSENT
    state = WHOLE
    for name, expected in zip(MEASURED, np.frombuffer(recorded, dtype="<u8").tolist(), strict=True):
        file = file_of(name, scenario, trial)
        content = _content(file)
        if len(content) < expected >> 32:
            state = TORN
        elif _sum(content) != expected:
            raise InputError(
                f"{file}: this file does not hold what was written there; to have its trial run again, remove the "
                "file; to start afresh, remove the store"
            )
    return state


@contextmanager
def open_store(path: Path, study: Study) -> Iterator[Store]:
    """Open the store of a study, or make it, and keep other processes from writing to it meanwhile.

    Parameters
    ----------
    path
        Folder of the store.
    study
        That it must be of.

    Raises
    ------
    InputError
        If the folder holds something else, the results of another study, of other versions of the software, or damaged
        ones; or if another process writes to it.
    """
    import zarr  # noqa: PLC0415  # heavy
    from filelock import FileLock, Timeout  # noqa: PLC0415  # with the store only

    path = path.resolve()  # one lock, by whatever name it is opened
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.parent / f".{path.name}.new"
    try:
        with FileLock(path.parent / f".{path.name}.lock", timeout=0):
            shutil.rmtree(fresh, ignore_errors=True)  # of a process that was killed
            try:
                _prepare(path, study, fresh)
            finally:
                shutil.rmtree(fresh, ignore_errors=True)
            yield Store(path, zarr.open_group(path, mode="r+", zarr_format=3, use_consolidated=False))
    except Timeout as error:
        raise InputError(f"{path}: another process is writing to this store; wait for it, or give another") from error


def read_results(path: str | Path) -> xr.Dataset:
    """Results of a study from its store, finished or not.

    Parameters
    ----------
    path
        Folder of the store.

    Returns
    -------
    xarray.Dataset
        As of :func:`tvsysid.benchmark.run`; read from the disk when it is used.

    Raises
    ------
    InputError
        If the folder is not such a store, or files of it are cut short or damaged.
    """
    import zarr  # noqa: PLC0415  # heavy

    if not Path(path).is_dir():
        raise InputError(f"{path}: there is no such folder; expected a store written by tvsysid's benchmark")
    try:
        results = _opened(path)
    except Exception as error:
        raise InputError(f"{path}: this is no store of results: {error}") from error
    if results.attrs.get("layout") != LAYOUT:
        found = results.attrs.get("layout", "none")
        raise InputError(f"{path}: expected a store of tvsysid's layout {LAYOUT}, found {found}")
    group: Any = zarr.open_group(path, mode="r", zarr_format=3, use_consolidated=False)
    if torn := Store(Path(path), group).torn():
        raise InputError(
            f"{path}: {torn} trials are cut short, as a loss of power leaves them; give the command that ran the study "
            "again, and they are run again"
        )
    return _in_order(results)


def _opened(path: str | Path) -> xr.Dataset:
    import xarray as xr  # noqa: PLC0415  # heavy

    # Chunks of the size of a trial, read as they are needed: no need for Dask.
    results: xr.Dataset = xr.open_zarr(path, chunks=None)
    return results


def _in_order(results: xr.Dataset) -> xr.Dataset:
    """Variables in the order of the layout, and names as plain text."""
    texts = {
        name: (values.dims, values.values.astype(object).astype(str))
        for name, values in results.coords.items()
        if values.dtype.kind == "T"
    }
    chosen: xr.Dataset = results.assign_coords(texts)[[*MEASURED, "true_stiffness", "checksums"]]
    return chosen


def size_in_bytes(study: Study) -> int:
    """About what the store of a study takes on a disk."""
    per_method = sum(8 * int(np.prod(shape)) for shape in NUMBERS.values())
    return len(study.scenarios) * study.trials * (len(study.methods) * per_method + 8 * (len(STAGES) + len(MEASURED)))


def _prepare(path: Path, study: Study, fresh: Path) -> None:
    """Make the store, or see that it is the study's and whole in its metadata."""
    root = path / "zarr.json"
    if path.exists() and not root.is_file():
        raise InputError(f"{path}: something else is in the way; expected a store of results, or nothing")
    kept = _attributes(root)
    _create(fresh, study, (kept or {}).get("machine") or machine())
    if not path.exists():
        for file in fresh.rglob("*"):
            _to_disk(file)
        fresh.rename(path)
        return
    _compare(path, kept, _attributes(fresh / "zarr.json") or {})
    for file in sorted(item for item in fresh.rglob("*") if item.is_file()):
        place = path / file.relative_to(fresh)
        content, expected = _content(place), file.read_bytes()
        if content == expected:
            continue
        if not expected.startswith(content):
            raise InputError(
                f"{place}: this file is damaged: it does not hold what such a study has there; remove the store to "
                "start afresh, or give another"
            )
        place.parent.mkdir(parents=True, exist_ok=True)
        file.replace(place)
    for leftover in path.rglob("*.partial"):
        leftover.unlink(missing_ok=True)


def _compare(path: Path, kept: dict[str, Any] | None, ours: dict[str, Any]) -> None:
    """Raise if the store says that it is another's."""
    if kept is None:
        return  # cut short, or damaged; the comparison of the files tells
    if kept.get("layout") != ours["layout"]:
        raise InputError(
            f"{path}: expected a store of tvsysid's layout {LAYOUT}, found {kept.get('layout', 'none')}; give another"
        )
    parts = {
        "study": "another study",
        "versions": "other versions of the software",
        "sources": "methods whose files were other ones (digests)",
    }
    for name, what in parts.items():
        try:
            found = json.loads(kept.get(name, ""))
        except (TypeError, json.JSONDecodeError):
            found = {}
        if found != json.loads(ours[name]):
            told = differences(found, json.loads(ours[name]))
            raise InputError(
                f"{path}: the store is of {what}: {told}; give another folder, or remove it to start afresh"
            )


def _create(path: Path, study: Study, of_machine: str) -> None:
    """Write a store without trials."""
    import zarr  # noqa: PLC0415  # heavy

    scenarios, methods = study.scenarios, list(study.named_methods)
    attributes = {
        "title": "Simulation study of methods that identify joint impedance over time",
        "layout": LAYOUT,
        "study": study.to_json(),
        "versions": json.dumps(versions()),
        "sources": json.dumps(study.sources),
        "machine": of_machine,
    }
    group: Any = zarr.create_group(path, zarr_format=3, attributes=attributes)

    def add(name: str, dims: tuple[str, ...], values: Any, **attributes: str) -> None:
        array = np.asarray(values)
        if array.dtype.kind == "U":
            array = array.astype(np.dtypes.StringDType())
        kind: Any = "string" if array.dtype.kind == "T" else array.dtype
        created = group.create_array(
            name, shape=array.shape, chunks=array.shape, dtype=kind, dimension_names=dims, compressors=None,
            attributes=attributes,
        )  # fmt: skip
        created[...] = array

    add("scenario", ("scenario",), [scenario.label for scenario in scenarios])
    add("profile", ("scenario",), [scenario.stiffness for scenario in scenarios])
    add("perturbation", ("scenario",), [scenario.perturbation for scenario in scenarios])
    add("duration_s", ("scenario",), [scenario.duration_s for scenario in scenarios], units="s")
    add("snr_db", ("scenario",), [scenario.snr_db for scenario in scenarios], units="dB")
    add("viscosity", ("scenario",), [scenario.viscosity for scenario in scenarios])
    add("trial", ("trial",), np.arange(study.trials))
    # Not "method", which xarray's sel() takes for a way to interpolate.
    add("method_key", ("method_key",), methods)
    times = np.arange(SAMPLES) / RATE
    add("time", ("time",), times, units="s", long_name=f"time within a realization of {PERIOD:g} s")
    add("statistic", ("statistic",), STATISTICS)
    add("stage", ("stage",), STAGES)
    add("variable", ("variable",), MEASURED)
    truth = [np.asarray(scenario.profile(times)) for scenario in scenarios]
    add("true_stiffness", ("scenario", "time"), truth, units="N m/rad", long_name="simulated stiffness")

    lengths = {
        "method_key": len(methods),
        "time": SAMPLES,
        "statistic": len(STATISTICS),
        "stage": len(STAGES),
        "variable": len(MEASURED),
    }
    kinds: dict[str, tuple[str, Any]] = {"checksums": ("<u8", 0)} | dict.fromkeys(STRINGS, ("string", ""))
    for name in (*MEASURED, "checksums"):
        kind, fill = kinds.get(name, ("<f8", np.nan))
        dims = DIMS.get(name, ("method_key",))
        shape = tuple(lengths[dim] for dim in dims)
        group.create_array(
            name,
            shape=(len(scenarios), study.trials, *shape),
            chunks=(1, 1, *shape),
            dtype=kind,
            fill_value=fill,
            dimension_names=("scenario", "trial", *dims),
            compressors=None,
            attributes={"long_name": MEANING[name]} | ({"units": UNITS[name]} if name in UNITS else {}),
        )
    group.update_attributes({"coordinates": "profile perturbation duration_s snr_db viscosity"})
    with warnings.catch_warnings():
        # That consolidated metadata is no part of Zarr's specification; xarray warns where there is none.
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(path, zarr_format=3)


def machine() -> str:
    """What a study runs on, for its report."""
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"


def _attributes(root: Path) -> dict[str, Any] | None:
    """Attributes in a group's metadata; None if it cannot be read."""
    try:
        found = json.loads(_content(root))
    except (UnicodeDecodeError, json.JSONDecodeError):
        return None
    attributes = found.get("attributes") if isinstance(found, dict) else None
    return attributes if isinstance(attributes, dict) else {}


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except FileNotFoundError:
        return b""


def _checksum(file: Path) -> int:
    return _sum(_content(file))


def _sum(content: bytes) -> int:
    return len(content) << 32 | zlib.crc32(content)


def _to_disk(path: Path) -> None:
    """See a file or folder through to the disk, for a store without metadata is none."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
