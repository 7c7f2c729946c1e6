"""Damaged files of every format. A mutant follows from the seed, its number and the sound files."""

import contextlib
import multiprocessing
import os
import resource
import struct
import traceback
import warnings
import zlib
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import numpy as np
from tests.recordings import files

from tvsysid import Ensemble, InputError, Recording
from tvsysid.recordings import (
    describe_file,
    load_ensemble,
    load_recording,
    worker,
    write_ensemble,
    write_recording,
)

EXTREMES = (0, 1, 8, *(2**bits - sign for bits in (7, 8, 15, 16, 31, 32, 63) for sign in (0, 1)))
MAX_BYTES = 8 * 2**30  # of addresses, for each process
MAX_SECONDS = 90  # on a machine that has other work
LOADERS = {"recording": load_recording, "ensemble": load_ensemble}  # of files with such a name


def write_object(file, angle, torque, age):
    files.write_object(file, files.nldat([angle, torque]), age)


def write_own(file, angle, torque):
    """As tvsysid writes them; they are also loaded."""
    if file.stem == "recording":
        settings = {"channels": {"emg": angle}, "trial_starts": (0, 30)}
        write_recording(file, Recording(angle, torque, 200.0, **settings))
    else:
        write_ensemble(file, Ensemble(angle.reshape(6, 10), torque.reshape(6, 10), 200.0))


def write_segdat(file, angle, torque):
    files.write_segdat(file, [angle, torque], "struct", [1, 31], [20, 30])


OWN = ("recording.nc", "ensemble.nc")
SEEDS = {
    "version7.mat": partial(files.write_mat, do_compression=True),
    "old-object.mat": partial(write_object, age="old"),
    "object.mat": partial(write_object, age="v7"),
    "object73.mat": partial(write_object, age="v7.3"),
    "gait.c3d": files.write_gait,
    "segments.mat": write_segdat,
}
SEEDS |= files.WRITERS | dict.fromkeys(OWN, write_own)
DESCRIPTIONS = ("sub-1_channels.tsv", "sub-1_motion.json")  # of sub-1_motion.tsv
COMPRESSED = ("version7.mat", "object.mat")


def damaged(random, content):
    """One to three blocks, mostly short, flipped, blanked, cut, repeated, extreme or the last."""
    for _ in range(random.choice([1, 2, 3], p=[0.6, 0.3, 0.1])):
        width = int(random.choice([1, 2, 4, 8, 512]))
        place = int(random.integers(max(len(content) - width, 1)))
        place -= place % width if width < 9 and random.random() < 0.8 else 0  # mostly aligned
        block, extreme = content[place : place + width], EXTREMES[random.integers(len(EXTREMES))]
        number = (extreme % 256**width).to_bytes(width, str(random.choice(["little", "big"])))
        flipped = bytes(each ^ (1 << int(random.integers(8))) for each in block)
        kinds = [flipped, bytes(width), b"\xff" * width, b"", block * 20, number, number, number]
        end = len(content) if random.random() < 0.1 else place + width
        content = content[:place] + kinds[random.integers(len(kinds))] + content[end:] or content
    return content


def inside_mat(random, content):
    """Damage one variable of a MAT file before it is compressed: so the parser sees it."""
    elements, place = [], 128
    while place + 8 <= len(content):
        _, size = struct.unpack_from("<II", content, place)
        elements.append(content[place : place + 8 + size])
        place += 8 + size
    chosen = random.choice([number for number, each in enumerate(elements) if each[0] == 15])
    data = zlib.compress(damaged(random, zlib.decompress(elements[chosen][8:])))
    elements[chosen] = struct.pack("<II", 15, len(data)) + data
    return content[:128] + b"".join(elements)


def sound_files(folder):
    """A small file of each format, by name; a MAT file's header tells no time."""
    random = np.random.default_rng(1)
    signals = random.normal(scale=0.1, size=60), random.normal(size=60)
    for name, write in SEEDS.items():
        write(folder / name, *signals)
        content = (folder / name).read_bytes()
        if content[:6] == b"MATLAB":
            (folder / name).write_bytes(content[:20].ljust(116) + content[116:])
    for name in DESCRIPTIONS:
        (folder / f"mutant-{name}").write_bytes((folder / name).read_bytes())
    return {name: (folder / name).read_bytes() for name in SEEDS}


def mutant(sound, seed, number):
    """Name of the sound file, and the content of what became of it."""
    random = np.random.default_rng([seed, number])
    name = list(sound)[number % len(sound)]
    inside = name in COMPRESSED and random.random() < 0.7
    change = inside_mat if inside else damaged
    return name, change(random, sound[name])


def read(file):
    """Return the number of channels that could be read, and what went wrong."""
    wrong, count = [], 0

    @contextlib.contextmanager
    def judged():
        try:
            yield
        except InputError as error:
            if file.name not in str(error):
                wrong.append(f"the message does not name the file: {error!r}")
        except BaseException as error:
            wrong.append(f"{error!r} at {traceback.extract_tb(error.__traceback__)[-1]}")

    channels = {}
    with judged():
        channels = describe_file(file)
    for name, channel in channels.items():
        with judged():
            channel.described.encode("utf-8")
            channel.read(f"{file.name}: {name}")
            count += 1
    for kind, load in LOADERS.items():
        if kind in file.name:
            with judged():
                load(file)
    if printed := os.pread(2, 1000, 0).decode("utf-8", "replace"):
        os.truncate(2, 0)
        wrong.append(f"printed: {printed}")
    return count, wrong


class Reader:
    """Reads files in a process of its own, in limits, until one kills it."""

    def __init__(self, folder):
        self.folder, self.pool = folder, None

    def read(self, file):
        if self.pool is None:
            spawn = multiprocessing.get_context("spawn")
            self.pool = ProcessPoolExecutor(1, spawn, _limit, (self.folder,))
        try:
            return self.pool.submit(read, file).result(MAX_SECONDS)
        except (BrokenProcessPool, TimeoutError) as error:
            self.end()
            return 0, [f"the process ended or was late: {error!r}"]

    def end(self):
        for process in ((self.pool and self.pool._processes) or {}).values():
            process.kill()
        self.pool = None


def _limit(folder):
    warnings.simplefilter("ignore")
    os.dup2(os.open(folder / "printed.txt", os.O_CREAT | os.O_RDWR | os.O_APPEND), 2)
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    worker.TIMEOUT_S = 3.0  # so small a file need not wait for its end


def attack(folder, sound, reader, seed, numbers):
    """Yield the name of each mutant, how many channels could be read, and what went wrong."""
    for number in numbers:
        name, content = mutant(sound, seed, number)
        file = folder / f"mutant-{name}"
        file.write_bytes(content)
        count, wrong = reader.read(file)
        yield name, count, [f"seed {seed}, number {number}: {each}" for each in wrong]
