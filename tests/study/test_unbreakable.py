"""Test runs that are killed, lose a worker, or run out of disk, through the command line."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import fork_workers, wait_for

from tvsysid import cli
from tvsysid.study import Study, read_results, run

pytestmark = pytest.mark.slow

TRIALS = 20
TOTAL = 2 * TRIALS
STUDY = {"duration_s": 40, "methods": ["birf"], "trials": TRIALS}
WORDS = ["benchmark", "--duration", "40", "--method", "birf", "--trials", str(TRIALS)]
WORDS += ["--out", "out"]


@pytest.fixture(scope="module")
def uninterrupted():
    return run(Study(**STUDY), workers=1)


@pytest.fixture
def start_study(forking):
    """Start the study in a process of its own, which is stopped after the test."""
    started = []

    def start(folder, workers=1):
        started.append(forking.Process(target=run_study, args=(folder / "out", workers)))
        started[-1].start()
        return started[-1]

    yield start
    for process in started:
        process.kill()


def run_study(folder, workers):
    fork_workers()
    run(Study(**STUDY), folder, workers=workers)


def interruptible():
    """Restore the interrupt signal, which a shell ignores for background processes."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


class Forked:
    """The command line in a forked process group of its own.

    To fork takes less time than to start an interpreter.
    """

    def __init__(self, forking, folder, *words, prepare=fork_workers):
        self.errors = folder / "errors.txt"
        self.process = forking.Process(target=command, args=(folder, self.errors, words, prepare))
        self.process.start()
        self.pid = self.process.pid

    def communicate(self, timeout):
        self.process.join(timeout)
        self.returncode = self.process.exitcode
        return "", self.errors.read_text()


def command(folder, errors, words, prepare):
    prepare()
    os.setsid()
    interruptible()
    os.chdir(folder)
    os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.argv = ["tvsysid", *WORDS, *words]
    cli.main()


def dask(folder, name, words):
    """Be a scheduler or a worker of Dask."""
    os.chdir(folder)
    for number in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), number)
    import_module(f"distributed.cli.dask_{name}").main(words, standalone_mode=False)


def trials_in(folder):
    return len(list(Path(folder, "out/tasks").glob("[!.]*.npz")))


def children_of(pid):
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return found


def finished(process, code=0):
    _, errors = process.communicate(timeout=300)
    assert process.returncode == code, errors
    return errors


def resumed_to_the_last_bit(folder, expected):
    """Do what is left of the study in a folder, and compare all of it."""
    run(Study(**STUDY), folder / "out", workers=1)
    same_to_the_last_bit(folder, expected)


def same_to_the_last_bit(folder, expected):
    found = read_results(folder / "out")
    for name in set(expected.data_vars) - {"seconds"}:
        np.testing.assert_array_equal(found[name].values, expected[name].values)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_killed_at_six_random_moments_and_gone_on_with(tmp_path, start_study, uninterrupted):
    chance = random.Random(20)
    before = 0
    for number in range(6):
        process = start_study(tmp_path, workers=2 if number == 2 else 1)
        target = min(before + chance.randrange(0, TOTAL // 8), TOTAL - 10)
        wait_for(lambda: trials_in(tmp_path) >= target or process.exitcode is not None)  # noqa: B023
        time.sleep(chance.uniform(0, 0.05))
        workers = children_of(process.pid)
        assert process.exitcode is None
        assert number != 2 or len(workers) >= 2
        process.kill()
        process.join(60)
        wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))  # noqa: B023
        assert trials_in(tmp_path) >= before
        before = trials_in(tmp_path)
    assert before < TOTAL
    resumed_to_the_last_bit(tmp_path, uninterrupted)


def test_interrupted_with_a_key_and_gone_on_with(tmp_path, forking, uninterrupted):
    # A key interrupts workers too where a method hangs, below.
    for number in (signal.SIGINT, signal.SIGTERM):
        process = Forked(forking, tmp_path, "--workers", "1" if number == signal.SIGINT else "2")
        already = trials_in(tmp_path)
        wait_for(lambda: trials_in(tmp_path) > already + 10)  # noqa: B023
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        errors = finished(process, 130)
        before, _, last = errors.rstrip("\n").rpartition("\n")
        assert before == (
            "" if not already else f"resuming: {already} of {TOTAL} tasks are done already"
        )
        assert last.startswith("tvsysid: interrupted; finished work is kept")
    resumed_to_the_last_bit(tmp_path, uninterrupted)


def test_a_method_that_hangs_can_be_interrupted(tmp_path, forking):
    (tmp_path / "hanging.py").write_text(
        "import pathlib, time, tvsysid\nclass Mine(tvsysid.Method):\n    def fit(self, "
        "ensemble):\n        pathlib.Path('begun').touch()\n        time.sleep(3600)\n"
    )
    # Workers that start anew, as a user's do, and have not inherited what becomes of a signal.
    process = Forked(
        forking, tmp_path, "--method", "hanging:Mine", "--workers", "2", prepare=interruptible
    )
    wait_for((tmp_path / "begun").exists)
    workers = children_of(process.pid)
    began = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    assert "interrupted; finished work is kept" in finished(process, 130)
    assert time.monotonic() - began < 60
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))


@pytest.mark.skipif(os.name != "posix", reason="needs SIGSTOP")
def test_a_second_process_on_one_store_is_refused(tvsysid, tmp_path, start_study, uninterrupted):
    first = start_study(tmp_path)
    wait_for(lambda: trials_in(tmp_path) > 0)
    os.kill(first.pid, signal.SIGSTOP)  # it may be done before the second has started
    code, _, errors = tvsysid(*WORDS)
    assert code == 2
    assert "another process is running a study in this folder" in errors
    os.kill(first.pid, signal.SIGCONT)
    first.join(300)
    assert first.exitcode == 0
    same_to_the_last_bit(tmp_path, uninterrupted)


@pytest.mark.usefixtures("undrawn")
def test_a_dask_worker_killed_in_mid_run(tvsysid, tmp_path, forking, uninterrupted):
    pytest.importorskip("distributed")
    place = tmp_path / "scheduler.json"
    words = ["--scheduler-file", str(place), "--no-dashboard"]
    servers = []

    def start_dask(name, *more):
        servers.append(forking.Process(target=dask, args=(tmp_path, name, [*words, *more])))
        servers[-1].start()

    try:
        start_dask("scheduler", "--port", "0")
        wait_for(place.exists)
        for _ in range(2):
            start_dask("worker", "--no-nanny", "--nthreads", "1")
        address = json.loads(place.read_text())["address"]
        from distributed import Client

        with Client(address) as client:
            client.wait_for_workers(2, timeout=60)
        killed_at = []

        def kill_one():
            wait_for(lambda: trials_in(tmp_path) > 5)
            servers[1].kill()
            killed_at.append(trials_in(tmp_path))

        killer = threading.Thread(target=kill_one)
        killer.start()
        assert tvsysid(*WORDS, "--scheduler", address)[0] == 0
        killer.join()
        assert killed_at[0] < TOTAL
        assert servers[2].is_alive()
    finally:
        for server in servers:
            server.kill()
            server.join()
    same_to_the_last_bit(tmp_path, uninterrupted)


def test_no_cluster_there(tvsysid):
    code, _, errors = tvsysid(*WORDS, "--scheduler", "tcp://127.0.0.1:9")
    assert code == 2
    assert "--scheduler tcp://127.0.0.1:9: no Dask scheduler answers there" in errors


def test_a_full_disk_loses_nothing_that_was_finished(tvsysid, tmp_path, monkeypatch, uninterrupted):
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", small],
        capture_output=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip(f"cannot mount a small file system here: {mounted.stderr.decode().strip()}")
    try:
        monkeypatch.chdir(small)
        code, _, errors = tvsysid(*WORDS, "--workers", 2)
        assert code == 2
        assert "No space left on device" in errors
        assert "Traceback" not in errors
        kept = trials_in(small)
        assert kept > 3
        subprocess.run(["mount", "-o", "remount,size=100m", small], check=True)
        resumed_to_the_last_bit(small, uninterrupted)
    finally:
        monkeypatch.chdir(tmp_path)
        subprocess.run(["umount", "--lazy", small], check=True)
