"""Worker processes that end at the worst moment."""

import os
import signal
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path

import pytest

from tvsysid.study.workers import processes

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_workers")]

LARGE = 50_000_000


def large():
    return bytes(LARGE)


def received():
    """Bytes that this process has read, those of an unfinished message included."""
    return int(Path("/proc/self/io").read_text().split("rchar: ")[1].split()[0])


def wait_for_a_part_of(result):
    before = received()
    while received() < before + LARGE // 100:
        assert not result.done()
        time.sleep(0.001)


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="needs /proc")
@pytest.mark.parametrize("killed", [True, False])
def test_a_worker_that_ends_halfway_through_its_result_leaves_nobody_waiting(killed):
    with pytest.raises(BrokenExecutor if killed else KeyboardInterrupt), processes(1) as pool:  # noqa: PT012
        result = pool.submit(large)
        wait_for_a_part_of(result)
        if not killed:
            raise KeyboardInterrupt
        (worker,) = pool._processes
        os.kill(worker, signal.SIGKILL)
        result.result()
