"""Contents of a store that are known before any task: metadata, names, axes, the truth.

They follow from the study alone. So a store is known to be that of a study by holding what a new
one would hold, and what was cut short can be written again. A manifest has the checksums of
these files, for those who read a store and have no study to compare it with.
"""

from __future__ import annotations

import json
import os
import platform
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tvsysid.errors import InputError
from tvsysid.study import files
from tvsysid.study.contents import CHECKSUMS, NUMBERS, RECORDINGS, Fixed, Layout, Variable
from tvsysid.study.settings import differences

ROOT, MANIFEST = "zarr.json", "manifest"


class Manifest(NamedTuple):
    """Checksums of the fixed files of a store, and the machine that made it."""

    machine: str
    sums: Mapping[str, int]


def contents_of(layout: Layout) -> dict[str, bytes]:
    """Return the files of a store without results, by their paths."""
    import zarr  # noqa: PLC0415  # heavy
    from zarr.storage import MemoryStore  # noqa: PLC0415

    written: dict[str, Any] = {}
    memory = MemoryStore(written)
    attributes: dict[str, object] = {"title": layout.title, "layout": layout.number}
    attributes |= {name: json.dumps(ours) for name, (ours, _) in layout.identity.items()}
    group: Any = zarr.create_group(memory, zarr_format=3, attributes=attributes)
    for item in (*layout.fixed, Fixed("variable", ("variable",), [*layout.measured, CHECKSUMS])):
        array = np.asarray(item.values)
        if array.dtype.kind == "U":
            array = array.astype(np.dtypes.StringDType())
        kind = "string" if array.dtype.kind == "T" else array.dtype
        created = group.create_array(
            item.name, shape=array.shape, chunks=array.shape, dtype=kind,
            dimension_names=item.dims, compressors=None,
            attributes=dict(item.attributes), config={"write_empty_chunks": True},
        )  # fmt: skip
        created[...] = array
    meaning = (
        "length times 2**32 plus CRC-32 of each chunk's file, 0 where there is none; the "
        "last is that of the rest"
    )
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
            attributes={"long_name": variable.meaning}
            | ({"units": variable.unit} if variable.unit else {}),
        )
    group.update_attributes({"coordinates": " ".join(layout.coordinates)})
    with warnings.catch_warnings():
        # That consolidated metadata is no part of Zarr's specification; xarray warns where there is
        # none.
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(memory, zarr_format=3)
    return {name: buffer.to_bytes() for name, buffer in written.items()}


def make(path: Path, contents: Mapping[str, bytes], fresh: Path) -> None:
    """Make a store without results, by way of a fresh folder.

    It is there as a whole or not at all.
    """
    for name, content in contents.items():
        files.write(fresh / name, content)
    files.write(fresh / MANIFEST, _manifest_of(contents))
    for item in (fresh, *fresh.rglob("*")):
        files.to_disk(item)
    fresh.rename(path)


def mend(path: Path, contents: Mapping[str, bytes], layout: Layout) -> None:
    """Check that a store is the study's, and write torn files again.

    Raise if it is another's, or damaged.
    """
    if not path.is_dir() or _is_other(path, contents):
        raise InputError(
            f"{path}: something else is in the way; expected a store of results, or nothing"
        )
    manifest, root = _manifest(path), files.content_of(path / ROOT)
    kept, sums = _attributes(root), _sums(contents)
    if kept is not None and (manifest is None or files.checksum(root) == manifest.sums.get(ROOT)):
        _compare(path, kept, layout, manifest)
    if manifest is not None and (others := differences(manifest.sums, sums)):
        raise InputError(
            f"{path}: the store is of another study: {others}; give another folder (--out)"
        )
    for name in files.torn(_read(path, sums), sums, path):
        files.write(path / name, contents[name])
    if manifest is None:
        files.write(path / MANIFEST, _manifest_of(contents))
    for leftover in path.rglob(f"*{files.PARTIAL}"):
        leftover.unlink(missing_ok=True)


def verified(path: Path) -> tuple[dict[str, bytes], str]:
    """Return the fixed files of a store, and the machine that made it.

    Raise if they are not whole.
    """
    manifest = _manifest(path)
    if manifest is None:
        raise _without_manifest(path)
    contents = _read(path, manifest.sums)
    if torn := files.torn(contents, manifest.sums, path):
        raise _incomplete(path, torn)
    _check_kind(path, _attributes(contents[ROOT]) or {}, NUMBERS, manifest)
    return contents, manifest.machine


def _read(path: Path, names: Iterable[str]) -> dict[str, bytes]:
    return {name: files.content_of(path / name) for name in names}


def _incomplete(path: Path, names: Sequence[str]) -> InputError:
    return InputError(
        f"{path}: the store is incomplete: missing or cut short, as a loss of power leaves them: "
        f"{', '.join(names)}; "
        "give the command that ran the study again, and they are made again"
    )


def _without_manifest(path: Path) -> InputError:
    """Return the error for a folder that is no store, of another version, or incomplete."""
    kept = _attributes(files.content_of(path / ROOT))
    if kept is None:
        return InputError(
            f"{path}: this is no store of results, or one whose files {ROOT} and {MANIFEST} are "
            "missing or cut short; "
            "give the command that ran the study again, and they are made again, or give another "
            "folder"
        )
    _check_kind(path, kept, NUMBERS, None)
    return _incomplete(path, [MANIFEST])


def _check_kind(
    path: Path, attributes: Mapping[str, Any], numbers: Mapping[str, int], manifest: Manifest | None
) -> None:
    title, number = attributes.get("title", "something else"), attributes.get("layout", "none")
    if numbers.get(title) != number:
        possible = {title: numbers[title]} if title in numbers else numbers
        expected = " or ".join(
            f"{known!r} in tvsysid's layout {layout}" for known, layout in possible.items()
        )
        raise InputError(
            f"{path}: expected {expected}, found {title!r}, layout {number}; "
            f"{_other(path, manifest)}"
        )


def _compare(
    path: Path, kept: Mapping[str, Any], layout: Layout, manifest: Manifest | None
) -> None:
    """Raise if a store says that it is another's."""
    _check_kind(path, kept, {layout.title: layout.number}, manifest)
    for name, (ours, what) in layout.identity.items():
        try:
            theirs = json.loads(kept.get(name, ""))
        except (TypeError, json.JSONDecodeError):
            theirs = {}
        here = json.loads(json.dumps(ours))
        if theirs != here:
            raise InputError(
                f"{path}: the store is of {what}: {differences(theirs, here)}; "
                f"{_other(path, manifest)} (--out)"
            )


def _other(path: Path, manifest: Manifest | None) -> str:
    """Return the remedy for a store of another study, or with a damaged file and no manifest."""
    unsure = (
        ""
        if manifest
        else f"if {path / ROOT} is damaged, remove that file and run the study again; else "
    )
    return f"{unsure}give another folder"


def _is_other(path: Path, contents: Mapping[str, bytes]) -> bool:
    """Whether a folder is no store, not even one that lost files."""
    if (path / ROOT).exists() or (path / MANIFEST).exists():
        return False
    known = {Path(name).parts[0] for name in (*contents, RECORDINGS)}
    return not known.issuperset(item.name.removesuffix(files.PARTIAL) for item in path.iterdir())


def _attributes(root: bytes) -> dict[str, Any] | None:
    """Return the attributes in a group's metadata; None if unreadable."""
    try:
        found = json.loads(root)
    except (UnicodeDecodeError, json.JSONDecodeError):
        return None
    attributes = found.get("attributes") if isinstance(found, dict) else None
    return attributes if isinstance(attributes, dict) else {}


def _manifest(path: Path) -> Manifest | None:
    """Return the manifest of a store; None if it is missing or not whole."""
    content = files.unsealed(files.content_of(path / MANIFEST))
    return None if content is None else Manifest(**json.loads(content))


def _manifest_of(contents: Mapping[str, bytes]) -> bytes:
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return files.sealed(json.dumps(Manifest(machine, _sums(contents))._asdict(), indent=1).encode())


def _sums(contents: Mapping[str, bytes]) -> dict[str, int]:
    return {name: files.checksum(content) for name, content in contents.items()}
