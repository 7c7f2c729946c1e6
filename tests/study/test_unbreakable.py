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
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import wait_for

from tvsysid.study import Study, read_results, run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc"),
]

TRIALS = 20
TOTAL = 2 * TRIALS
STUDY = {"duration_s": 40, "methods": ["birf"], "trials": TRIALS}
WORDS = f"tvsysid.cli benchmark --duration 40 --method birf --trials {TRIALS} --out out".split()


@pytest.fixture(scope="module")
def uninterrupted():
    return run(Study(**STUDY), workers=1)


@pytest.fixture
def start(tmp_path):
    """Start a module in a process group of its own, which is killed after the test."""
    started = []

    def start(module, *words):
        process = subprocess.Popen(  # threads do nothing then
            [sys.executable, "-m", module, *words],
            cwd=tmp_path,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # A shell makes processes in the background ignore it
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
        )
        started.append(process)
        return process

    yield start
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def trials_in(folder):
    return len(list(Path(folder, "out/tasks").glob("[!.]*.npz")))


def children_of(pid):
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return found


def interrupt(process, number=signal.SIGINT):
    """Interrupt all of a process group, and return what it says."""
    os.killpg(process.pid, number)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 130, errors
    return errors


def resumed_to_the_last_bit(folder, expected):
    """Do what is left of the study in a folder, and compare all of it."""
    run(Study(**STUDY), folder / "out", workers=1)
    same_to_the_last_bit(folder, expected)


def same_to_the_last_bit(folder, expected):
    found = read_results(folder / "out")
    for name in set(expected.data_vars) - {"seconds"}:
        np.testing.assert_array_equal(found[name].values, expected[name].values)


def test_killed_at_random_moments_and_gone_on_with(tmp_path, start, uninterrupted):
    chance = random.Random(20)
    before = 0
    for number in range(4):
        process = start(*WORDS, "--workers", "2" if number == 2 else "1")
        target = min(before + chance.randrange(0, TOTAL // 8), TOTAL - 10)
        wait_for(lambda: trials_in(tmp_path) >= target or process.poll() is not None)  # noqa: B023
        time.sleep(chance.uniform(0, 0.05))
        workers = children_of(process.pid)
        assert process.poll() is None
        process.kill()
        process.wait()
        wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))  # noqa: B023
        assert trials_in(tmp_path) >= before
        before = trials_in(tmp_path)
    assert before < TOTAL
    resumed_to_the_last_bit(tmp_path, uninterrupted)


def test_interrupted_with_a_key_and_gone_on_with(tmp_path, start, uninterrupted):
    for number in (signal.SIGINT, signal.SIGTERM):
        already = trials_in(tmp_path)
        process = start(*WORDS, "--workers", "1")
        wait_for(lambda: trials_in(tmp_path) > already + 10)  # noqa: B023
        *before, last = interrupt(process, number).splitlines()
        told = f"resuming: {already} of {TOTAL} tasks are done already"
        assert before == [told] * bool(already)
        assert last.startswith("tvsysid: interrupted. Finished work is kept")
    resumed_to_the_last_bit(tmp_path, uninterrupted)


def test_a_method_that_hangs_can_be_interrupted(tmp_path, start):
    (tmp_path / "hanging.py").write_text(
        "import pathlib, time, tvsysid\nclass Mine(tvsysid.Method):\n    def fit(self, "
        "ensemble):\n        pathlib.Path('begun').touch()\n        time.sleep(3600)\n"
    )
    process = start(*WORDS, "--method", "hanging:Mine", "--workers", "2")
    wait_for((tmp_path / "begun").exists)
    workers = children_of(process.pid)
    assert len(workers) >= 2
    assert "interrupted. Finished work is kept" in interrupt(process)
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))


def test_a_second_process_on_one_store_is_refused(tvsysid, tmp_path, start, uninterrupted):
    first = start(*WORDS, "--workers", "1")
    wait_for(lambda: trials_in(tmp_path) > 0)
    os.kill(first.pid, signal.SIGSTOP)  # it may be done before the second has started
    code, _, errors = tvsysid(*WORDS[1:])
    assert code == 2
    assert "another process is running a study in this folder" in errors
    first.kill()
    first.wait()
    resumed_to_the_last_bit(tmp_path, uninterrupted)


@pytest.mark.usefixtures("undrawn")
def test_a_dask_worker_killed_in_mid_run(tvsysid, tmp_path, start, uninterrupted):
    distributed = pytest.importorskip("distributed")
    place = tmp_path / "scheduler.json"
    words = ["--scheduler-file", str(place), "--no-dashboard"]
    start("distributed.cli.dask_scheduler", *words, "--port", "0")
    wait_for(place.exists)
    doomed, other = (
        start("distributed.cli.dask_worker", *words, "--no-nanny", "--nthreads", "1")
        for _ in range(2)
    )
    address = json.loads(place.read_text())["address"]
    with distributed.Client(address) as client:
        client.wait_for_workers(2, timeout=60)
    killed_at = []

    def kill_one():
        wait_for(lambda: trials_in(tmp_path) > 5)
        doomed.kill()
        killed_at.append(trials_in(tmp_path))

    killer = threading.Thread(target=kill_one)
    killer.start()
    assert tvsysid(*WORDS[1:], "--scheduler", address)[0] == 0
    killer.join()
    assert killed_at[0] < TOTAL
    assert other.poll() is None
    same_to_the_last_bit(tmp_path, uninterrupted)


def test_no_cluster_there(tvsysid, monkeypatch):
    distributed = pytest.importorskip("distributed")
    patient = distributed.Client
    monkeypatch.setattr(
        distributed, "Client", lambda address, timeout: patient(address, timeout="1s")
    )
    code, _, errors = tvsysid(*WORDS[1:], "--scheduler", "tcp://127.0.0.1:9")
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
        code, _, errors = tvsysid(*WORDS[1:], "--workers", 2)
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
