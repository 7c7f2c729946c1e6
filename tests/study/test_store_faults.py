"""Test a store whose writes, renames and fsyncs fail, and whose files are damaged.

No result may ever be wrong.
"""

import builtins
import os
import re
import shutil
import sys
import tempfile
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path

import attrs
import numpy as np
import pytest
import xarray as xr
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

import tvsysid as tv
from tvsysid.study import fixed, read_results
from tvsysid.study.contents import RECORDINGS, SIMULATIONS, Fixed, Layout, Variable
from tvsysid.study.run import run
from tvsysid.study.source import Source
from tvsysid.study.store import stored
from tvsysid.study.task import Task, as_text
from tvsysid.study.verified import Verified

LAYOUT = Layout(
    title=SIMULATIONS,
    places=("scenario", "trial"),
    fixed=(
        Fixed("scenario", ("scenario",), ["one", "two"]),
        Fixed("trial", ("trial",), np.arange(3)),
        Fixed("truth", ("scenario",), np.array([1.5, 0.0])),
    ),
    measured={
        "estimate": Variable(("time",), "longer than a block of a disk", "N m/rad"),
        "vaf": Variable((), "of every other trial there is none", "percent"),
        "failure": Variable((), "why there is no result"),
    },
    coordinates=(),
    identity={"study": ({"seed": 0}, "another study")},
)
LAYOUT.lengths["time"] = 600
PLACES = [(scenario, trial) for scenario in range(2) for trial in range(3)]
KEPT = b"what became of the recordings"


@attrs.frozen(kw_only=True)
class ToyTask(Task):
    place: tuple[int, int]

    def work(self):
        estimate = np.random.default_rng(self.place).normal(size=600)
        vaf = np.array(np.nan if self.place[1] == 1 else estimate[0])
        return {"estimate": estimate, "vaf": vaf, "failure": as_text("")}

    def all_failed(self, reason):
        raise AssertionError(reason)


class Toy(Source):
    """Six trials that cost nothing, and a file beside them, as an experiment has one."""

    layout = LAYOUT

    def task_at(self, place):
        return ToyTask(label="a trial", methods={}, shapes={}, place=place)

    def begin(self, store):
        store.keep(RECORDINGS, KEPT)


class KilledError(BaseException):
    """Nothing catches it, as nothing outlives a kill."""


@contextmanager
def toys():
    """Have studies be those of a toy."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules["tvsysid.study.run"], "source_of", lambda study, prepared: Toy())
        # Pure, and slow: made and opened once for all runs.
        patch.setattr(fixed, "contents_of", lambda layout: CONTENTS)
        patch.setattr(Verified, "dataset", opened_once)
        patch.setattr(os, "fsync", lambda handle: None)  # the machine goes on
        yield


@pytest.fixture(autouse=True)
def _toy():
    with toys():
        yield


CONTENTS = fixed.contents_of(LAYOUT)
OPENED = {}


def opened_once(self, dataset=Verified.dataset):
    """What xarray makes of fixed files, which is the same for the same files."""
    files = tuple((name, buffer.to_bytes()) for name, buffer in sorted(self._store_dict.items()))
    if files not in OPENED:
        OPENED[files] = dataset(self).load()
    return OPENED[files]


@cache
def expected():
    """Results of a run that nothing interrupts."""
    with toys():
        return run(None, workers=1)


def done(path, limit=None):
    """Run the study; after so many trials it is killed."""

    def count(there, total):
        if there == limit:
            raise KilledError

    return run(None, store=path, workers=1, progress=count).load()


class Failing:
    """Make one of the calls that change files fail.

    It fails by an error, or by a kill, after which no call succeeds.
    """

    def __init__(self, number, kill):
        self.number, self.kill = number, kill
        self.calls = 0

    def fails(self):
        self.calls += 1
        if self.kill and self.calls >= self.number:
            raise KilledError
        if self.calls == self.number:
            raise OSError(28, "No space left on device")

    def before(self, call, *args, **kwargs):
        self.fails()
        return call(*args, **kwargs)

    def opened(self, call, file, mode="r", *args, **kwargs):
        if "w" not in mode:
            return call(file, mode, *args, **kwargs)
        self.fails()
        return Half(call(file, mode, *args, **kwargs), self)

    @contextmanager
    def patched(self):
        with pytest.MonkeyPatch.context() as patch:
            for name in ("replace", "rename", "fsync", "unlink", "rmdir", "mkdir"):
                patch.setattr(os, name, partial(self.before, getattr(os, name)))
            patch.setattr(builtins, "open", partial(self.opened, open))
            yield


class Half:
    """A file of which half is written before it fails."""

    def __init__(self, file, failing):
        self.file, self.failing = file, failing

    def write(self, content):
        try:
            self.failing.fails()
        except BaseException:
            self.file.write(content[: len(content) // 2])
            raise
        return self.file.write(content)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()


@pytest.mark.slow
@pytest.mark.parametrize("kill", [False, True])
def test_a_failure_of_any_write_rename_or_fsync_loses_nothing(tmp_path, kill):
    total, reference = Failing(-1, kill=False), expected()
    with total.patched():
        xr.testing.assert_identical(done(tmp_path / "whole.zarr"), reference)
    assert total.calls > 150
    whole, survived = files_in(tmp_path / "whole.zarr"), []
    for number in range(1, total.calls + 1):
        path = tmp_path / f"{number}.zarr"
        with suppress(KilledError, OSError), Failing(number, kill).patched():
            done(path)
            survived.append(number)
        if kill and path.exists():
            never_wrong(path)
        xr.testing.assert_identical(done(path), reference)
        assert files_in(path) == whole
        assert sorted(
            item.name for item in tmp_path.iterdir() if str(number) in item.name
        ) == sorted((path.name, f".{path.name}.lock"))
        shutil.rmtree(path)
        (tmp_path / f".{path.name}.lock").unlink()
    assert len(survived) <= (
        0 if kill else 6
    )  # folders that are there already could not be made once more


def files_in(path):
    return {
        str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()
    }


def never_wrong(path):
    """Read a store, finished or not: what is read is right.

    Returns the message where it is not read.
    """
    try:
        found, beside = read_results(path), None
        with suppress(tv.InputError):
            beside = stored(path).kept(RECORDINGS)
    except tv.InputError as error:
        return str(error)
    assert beside in (None, KEPT)
    assert found.attrs == expected().attrs
    there = found.checksums.values.any(axis=-1)
    for name, values in expected().variables.items():
        wanted = values.values.copy()
        if values.dims[:2] == LAYOUT.places:
            wanted[~there] = {"T": "", "u": 0}.get(wanted.dtype.kind, np.nan)
        np.testing.assert_array_equal(found[name].values, wanted)
    return ""


def follow(path, message):
    """Do what an error says, but for giving the command again."""
    if named := re.search(
        r"files? do(?:es)? not hold what was written there; remove (?:it|them: (.+));", message
    ):
        for file in named[1].split(", ") if named[1] else [message.partition(": this file")[0]]:
            Path(file).unlink()
    elif named := re.search(
        r"if (\S+) is damaged, remove that file and run the study again", message
    ):
        Path(named[1]).unlink()
    else:
        assert "give the command that ran the study again" in message


class Misfortunes(RuleBasedStateMachine):
    """Whatever happens to a store, and in whatever order."""

    @initialize()
    def begin(self):
        self.folder = Path(tempfile.mkdtemp(dir=os.environ.get("PYTEST_DEBUG_TEMPROOT")))
        self.path = self.folder / "results.zarr"

    def teardown(self):
        shutil.rmtree(self.folder)

    def files(self):
        return sorted(file for file in self.path.rglob("*") if file.is_file())

    def run(self, **settings):
        """The command, again after what its errors say was done."""
        for _ in range(4):
            try:
                return done(self.path, **settings)
            except tv.InputError as error:
                follow(self.path, str(error))
        raise AssertionError("its errors led nowhere")

    @rule(trials=st.integers(0, 6))
    def some_trials(self, trials):
        with suppress(KilledError):
            xr.testing.assert_identical(self.run(limit=trials), expected())

    @rule(call=st.integers(1, 180))
    def kill(self, call):
        with suppress(KilledError, tv.InputError), Failing(call, kill=True).patched():
            done(self.path)

    @rule()
    def resume(self):
        xr.testing.assert_identical(self.run(), expected())

    @rule()
    def read(self):
        if self.path.exists() and (message := never_wrong(self.path)):
            follow(self.path, message)
            self.resume()
            assert never_wrong(self.path) == ""

    @rule(
        kind=st.sampled_from(["truncate", "blank", "block", "flip", "delete", "swap", "append"]),
        which=st.tuples(st.floats(0, 1, exclude_max=True), st.floats(0, 1, exclude_max=True)),
        place=st.floats(0, 1, exclude_max=True),
        bit=st.integers(0, 7),
    )
    def damage(self, kind, which, place, bit):
        files = self.files()
        if not files:
            return
        file, other = (files[int(each * len(files))] for each in which)
        content = bytearray(file.read_bytes())
        at = int(place * len(content))
        if kind == "delete":
            file.unlink()
        elif kind == "swap":
            file.write_bytes(other.read_bytes())
            other.write_bytes(content)
        elif content:
            changed = {
                "truncate": content[:at],
                "blank": bytes(len(content)),
                "append": content + content[:at],
            }
            changed["block"] = (
                content[: at // 4096 * 4096] + bytes(4096) + content[at // 4096 * 4096 + 4096 :]
            )
            content[at] ^= 1 << bit
            file.write_bytes(changed.get(kind, content))

    @invariant()
    def what_is_read_is_right(self):
        if hasattr(self, "path") and self.path.exists():
            never_wrong(self.path)


@pytest.mark.slow
class TestMisfortunes(Misfortunes.TestCase):
    settings = settings(stateful_step_count=12)

    def setUp(self):
        self.toys = toys()
        self.toys.__enter__()
        super().setUp()

    def tearDown(self):
        self.toys.__exit__(None, None, None)
        super().tearDown()
