"""A store as Zarr and xarray read it: nothing that was not verified.

Imported when it is used, for both are heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray as xr
from zarr.buffer import cpu
from zarr.storage import MemoryStore

from tvsysid.study import files


class Verified(MemoryStore):
    """Fixed files from the memory.

    Tasks' chunks, once their ``sums`` are known, from the disk when they are used.
    """

    def __init__(self, contents: Mapping[str, bytes], path: Path, key: int) -> None:
        super().__init__(
            {name: cpu.Buffer.from_bytes(content) for name, content in contents.items()},
            read_only=True,
        )
        self.sums: dict[str, int] = {}
        self._path, self._key = path, key

    async def get(self, key: str, prototype: Any = None, byte_range: Any = None) -> Any:
        """Content of a file, by its path in the store; None if there is none."""
        if not self.sums.get(key):
            return await super().get(key, prototype, byte_range)
        content = files.content_of(self._path / key)
        if files.checksum(content, files.key_of(key, self._key)) != self.sums[key]:
            raise files.damage([str(self._path / key)])
        return cpu.Buffer.from_bytes(content)

    def dataset(self) -> xr.Dataset:
        """Return the decoded dataset of xarray."""
        # Chunks of the size of a task, read as they are needed: no need for Dask.
        results: xr.Dataset = xr.open_zarr(self, chunks=None)
        return results
