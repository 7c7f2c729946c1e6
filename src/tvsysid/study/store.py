"""Where a study's results are kept: xarray on Zarr, a chunk of each variable for each task, whole or absent.

A task's chunks are written first and its ``checksums`` last: the length and CRC-32 of every chunk's file. A task is
done if its files are as its checksums say. A file that is missing or cut short is what a kill or a loss of power
leaves, and the task is done again. A whole file with other content is damage, and is refused.

Chunks are not compressed: a file is the array's bytes, or the texts, each with its length before it. They are written
and read as such, which takes a tenth of the time that Zarr takes.

The metadata depends on the study alone. So a store is known to be that of a study by holding what a new one would
hold, and metadata that was cut short can be written again.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.study.contents import NUMBERS, Fixed, Layout, Variable
from tvsysid.study.task import Outcome, differences

if TYPE_CHECKING:
    import xarray as xr

Place = tuple[int, int]  # numbers of a task along the two dimensions of its store
FAILURE = "failure"  # the variable that says why a method gave no result; every layout has it
CHECKSUMS = "checksums"
IN_MEMORY = 1e9  # bytes of results up to which they are read at once
WHOLE, TORN, ABSENT = "whole", "torn", "absent"


class Store:
    """An open store; made by :func:`open_store`."""

    def __init__(self, path: Path, group: Any) -> None:
        self.path = path
        self._measured = [str(name) for name in group["variable"][...]]
        self._arrays: dict[str, Any] = {name: group[name] for name in (*self._measured, CHECKSUMS)}
        # Of each variable: its folder, and the rest of a chunk's path below the task's two numbers.
        self._parts = {
            name: (f"{path / name}/c", os.sep.join(["0"] * (array.ndim - 2))) for name, array in self._arrays.items()
        }

    @property
    def places(self) -> list[Place]:
        """Of all tasks, done or not."""
        first, second = self._arrays[CHECKSUMS].shape[:2]
        return [(row, column) for row in range(first) for column in range(second)]

    def missing(self) -> list[Place]:
        """Places whose tasks are to be done: those not there, cut short or with a failure."""
        return [place for place in self.places if self._state(place) != WHOLE or self._content(FAILURE, place)]

    def torn(self) -> int:
        """Number of tasks whose files are missing in part or cut short."""
        return sum(self._is_torn(place) for place in self.places)

    def write(self, place: Place, outcome: Outcome) -> None:
        """Write what a task measured; it is there when this returns, and absent until then."""
        if self._content(CHECKSUMS, place):
            outcome = self._kept_where_failed(place, outcome)
        Path(self._file(CHECKSUMS, place)).unlink(missing_ok=True)
        sums = [self._write(name, place, outcome[name]) for name in self._measured]
        self._write(CHECKSUMS, place, np.array(sums, dtype=np.uint64))

    def forget_unless(self, name: str, expected: Callable[[Place], str]) -> list[Place]:
        """Forget what tasks measured where a text among it is not the expected one; the places forgotten."""
        forgotten = []
        for place in self.places:
            if self._state(place) == WHOLE and str(self._arrays[name][place]) != expected(place):
                os.unlink(self._file(CHECKSUMS, place))
                forgotten.append(place)
        return forgotten

    def results(self) -> xr.Dataset:
        """What is there; too much for the memory is left to Zarr, which reads it when it is used."""
        results = _opened(self.path)
        if results.nbytes <= IN_MEMORY:
            results = results.assign({name: results[name].copy(data=self._read(name)) for name in self._arrays})
        return _in_order(results)

    def _state(self, place: Place) -> str:
        """Whether a task's files are as its checksums say, missing or cut short, or it has no checksums.

        Raises an InputError if a file is of full length but holds something else.
        """
        recorded = self._content(CHECKSUMS, place)
        if len(recorded) != 8 * len(self._measured):
            return TORN if recorded else ABSENT
        state = WHOLE
        for name, expected in zip(self._measured, np.frombuffer(recorded, dtype="<u8").tolist(), strict=True):
            content = self._content(name, place)
            if len(content) < expected >> 32:
                state = TORN
            elif _sum(content) != expected:
                raise InputError(
                    f"{self._file(name, place)}: this file does not hold what was written there; to have it made "
                    "again, remove the file; to start afresh, remove the store"
                )
        return state

    def _is_torn(self, place: Place) -> bool:
        state = self._state(place)
        if state != ABSENT:
            return state == TORN
        # Never finished; what there is of it must be readable all the same.
        numbers = {name: array for name, array in self._arrays.items() if array.dtype.kind == "f"}
        sizes = {name: 8 * int(np.prod(array.chunks)) for name, array in numbers.items()}
        return any(len(self._content(name, place)) not in (0, size) for name, size in sizes.items())

    def _kept_where_failed(self, place: Place, outcome: Outcome) -> Outcome:
        """Outcome of a task that is done again, with what is there already of methods that failed this time only."""
        if self._state(place) != WHOLE:
            return outcome
        failed, before = (np.asarray(values != "") for values in (outcome[FAILURE], self._arrays[FAILURE][place]))
        merged = {name: np.array(values) for name, values in outcome.items()}
        by_method = self._dims(FAILURE)
        for name in self._measured:
            if self._dims(name)[: len(by_method)] == by_method:
                merged[name][failed & ~before] = self._arrays[name][place][failed & ~before]
        return merged

    def _dims(self, name: str) -> tuple[str, ...]:
        return tuple(self._arrays[name].metadata.dimension_names)

    def _file(self, name: str, place: Place) -> str:
        """Of a chunk, as Zarr calls it."""
        folder, below = self._parts[name]
        return os.path.join(folder, str(place[0]), str(place[1]), below).rstrip(os.sep)

    def _content(self, name: str, place: Place) -> bytes:
        return _content(self._file(name, place))

    def _write(self, name: str, place: Place, values: NDArray[Any]) -> int:
        """Write a chunk, or none where there is nothing in it; its checksum."""
        file, array = self._file(name, place), self._arrays[name]
        if array.dtype.kind == "T":
            texts = [text.encode() for text in np.ravel(values).tolist()]
            packed = b"".join(struct.pack("<I", len(text)) + text for text in texts)
            content = struct.pack("<I", len(texts)) + packed if any(texts) else b""
        else:
            numbers = np.broadcast_to(np.asarray(values, dtype=array.dtype), array.chunks[2:])
            content = b"" if np.isnan(numbers).all() else numbers.tobytes()
        if not content:
            Path(file).unlink(missing_ok=True)
            return 0
        os.makedirs(os.path.dirname(file), exist_ok=True)
        with open(f"{file}.partial", "wb") as chunk:
            chunk.write(content)
        os.replace(f"{file}.partial", file)
        return _sum(content)

    def _read(self, name: str) -> NDArray[Any]:
        """A whole variable."""
        array = self._arrays[name]
        found = np.full(array.shape, array.fill_value, dtype=array.dtype)
        for place in self.places:
            if content := self._content(name, place):
                values = _texts(content) if array.dtype.kind == "T" else np.frombuffer(content, array.dtype)
                found[place] = np.reshape(values, array.shape[2:])
        return found


@contextmanager
def open_store(path: Path, layout: Layout) -> Iterator[Store]:
    """Open the store of a study, or make it, and keep other processes from writing to it meanwhile.

    Raises an InputError if the folder holds something else, the results of another study, of other versions of the
    software, or damaged ones; or if another process writes to it.
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
                _prepare(path, layout, fresh)
            finally:
                shutil.rmtree(fresh, ignore_errors=True)
            yield Store(path, zarr.open_group(path, mode="r+", zarr_format=3, use_consolidated=False))
    except Timeout as error:
        raise InputError(f"{path}: another process is writing to this store; wait for it, or give another") from error


def read_store(path: str | Path) -> xr.Dataset:
    """Results of a study from its store, finished or not.

    Raises an InputError if the folder is no such store, or files of it are cut short or damaged.
    """
    import zarr  # noqa: PLC0415  # heavy

    if not Path(path).is_dir():
        raise InputError(f"{path}: there is no such folder; expected a store of results written by tvsysid")
    try:
        attributes = _opened(path).attrs
    except Exception as error:
        raise InputError(f"{path}: this is no store of results: {error}") from error
    _check_kind(path, attributes, NUMBERS)
    group: Any = zarr.open_group(path, mode="r", zarr_format=3, use_consolidated=False)
    store = Store(Path(path), group)
    if torn := store.torn():
        raise InputError(
            f"{path}: {torn} results are cut short, as a loss of power leaves them; give the command that ran the "
            "study again, and they are made again"
        )
    return store.results()


def _check_kind(path: str | Path, attributes: Mapping[str, Any], numbers: Mapping[str, int]) -> None:
    title, number = attributes.get("title", "something else"), attributes.get("layout", "none")
    if numbers.get(title) != number:
        possible = {title: numbers[title]} if title in numbers else numbers
        expected = " or ".join(f"{known!r} in tvsysid's layout {layout}" for known, layout in possible.items())
        raise InputError(f"{path}: expected {expected}, found {title!r}, layout {number}; give another folder")


def _opened(path: str | Path) -> xr.Dataset:
    import xarray as xr  # noqa: PLC0415  # heavy

    # Chunks of the size of a task, read as they are needed: no need for Dask.
    results: xr.Dataset = xr.open_zarr(path, chunks=None)
    return results


def _in_order(results: xr.Dataset) -> xr.Dataset:
    """Variables in the order of the layout, and names as plain text."""
    texts = {
        name: (values.dims, values.values.astype(object).astype(str))
        for name, values in results.coords.items()
        if values.dtype.kind == "T"
    }
    labelled = results.assign_coords(texts)
    names = dict.fromkeys([*labelled.variable.values, *results.data_vars])
    names.pop(CHECKSUMS)
    chosen: xr.Dataset = labelled[[*names, CHECKSUMS]]
    return chosen


def _prepare(path: Path, layout: Layout, fresh: Path) -> None:
    """Make the store, or see that it is the study's and whole in its metadata."""
    root = path / "zarr.json"
    if path.exists() and not root.is_file():
        raise InputError(f"{path}: something else is in the way; expected a store of results, or nothing")
    kept = _attributes(root)
    here = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    _create(fresh, layout, (kept or {}).get("machine") or here)
    if not path.exists():
        for file in fresh.rglob("*"):
            _to_disk(file)
        fresh.rename(path)
        return
    if kept is not None:  # else it was cut short, or is damaged; the comparison of the files tells
        _compare(path, kept, layout)
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


def _compare(path: Path, kept: dict[str, Any], layout: Layout) -> None:
    """Raise if the store says that it is another's."""
    _check_kind(path, kept, {layout.title: layout.number})
    for name, (ours, what) in layout.identity.items():
        try:
            theirs = json.loads(kept.get(name, ""))
        except (TypeError, json.JSONDecodeError):
            theirs = {}
        here = json.loads(json.dumps(ours))
        if theirs != here:
            raise InputError(
                f"{path}: the store is of {what}: {differences(theirs, here)}; "
                "give another folder (--out), or remove this one to start afresh"
            )


def _create(path: Path, layout: Layout, of_machine: str) -> None:
    """Write a store without results."""
    import zarr  # noqa: PLC0415  # heavy

    attributes: dict[str, Any] = {"title": layout.title, "layout": layout.number}
    attributes |= {name: json.dumps(ours) for name, (ours, _) in layout.identity.items()}
    group: Any = zarr.create_group(path, zarr_format=3, attributes=attributes | {"machine": of_machine})
    for item in (*layout.fixed, Fixed("variable", ("variable",), list(layout.measured))):
        array = np.asarray(item.values)
        if array.dtype.kind == "U":
            array = array.astype(np.dtypes.StringDType())
        kind: Any = "string" if array.dtype.kind == "T" else array.dtype
        created = group.create_array(
            item.name, shape=array.shape, chunks=array.shape, dtype=kind, dimension_names=item.dims, compressors=None,
            attributes=dict(item.attributes),
        )  # fmt: skip
        created[...] = array
    meaning = "length times 2**32 plus CRC-32 of each chunk's file; 0 where there is none"
    for name, variable in {**layout.measured, CHECKSUMS: Variable(("variable",), meaning)}.items():
        kinds: dict[bool, tuple[str, object]] = {True: ("string", ""), False: ("<f8", np.nan)}
        kind, fill = ("<u8", 0) if name == CHECKSUMS else kinds[variable.is_text]
        shape = layout.shape(variable.dims)
        group.create_array(
            name,
            shape=(*layout.shape(layout.places), *shape),
            chunks=(1, 1, *shape),
            dtype=kind,
            fill_value=fill,
            dimension_names=(*layout.places, *variable.dims),
            compressors=None,
            attributes={"long_name": variable.meaning} | ({"units": variable.unit} if variable.unit else {}),
        )
    group.update_attributes({"coordinates": " ".join(layout.coordinates)})
    with warnings.catch_warnings():
        # That consolidated metadata is no part of Zarr's specification; xarray warns where there is none.
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(path, zarr_format=3)


def _attributes(root: Path) -> dict[str, Any] | None:
    """Attributes in a group's metadata; None if it cannot be read."""
    try:
        found = json.loads(_content(root))
    except (UnicodeDecodeError, json.JSONDecodeError):
        return None
    attributes = found.get("attributes") if isinstance(found, dict) else None
    return attributes if isinstance(attributes, dict) else {}


def _texts(content: bytes) -> NDArray[Any]:
    """Texts of a chunk: their number, and each with its length before it."""
    texts, place = [], 4
    while place < len(content):
        first = place + 4
        place = first + int.from_bytes(content[place:first], "little")
        texts.append(content[first:place].decode())
    return np.array(texts, dtype=np.dtypes.StringDType())


def _content(file: str | Path) -> bytes:
    try:
        with open(file, "rb") as opened:
            return opened.read()
    except FileNotFoundError:
        return b""


def _sum(content: bytes) -> int:
    return len(content) << 32 | zlib.crc32(content)


def _to_disk(path: Path) -> None:
    """See a file or folder through to the disk, for a store without metadata is none."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
