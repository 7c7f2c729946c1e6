"""Find channels that drive the angle but were not declared as a reference."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from tvsysid.errors import InputError

if TYPE_CHECKING:
    from tvsysid.comparison import Comparison
    from tvsysid.recordings.reading import Reading
    from tvsysid.signals import Recording

MAX_CHANNELS = 8  # channels that are tested


def unnamed_references(
    found: Comparison, recording: Recording, file: Path, reading: Reading
) -> Iterator[str]:
    """Yield a sentence for each channel of a file that was not read and drives the angle.

    Nothing is tested where a method has a reference or a scheduling variable.
    """
    from tvsysid import preprocess
    from tvsysid.recommendation import find_unnamed_references
    from tvsysid.recordings import describe_file

    kinds = {item.kind for method in found.methods.values() for item in method.inputs}
    if kinds & {"reference", "scheduling"}:
        return
    channels, ensemble = describe_file(file, reading.header), found.ensemble
    context = ensemble.context / ensemble.sampling_rate
    shapes = {channels[name].shape for name in reading.names}
    others = [
        name
        for name, channel in channels.items()
        if name not in reading.names and channel.shape in shapes
    ]
    for name in others[:MAX_CHANNELS]:
        with suppress(InputError):  # it holds no numbers
            values = channels[name].read(name).ravel(order="F")
            with_channel = attrs.evolve(recording, channels={name: values})
            cut = preprocess.segment(with_channel, ensemble.duration, context)
            for sentence in find_unnamed_references(preprocess.subtract_mean(cut, [name]), [name]):
                yield sentence.replace("--method", f"--channel {name}={name} --method")
