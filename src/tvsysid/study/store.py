"""Store of a study's results: xarray on Zarr, each task's chunks either whole or absent.

A task's chunks are written first and its ``checksums`` last: the length and CRC-32 of every chunk's
file, and of these checksums. A task is done if its files are as its checksums say. A file that is
missing, cut short or blank is what a kill or a loss of power leaves, and the task is done again. A
whole file with other content is damage, and is refused. Nothing is read that was not verified, and
nothing of a task that is not done.

A CRC begins with a key that follows from the study, the variable and the task: chunks that changed
places, or are another study's, are damage.

Chunks are not compressed: a file is the array's bytes, or the texts, each with its length before
it. They are written and read as such, which takes a tenth of the time that Zarr takes.
"""

from __future__ import annotations

import os
import shutil
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.study import files, fixed
from tvsysid.study.contents import CHECKSUMS, Layout
from tvsysid.study.task import Outcome

if TYPE_CHECKING:
    import xarray as xr

Place = tuple[int, int]  # numbers of a task along the two dimensions of its store
FAILURE = "failure"  # the variable that says why a method gave no result; every layout has it
IN_MEMORY = 1e9  # bytes of results up to which they are read at once
ABSENT = "absent"  # state of a task without checksums
# kinds of arrays of texts: strings, or objects as older versions of xarray and pandas have them
TEXT = "TO"


class Found(NamedTuple):
    """State of a task; if it is complete, its chunks' contents and checksums by variable."""

    state: str
    contents: Mapping[str, bytes] = {}
    sums: Mapping[str, int] = {}
    damaged: tuple[str, ...] = ()  # files


class Store:
    """An open store, from its verified fixed files.

    Made by :func:`open_store` or :func:`stored`.
    """

    def __init__(self, path: Path, contents: Mapping[str, bytes], machine: str) -> None:
        from tvsysid.study.verified import Verified  # noqa: PLC0415  # heavy

        self.path = path
        self._machine = machine
        self._key = zlib.crc32(contents[fixed.ROOT])  # which says what study it is of
        self._verified = Verified(contents, path, self._key)
        self._opened = self._verified.dataset()
        names = [str(name) for name in self._opened.variable.values]
        self._measured = names[:-1]
        self._arrays = {name: self._opened[name].variable for name in names}
        # Of each variable: its folder, and the rest of a chunk's path below the task's two numbers.
        self._parts = {
            name: (f"{name}/c", "/0" * (array.ndim - 2)) for name, array in self._arrays.items()
        }

    @property
    def places(self) -> list[Place]:
        """Of all tasks, done or not."""
        first, second = self._arrays[CHECKSUMS].shape[:2]
        return [(row, column) for row in range(first) for column in range(second)]

    def missing(self) -> list[Place]:
        """Return the places of tasks to do: missing, torn or failed."""
        return [
            place
            for place, found in self._tasks()
            if found.state != files.WHOLE or found.contents[FAILURE]
        ]

    def write(self, place: Place, outcome: Outcome) -> None:
        """Write what a task measured; it is there when this returns, and absent until then."""
        outcome = self._kept_where_failed(place, outcome)
        self._file(CHECKSUMS, place).unlink(missing_ok=True)
        sums = [self._write(name, place, outcome[name]) for name in self._measured]
        recorded = np.array(sums, dtype="<u8").tobytes()
        own = files.checksum(recorded, self._key_of(CHECKSUMS, place))
        files.write(self._file(CHECKSUMS, place), recorded + struct.pack("<Q", own))

    def forget_unless(self, name: str, expected: Callable[[Place], str]) -> list[Place]:
        """Delete tasks whose stored text differs from the expected one. Return their positions.

        The places forgotten.
        """
        forgotten = []
        for place, found in self._tasks():
            if found.state == files.WHOLE and self._values(
                name, found.contents[name]
            ).item() != expected(place):
                forgotten.append(place)
        for place in forgotten:
            self._file(CHECKSUMS, place).unlink()
        return forgotten

    def results(self) -> xr.Dataset:
        """Return the results. Large variables are read, and verified again, on use."""
        small = self._opened.nbytes <= IN_MEMORY
        names = list(self._arrays) if small else [CHECKSUMS]
        read = {name: self._nothing(name, self._arrays[name].shape) for name in names}
        torn = 0
        for place, found in self._tasks():
            torn += found.state == files.TORN
            for name, values in read.items():
                if content := found.contents.get(name):
                    values[place] = self._values(name, content)
            if not small:
                self._verified.sums |= {
                    self._chunk(name, place): each for name, each in found.sums.items()
                }
        if torn:
            raise InputError(
                f"{self.path}: {torn} results are cut short, as a loss of power leaves them; give "
                "the command that ran "
                "the study again, and they are made again"
            )
        results = self._opened.assign(
            {name: self._opened[name].copy(data=values) for name, values in read.items()}
        )
        results = _in_order(results.assign_attrs(machine=self._machine))
        return results.load() if small else results

    def keep(self, name: str, content: bytes) -> None:
        """Write a file of another kind, with a checksum at its end."""
        files.write(self.path / name, files.sealed(content, files.key_of(name, self._key)))

    def kept(self, name: str) -> bytes:
        """Return the content of a file. Raise InputError if it is not whole."""
        content = files.unsealed(files.content_of(self.path / name), files.key_of(name, self._key))
        if content is None:
            raise InputError(
                f"{self.path / name}: this file is missing, cut short or damaged; give the "
                "command that ran the study "
                "again, and it is made again"
            )
        return content

    def _tasks(self) -> Iterator[tuple[Place, Found]]:
        """Yield the state of each task.

        Raises an InputError at the end if files of full length hold something else.
        """
        damaged: list[str] = []
        for place in self.places:
            found = self._found(place)
            damaged += found.damaged
            yield place, found
        if damaged:
            raise files.damage(damaged)

    def _found(self, place: Place) -> Found:
        recorded, size = self._content(CHECKSUMS, place), 8 * len(self._measured)
        if len(recorded) < size + 8:
            return Found(files.TORN if recorded else ABSENT)
        body, own = (
            recorded[:size] + recorded[size + 8 :],
            int.from_bytes(recorded[size : size + 8], "little"),
        )
        state = files.state(body, own, self._key_of(CHECKSUMS, place))
        if state != files.WHOLE:
            return Found(state) if state == files.TORN else self._damage([CHECKSUMS], place)
        sums = dict(zip(self._measured, np.frombuffer(body, "<u8").tolist(), strict=True))
        contents = {name: self._content(name, place) for name in sums}
        states = {
            name: files.state(contents[name], sums[name], self._key_of(name, place))
            for name in sums
        }
        if damaged := [name for name, state in states.items() if state == files.DAMAGED]:
            return self._damage(damaged, place)
        if files.TORN in states.values():
            return Found(files.TORN)
        return Found(files.WHOLE, contents | {CHECKSUMS: recorded}, sums)

    def _damage(self, names: list[str], place: Place) -> Found:
        return Found(files.DAMAGED, damaged=tuple(str(self._file(name, place)) for name in names))

    def _kept_where_failed(self, place: Place, outcome: Outcome) -> Outcome:
        """Return a repeated task's outcome, with earlier results of methods that failed now."""
        there = self._found(place).contents
        if not there:
            return outcome
        before = {name: self._values(name, there[name]) for name in self._measured}
        again = np.asarray(outcome[FAILURE] != "") & np.asarray(before[FAILURE] == "")
        merged = {name: np.array(values) for name, values in outcome.items()}
        by_method = self._arrays[FAILURE].dims
        for name in self._measured:
            if self._arrays[name].dims[: len(by_method)] == by_method:
                merged[name][again] = before[name][again]
        return merged

    def _chunk(self, name: str, place: Place) -> str:
        """Return the path of a chunk in the store, as Zarr names it."""
        folder, below = self._parts[name]
        return f"{folder}/{place[0]}/{place[1]}{below}"

    def _file(self, name: str, place: Place) -> Path:
        return self.path / self._chunk(name, place)

    def _key_of(self, name: str, place: Place) -> int:
        return files.key_of(self._chunk(name, place), self._key)

    def _content(self, name: str, place: Place) -> bytes:
        return files.content_of(f"{self.path}{os.sep}{self._chunk(name, place)}")

    def _write(self, name: str, place: Place, values: NDArray[Any]) -> int:
        """Write a chunk, or none where there is nothing in it; its checksum."""
        file, array = self._file(name, place), self._arrays[name]
        if array.dtype.kind in TEXT:
            texts = [text.encode() for text in np.ravel(values).tolist()]
            packed = b"".join(struct.pack("<I", len(text)) + text for text in texts)
            content = struct.pack("<I", len(texts)) + packed if any(texts) else b""
        else:
            numbers = np.broadcast_to(np.asarray(values, dtype=array.dtype), array.shape[2:])
            content = b"" if np.isnan(numbers).all() else numbers.tobytes()
        if content:
            files.write(file, content)
        else:
            file.unlink(missing_ok=True)
        return files.checksum(content, self._key_of(name, place))

    def _nothing(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the fill value of a variable."""
        dtype = self._arrays[name].dtype
        if dtype.kind in TEXT:
            return np.full(shape, "", dtype=np.dtypes.StringDType())
        return np.full(shape, 0 if dtype.kind == "u" else np.nan, dtype=dtype)

    def _values(self, name: str, content: bytes) -> NDArray[Any]:
        """Return a task's part of a variable."""
        array = self._arrays[name]
        if not content:
            return self._nothing(name, array.shape[2:])
        values = (
            _texts(content) if array.dtype.kind in TEXT else np.frombuffer(content, array.dtype)
        )
        return np.reshape(values, array.shape[2:])


@contextmanager
def open_store(path: Path, layout: Layout) -> Iterator[Store]:
    """Open the store of a study, or make it, and keep other processes from writing to it meanwhile.

    Raises an InputError if the folder holds something else, the results of another study, of
    other versions of the software, or damaged ones; or if another process writes to it.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415  # with the store only

    path = path.resolve()  # one lock, by whatever name it is opened
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.parent / f".{path.name}.new"
    contents = fixed.contents_of(layout)
    try:
        with FileLock(path.parent / f".{path.name}.lock", timeout=0):
            shutil.rmtree(fresh, ignore_errors=True)  # of a process that was killed
            if path.exists():
                fixed.mend(path, contents, layout)
            else:
                try:
                    fixed.make(path, contents, fresh)
                finally:
                    shutil.rmtree(fresh, ignore_errors=True)
            yield stored(path)
    except Timeout as error:
        raise InputError(
            f"{path}: another process is writing to this store; wait for it, or give another"
        ) from error


def stored(path: Path) -> Store:
    """Open the store in a folder for reading, finished or not.

    Raises an InputError if the folder is no such store, or its files are cut short or damaged.
    """
    if not path.is_dir():
        raise InputError(
            f"{path}: there is no such folder; expected a store of results written by tvsysid"
        )
    return Store(path, *fixed.verified(path))


def _in_order(results: xr.Dataset) -> xr.Dataset:
    """Return variables in the order of the layout, and names as plain text."""
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


def _texts(content: bytes) -> NDArray[Any]:
    """Return the texts of a chunk: their number, and each with its length before it."""
    texts, place = [], 4
    while place < len(content):
        first = place + 4
        place = first + int.from_bytes(content[place:first], "little")
        texts.append(content[first:place].decode())
    return np.array(texts, dtype=np.dtypes.StringDType())
