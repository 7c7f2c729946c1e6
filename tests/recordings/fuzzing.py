"""Damaged files of every format, read by processes with limits: what is not read is refused, and nothing worse.

A mutant follows from the seed, its number and the sound files. Run by itself, any number of them
are tried::

    python -m tests.recordings.fuzzing --count 10000 --seed 1 --keep FOLDER
"""

import argparse
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pandas as pd
from scipy.io import savemat
from scipy.sparse import csc_array
from tests.recordings import files, mutations
from tests.recordings.reading import GIB, memory

import tvsysid
from tvsysid import Ensemble, Recording
from tvsysid.recordings import write_ensemble, write_recording

HANG = 90  # seconds, on a machine that has other work; `reading.py` counts those of the processor
MOST = 4 * GIB  # of memory that a process takes before it is ended


def write_mat_5(file, angle, torque, **settings):
    """Every kind of variable that SciPy writes."""
    others = {
        "note": "ankle",
        "flag": torque > 0,
        "coarse": (1000 * angle).astype("i2"),
        "cell": files.cells("a", "b"),
    }
    others |= {"sparse": csc_array(np.eye(3)), "complex": angle * 1j}
    savemat(
        file,
        {"pos": angle, "run": {"pos": angle[:, None], "tq": torque}, "tq": torque} | others,
        **settings,
    )
    undated(file)


def undated(file):
    """The same content whenever it is written: a MAT file's header tells the time."""
    content = file.read_bytes()
    file.write_bytes(content[:20].ljust(116) + content[116:])


def write_object(file, angle, torque, age):
    files.write_object(file, files.nldat([angle, torque]), age)
    undated(file)


def write_mat_4(file, angle, torque):
    savemat(file, {"pos": angle, "tq": torque, "fs": 200.0, "note": "ankle"}, format="4")


def write_hdf5(file, angle, torque):
    """Every kind of link, type and filter; headers with checksums."""
    with h5py.File(file, "w", track_order=True) as root:
        for name, kind in {"pos": "gzip", "tq": "lzf", "scaled": None}.items():
            filters = {"compression": kind, "shuffle": bool(kind), "fletcher32": not kind}
            root.create_dataset(name, data=torque, chunks=(16,), **filters).attrs["units"] = "N m"
        root["run/pos"] = angle
        root["text"] = ["ankle", "knee"]
        root["records"] = np.array([(1, 2.0)], dtype=[("first", "i4"), ("second", "f8")])
        root["none"] = h5py.Empty("f8")
        root["soft"], root["out"] = h5py.SoftLink("/run/pos"), h5py.ExternalLink("other.h5", "pos")
        layout = h5py.VirtualLayout(shape=(60,), dtype="f8")
        layout[:] = h5py.VirtualSource("other.h5", "tq", shape=(60,))
        root.create_virtual_dataset("virtual", layout)


def write_parquet(file, angle, torque):
    """Every kind of column."""
    table = pd.DataFrame(
        {"pos": angle, "tq": torque, "side": pd.Categorical(["left", "right"] * 30)}
    )
    table["day"], table["note"] = pd.Timestamp("2026-01-01"), "ankle"
    table["gaps"] = pd.array([1, None] * 30, dtype="Int16")
    table["list"] = [[1.0]] * 60
    table.to_parquet(file, compression="zstd")


def write_own(file, angle, torque):
    """As tvsysid writes them; `reading.py` also loads them."""
    if file.stem == "recording":
        write_recording(
            file, Recording(angle, torque, 200.0, channels={"emg": angle}, trial_starts=(0, 30))
        )
    else:
        write_ensemble(file, Ensemble(angle.reshape(6, 10), torque.reshape(6, 10), 200.0))
    if file.suffix == ".mat":
        undated(file)


def write_nwb(file, angle, torque):
    """Every way to say what numbers and times mean."""
    times = np.arange(len(angle)) / 200
    with h5py.File(file, "w", track_order=True) as root:
        files.write_series(
            root, "acquisition/pos", (1000 * angle).astype("i2"), "rad", conversion=1e-3, offset=0.5
        )
        files.write_series(
            root, "processing/motor/tq", np.stack([torque, angle], axis=1), "N m", timestamps=times
        )
        root["processing/motor/tq/channel_conversion"] = [1.0, 2.0]
        linked = h5py.SoftLink("/processing/motor/tq/timestamps")
        files.write_series(root, "stimulus/presentation/command", angle, "rad", timestamps=linked)
        root.create_dataset("acquisition/emg/data", data=angle, compression="gzip")
        root["acquisition/emg/timestamps"] = times


def write_segdat(file, angle, torque):
    files.write_segdat(file, [angle, torque], "struct", [1, 31], [20, 30])
    undated(file)


OWN = ("recording.nc", "ensemble.nc", "recording.mat", "ensemble.mat")
SEEDS = {
    "version4.mat": write_mat_4,
    "version5.mat": write_mat_5,
    "version7.mat": partial(write_mat_5, do_compression=True),
    "old-object.mat": partial(write_object, age="old"),
    "object.mat": partial(write_object, age="v7"),
    "object73.mat": partial(write_object, age="v7.3"),
    "every.h5": write_hdf5,
    "every.nc": write_hdf5,
    "every.parquet": write_parquet,
    "every.nwb": write_nwb,
    "gait.c3d": files.write_gait,
    "segments.mat": write_segdat,
} | {name: files.WRITERS[name] for name in files.WRITERS if name not in ("v5.mat", "ankle.hdf5")}
SEEDS |= dict.fromkeys(OWN, write_own)
MOTION, DESCRIPTIONS = (
    "sub-1_motion.tsv",
    ("sub-1_channels.tsv", "sub-1_motion.json"),
)  # which are damaged as well
INSIDE = {
    "version7.mat": mutations.inside_mat,
    "recording.mat": mutations.inside_mat,
    "ensemble.mat": mutations.inside_mat,
    "object.mat": mutations.inside_mat,
    "ankle.npz": mutations.inside_zip,
    "ankle.h5": mutations.inside_chunk,
    "every.h5": mutations.inside_chunk,
    "every.nwb": mutations.inside_chunk,
    "segments.mat": mutations.inside_mat,
}


def sound_files(folder):
    """A small file of each format, by name."""
    random = np.random.default_rng(1)
    signals = random.normal(scale=0.1, size=60), random.normal(size=60)
    for name, write in SEEDS.items():
        write(folder / name, *signals)
    return {name: (folder / name).read_bytes() for name in (*SEEDS, *DESCRIPTIONS)}


def mutant(sound, seed, number):
    """Name of the sound file, and the content of what became of it."""
    random = np.random.default_rng([seed, number])
    names = list(sound)
    name = names[number % len(names)]
    content, chosen = sound[name], random.random()
    if chosen < 0.05:
        return name, mutations.spliced(random, content, sound[names[random.integers(len(names))]])
    if chosen < 0.7 and name in INSIDE:
        return name, INSIDE[name](random, content)
    content = mutations.damaged(random, content)
    return name, mutations.with_checksums(content) if chosen < 0.9 else content


class Outcome(NamedTuple):
    """What became of one mutant."""

    name: str
    number: int
    content: bytes
    read: int = 0
    wrong: tuple[str, ...] = ()
    seconds: float = 0.0
    bytes: int = 0


class Reader:
    """A process that reads files until one kills it; the next gets another."""

    def __init__(self, folder, warm):
        self.errors, self.warm, self.process = folder / "errors.txt", warm, None

    def start(self):
        place = os.pathsep.join(
            [str(Path(tvsysid.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
        )
        with self.errors.open("a+") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.recordings.reading", *self.warm],
                cwd=Path(__file__).parents[2],
                env=os.environ | {"PYTHONPATH": place, "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        if not self.answer(120):
            raise RuntimeError(f"sound files cannot be read: {self.last_words()}")

    def answer(self, seconds, room=MOST):
        """One line; nothing if it does not come in time, or takes more memory than that."""
        end, most = time.monotonic() + seconds, memory("VmRSS", self.process.pid) + room
        while time.monotonic() < end and memory("VmRSS", self.process.pid) < most:
            if select.select([self.process.stdout], [], [], 0.1)[0]:
                return self.process.stdout.readline()
        return None

    def last_words(self):
        """What it printed before it died, without the list of modules."""
        return self.errors.read_text(errors="replace").partition("Extension modules")[0][-1500:]

    def read(self, file):
        """What happened, as `reading.py` reports it."""
        if self.process is None or self.process.poll() is not None:
            self.start()
        os.truncate(self.errors, 0)
        print(file, file=self.process.stdin, flush=True)
        answer = self.answer(HANG)
        if answer:
            return json.loads(answer)
        taken = memory("VmRSS", self.process.pid)
        self.end()
        how = f"was ended after {HANG} s or at {taken / 1e9:.3g} GB" if answer is None else "died"
        return {"wrong": [f"the process {how}: {self.last_words()}"]}

    def end(self):
        if self.process is not None:
            self.process.kill()
            self.process.communicate()


@contextmanager
def reader_of(folder):
    """Sound files, and a process that has read them."""
    sound = sound_files(folder)
    reader = Reader(folder, [str(folder / name) for name in SEEDS])
    try:
        yield sound, reader
    finally:
        reader.end()


def attack(folder, sound, reader, seed, numbers):
    """Outcome of each mutant."""
    for number in numbers:
        name, content = mutant(sound, seed, number)
        for other in (MOTION, *DESCRIPTIONS):  # the others are sound
            (folder / f"mutant-{other}").write_bytes(sound[other])
        file = folder / f"mutant-{name}"
        file.write_bytes(content)
        yield Outcome(
            name,
            number,
            content,
            **reader.read(file.with_name(f"mutant-{MOTION}") if name in DESCRIPTIONS else file),
        )


def main():
    parser = argparse.ArgumentParser(description="Read damaged files of every format.")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--keep", type=Path, default=Path("findings"), help="folder for what was found"
    )
    options = parser.parse_args()
    read, refused, found = Counter(), Counter(), Counter()
    slowest, most = Counter(), Counter()
    numbers = range(options.first, options.first + options.count)
    with tempfile.TemporaryDirectory() as folder, reader_of(Path(folder)) as (sound, reader):
        for outcome in attack(Path(folder), sound, reader, options.seed, numbers):
            name = outcome.name
            (found if outcome.wrong else read if outcome.read else refused)[name] += 1
            slowest[name], most[name] = (
                max(slowest[name], outcome.seconds),
                max(most[name], outcome.bytes),
            )
            if outcome.wrong:
                keep(options, outcome)
    print(
        f"{'format':15}{'read':>8}{'refused':>8}{'findings':>9}{'longest':>10}{'most memory':>13}"
    )
    for name in SEEDS:
        print(
            f"{name:15}{read[name]:8}{refused[name]:8}{found[name]:9}{slowest[name]:8.2f} "
            f"s{most[name] / 1e6:10.0f} MB"
        )
    print(f"{'all':15}{read.total():8}{refused.total():8}{found.total():9}")
    sys.exit(1 if found.total() else 0)


def keep(options, outcome):
    """The mutant, and what happened beside it."""
    options.keep.mkdir(parents=True, exist_ok=True)
    file = options.keep / f"{options.seed}-{outcome.number}-{outcome.name}"
    file.write_bytes(outcome.content)
    file.with_suffix(f"{file.suffix}.txt").write_text("\n".join(outcome.wrong), encoding="utf-8")
    print(f"{file}: {outcome.wrong[0][:400]}", flush=True)


if __name__ == "__main__":
    main()
