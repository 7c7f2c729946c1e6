"""The process in which files are read: requests come in, one a line, and arrays go out (see :mod:`.process`)."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel
from tvsysid.recordings.formats import channels_of, contents_of, explained
from tvsysid.recordings.limits import claim, limited

Answer = tuple[dict[str, Any], dict[str, NDArray[Any]]]  # what JSON can say, and arrays by name


class Server:
    """Answers requests; remembers of the last file where its channels are, and no values."""

    def __init__(self) -> None:
        self.last: tuple[Path, Mapping[str, Channel]] = Path(), {}

    def describe(self, file: Path, header: bool = True) -> Answer:
        """Channels of a file, with the values of those that are read already."""
        channels = channels_of(file, header)
        self.last = file, {name: item for name, item in channels.items() if not item.held}
        told = {
            name: (
                item.shape,
                item.dtype,
                item.unit,
                item.sampling_rate,
                item.trial_starts,
                item.values is not None,
            )
            for name, item in channels.items()
        }
        held = {
            name: item.values()
            for name, item in channels.items()
            if item.held and item.values is not None
        }
        return {"channels": told}, held

    def values(self, file: Path, name: str) -> Answer:
        """Values of one channel."""
        if self.last[0] != file or name not in self.last[1]:
            self.describe(file)
        channel = self.last[1].get(name)
        if channel is None or channel.values is None:
            raise InputError(f"{file}: {name} has changed while it was read; read it again")
        claim(f"{file}: {name}", channel.size, 3 * channel.size)
        return {}, {name: channel.values()}

    def contents(self, file: Path) -> Answer:
        """Everything in a file that tvsysid wrote."""
        found = contents_of(file)
        texts = {name: item for name, item in found.items() if isinstance(item, str)}
        return {"texts": texts}, {
            name: np.asarray(item) for name, item in found.items() if name not in texts
        }

    def answer(self, line: bytes) -> Answer:
        """What a request asks for, or why it cannot be had."""
        action, folder, path, *more = json.loads(line)
        with suppress(OSError):
            os.chdir(folder)
        file = Path(path)
        try:
            with explained(file), limited(file.stat().st_size if file.is_file() else 0):
                return getattr(self, action)(file, *more)  # type: ignore[no-any-return]
        except InputError as error:
            return {"error": str(error)}, {}


def send(stream: BinaryIO, told: dict[str, object], arrays: dict[str, NDArray[Any]]) -> None:
    """A line that says what follows, and the bytes of each array, in the order in which they lie in memory."""
    layout = [
        (name, item.dtype.str, item.shape, _by_columns(item)) for name, item in arrays.items()
    ]
    stream.write(json.dumps({**told, "arrays": layout}).encode() + b"\n")
    for name in list(arrays):
        item = arrays.pop(name)  # which makes room
        rows = np.ascontiguousarray(item.T if _by_columns(item) else item)
        if rows.size:
            stream.write(rows.reshape(-1).view(np.uint8).data)
    stream.flush()


def _by_columns(item: NDArray[Any]) -> bool:
    return bool(item.flags.f_contiguous and not item.flags.c_contiguous)


def serve() -> None:
    """Answer until the one who asks closes the pipe."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not come between
    warnings.simplefilter("ignore")
    server = Server()
    for line in sys.stdin.buffer:
        send(answers, *server.answer(line))
