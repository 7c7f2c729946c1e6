"""Damaged files are read or refused: they never end or hang the process that reads them.

After a change to a reader, or a new version of a library beneath, try other and more files:

    TVSYSID_FUZZ_SEED=1 TVSYSID_FUZZ_COUNT=10000 pytest -n0 tests/recordings/test_fuzz.py

It reports the seed and number of each file that ends in another error than InputError, stops the
reading process, prints, or takes more than 8 GiB. Copy such a file to ``found`` when it is mended.
"""

import multiprocessing
import os
import resource
import struct
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
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

SEED = int(os.environ.get("TVSYSID_FUZZ_SEED", "5"))
COUNT = int(os.environ.get("TVSYSID_FUZZ_COUNT", "300"))
FOUND = sorted(Path(__file__).with_name("found").iterdir())  # mutants that did what their names say
MAX_BYTES = 8 * 2**30  # of addresses, for the reading process
MAX_SECONDS = 90  # for each file, on a machine that has other work
LOADERS = {"recording": load_recording, "ensemble": load_ensemble}  # of files with such a name
EXTREMES = (0, 1, 8, *(2**bits - sign for bits in (7, 8, 15, 16, 31, 32, 63) for sign in (0, 1)))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the limits are those of Linux"),
]


def write_object(age, file, *signals):
    files.write_object(file, files.nldat(signals), age)


def write_segments(file, *signals):
    files.write_segdat(file, signals, "struct", [1, 31], [20, 30])


def write_own(file, angle, torque):
    if file.stem == "recording":
        settings = {"channels": {"emg": angle}, "trial_starts": (0, 30)}
        write_recording(file, Recording(angle, torque, 200.0, **settings))
    else:
        write_ensemble(file, Ensemble(angle.reshape(6, 10), torque.reshape(6, 10), 200.0))


SOUND = {
    **files.WRITERS,
    "gait.c3d": files.write_gait,
    "segments.mat": write_segments,
    **{f"object-{age}.mat": partial(write_object, age) for age in ("old", "v7", "v7.3")},
    **{f"{kind}.{ending}": write_own for kind in LOADERS for ending in ("nc", "mat")},
}


def damage(random, content):
    """Flip bits, cut, change a block or set an integer to an extreme: one to three times."""
    content = bytearray(content)
    for _ in range(random.integers(1, 4)):
        place = int(random.integers(max(len(content) - 8, 1)))
        kind = random.choice(["bits", "cut", "block", "integer"], p=[0.1, 0.1, 0.4, 0.4])
        if kind == "bits":
            content[place] ^= 1 << int(random.integers(8))
        elif kind == "cut":
            del content[place + 1 :]
        elif kind == "block":
            end = place + int(random.choice([8, 512, len(content)]))
            block = content[place:end]
            changes = (bytes(len(block)), b"\xff" * len(block), b"", block * 5)
            content[place:end] = changes[random.integers(4)]
        else:
            form = str(random.choice(["<H", ">H", "<I", ">I", "<Q", ">Q"]))
            width = struct.calcsize(form)
            value = struct.pack(form, int(random.choice(EXTREMES)) % 256**width)
            place -= place % width
            content[place : place + width] = value
        content = content or bytearray(1)
    return bytes(content)


def read(file):
    """Return the number of channels that could be read, and what went wrong."""
    wrong, channels = [], {}

    def attempt(action, *given):
        try:
            return action(*given)
        except InputError as error:
            if file.name not in str(error):
                wrong.append(f"the message does not name the file: {error!r}")
        except BaseException as error:
            wrong.append(repr(error))

    channels = attempt(describe_file, file) or {}
    values = [attempt(each.read, f"{file.name}: {name}") for name, each in channels.items()]
    for each in channels.values():
        attempt(each.described.encode, "utf-8")
    for kind, load in LOADERS.items():
        if kind in file.name:
            attempt(load, file)
    if printed := os.pread(2, 1000, 0):
        os.truncate(2, 0)
        wrong.append(f"printed: {printed}")
    return sum(each is not None for each in values), wrong


def limit(folder):
    warnings.simplefilter("ignore")
    os.dup2(os.open(folder / "printed.txt", os.O_CREAT | os.O_RDWR | os.O_APPEND), 2)
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    worker.WAIT_S = 3.0  # so small a file need not wait for its end


@pytest.fixture(scope="module")
def read_apart(tmp_path_factory):
    """Read a file in a process of its own, within limits."""
    folder = tmp_path_factory.mktemp("reader")
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(1, spawn, limit, (folder,))
    yield lambda file: pool.submit(read, file).result(MAX_SECONDS)
    for process in pool._processes.values():
        process.kill()  # a library may never return


def test_damage_is_read_or_refused(tmp_path, read_apart):
    signals = np.random.default_rng(1).normal(scale=0.1, size=(2, 60))
    for name, write in SOUND.items():
        write(tmp_path / name, *signals)
        count, wrong = read_apart(tmp_path / name)
        assert (count > 0, wrong) == (True, []), name
    sound = {file: file.read_bytes() for file in sorted(tmp_path.iterdir())}
    counts = []
    for number in range(COUNT):
        file, content = list(sound.items())[number % len(sound)]
        file.write_bytes(damage(np.random.default_rng([SEED, number]), content))
        described = file.name in ("sub-1_channels.tsv", "sub-1_motion.json")
        count, wrong = read_apart(tmp_path / "sub-1_motion.tsv" if described else file)
        assert not wrong, f"seed {SEED}, number {number}, {file.name}"
        counts.append(count)
        file.write_bytes(content)
    assert {count > 0 for count in counts} == {True, False}


@pytest.mark.parametrize("file", FOUND, ids=lambda file: file.name)
def test_what_once_did_harm_is_read_or_refused(read_apart, file):
    assert read_apart(file)[1] == []
