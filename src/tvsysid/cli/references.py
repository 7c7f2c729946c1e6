"""Channels of a file that move the joint as a reference does, and that nobody named."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.errors import InputError

if TYPE_CHECKING:
    from tvsysid.comparison import Comparison
    from tvsysid.signals import Recording

MOST = 8  # channels that are looked at


def unnamed_references(
    found: Comparison,
    file: Path,
    header: bool,
    known: Iterable[str],
    read: Callable[[list[str]], Recording],
) -> Iterator[str]:
    """Yield a sentence for each channel that is not ``known`` and moves the joint as a reference does.

    None is looked for where a method was given one. The file is read anew with each of them, by
    ``read`` of a list of NAME=CHANNEL.
    """
    from tvsysid import preprocess
    from tvsysid.recommendation import find_unnamed_references
    from tvsysid.recordings import describe_file

    kinds = {item.kind for method in found.methods.values() for item in method.inputs}
    if kinds & {"reference", "scheduling"}:  # the one is named, the other may need no period
        return
    channels, known, ensemble = describe_file(file, header), set(known), found.ensemble
    shapes = {channels[name].shape for name in known if name in channels}
    others = [name for name in channels if name not in known and channels[name].shape in shapes]
    for name in others[:MOST]:
        with suppress(InputError), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is doubtful in a channel that is not used
            cut = preprocess.segment(
                read([f"{name}={name}"]),
                ensemble.duration,
                ensemble.context / ensemble.sampling_rate,
            )
            alone = preprocess.subtract_mean(cut, [name])
            for sentence in find_unnamed_references(alone, [name]):
                yield sentence.replace("--method", f"--channel {name}={name} --method")
