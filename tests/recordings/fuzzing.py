"""Damaged files of every format. A mutant follows from the seed, its number and the sound files."""

import contextlib
import multiprocessing
import os
import resource
import traceback
import warnings
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import h5py
import numpy as np
import pandas as pd
from scipy.io import savemat
from scipy.sparse import csc_array
from tests.recordings import files, mutations

from tvsysid import Ensemble, InputError, Recording
from tvsysid.recordings import (
    describe_file,
    load_ensemble,
    load_recording,
    worker,
    write_ensemble,
    write_recording,
)

MAX_BYTES = 8 * 2**30  # of addresses, for each process
MAX_SECONDS = 90  # on a machine that has other work
LOADERS = {"recording": load_recording, "ensemble": load_ensemble}  # of files with such a name


def write_mat_5(file, angle, torque, **settings):
    """Every kind of variable that SciPy writes."""
    others = {"note": "ankle", "flag": torque > 0, "coarse": (1000 * angle).astype("i2")}
    others |= {"cell": files.cells("a", "b"), "sparse": csc_array(np.eye(3)), "complex": angle * 1j}
    run = {"pos": angle[:, None], "tq": torque}
    savemat(file, {"pos": angle, "run": run, "tq": torque} | others, **settings)


def write_object(file, angle, torque, age):
    files.write_object(file, files.nldat([angle, torque]), age)


def write_hdf5(file, angle, torque):
    """Every kind of link, type and filter; headers with checksums."""
    with h5py.File(file, "w", track_order=True) as root:
        for name, kind in {"pos": "gzip", "tq": "lzf", "scaled": None}.items():
            filters = {"compression": kind, "shuffle": bool(kind), "fletcher32": not kind}
            root.create_dataset(name, data=torque, chunks=(16,), **filters).attrs["units"] = "N m"
        root["run/pos"], root["text"] = angle, ["ankle", "knee"]
        root["records"] = np.array([(1, 2.0)], dtype=[("first", "i4"), ("second", "f8")])
        root["none"] = h5py.Empty("f8")
        root["soft"], root["out"] = h5py.SoftLink("/run/pos"), h5py.ExternalLink("other.h5", "pos")


def write_parquet(file, angle, torque):
    """Every kind of column."""
    sides, gaps = pd.Categorical(["left", "right"] * 30), pd.array([1, None] * 30, dtype="Int16")
    columns = {"pos": angle, "tq": torque, "side": sides, "gaps": gaps, "list": [[1.0]] * 60}
    columns |= {"day": pd.Timestamp("2026-01-01"), "note": "ankle"}
    pd.DataFrame(columns).to_parquet(file, compression="zstd")


def write_own(file, angle, torque):
    """As tvsysid writes them; they are also loaded."""
    if file.stem == "recording":
        settings = {"channels": {"emg": angle}, "trial_starts": (0, 30)}
        write_recording(file, Recording(angle, torque, 200.0, **settings))
    else:
        write_ensemble(file, Ensemble(angle.reshape(6, 10), torque.reshape(6, 10), 200.0))


def write_segdat(file, angle, torque):
    files.write_segdat(file, [angle, torque], "struct", [1, 31], [20, 30])


OWN = ("recording.nc", "ensemble.nc", "recording.mat", "ensemble.mat")
SEEDS = {
    "version5.mat": write_mat_5,
    "version7.mat": partial(write_mat_5, do_compression=True),
    "old-object.mat": partial(write_object, age="old"),
    "object.mat": partial(write_object, age="v7"),
    "object73.mat": partial(write_object, age="v7.3"),
    "every.h5": write_hdf5,
    "every.parquet": write_parquet,
    "gait.c3d": files.write_gait,
    "segments.mat": write_segdat,
}
SEEDS |= {name: write for name, write in files.WRITERS.items() if name != "v5.mat"}
SEEDS |= dict.fromkeys(OWN, write_own)
MOTION, DESCRIPTIONS = "sub-1_motion.tsv", ("sub-1_channels.tsv", "sub-1_motion.json")
COMPRESSED = ("version7.mat", "recording.mat", "ensemble.mat", "object.mat")
INSIDE = dict.fromkeys(COMPRESSED, mutations.inside_mat)
INSIDE |= dict.fromkeys(("ankle.h5", "every.h5"), mutations.inside_chunk)


def sound_files(folder):
    """A small file of each format, by name; a MAT file's header tells no time."""
    random = np.random.default_rng(1)
    signals = random.normal(scale=0.1, size=60), random.normal(size=60)
    for name, write in SEEDS.items():
        write(folder / name, *signals)
        content = (folder / name).read_bytes()
        if content[:6] == b"MATLAB":
            (folder / name).write_bytes(content[:20].ljust(116) + content[116:])
    return {name: (folder / name).read_bytes() for name in (*SEEDS, *DESCRIPTIONS)}


def mutant(sound, seed, number):
    """Name of the sound file, and the content of what became of it."""
    random = np.random.default_rng([seed, number])
    name = list(sound)[number % len(sound)]
    change = INSIDE[name] if name in INSIDE and random.random() < 0.7 else mutations.damaged
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
    worker.WAIT_S = 3.0  # so small a file need not wait for its end


def attack(folder, sound, reader, seed, numbers):
    """Yield the name of each mutant, how many channels could be read, and what went wrong."""
    for number in numbers:
        name, content = mutant(sound, seed, number)
        for other in (MOTION, *DESCRIPTIONS):  # the others are sound
            (folder / f"mutant-{other}").write_bytes(sound[other])
        file = folder / f"mutant-{name}"
        file.write_bytes(content)
        count, wrong = reader.read(
            file.with_name(f"mutant-{MOTION}") if name in DESCRIPTIONS else file
        )
        yield name, count, [f"seed {seed}, number {number}: {each}" for each in wrong]
