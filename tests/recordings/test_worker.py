"""The process that reads files whose libraries crash or never end."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.conftest import wait_for

import tvsysid as tv
from tvsysid.recordings import describe_file, worker

DAMAGED = Path(__file__).parent / "damaged"
SCRIPT = """
import sys
import tvsysid as tv
print(tv.read_recording(sys.argv[1], angle="pos", torque="tq", sampling_rate=100))
"""


@pytest.fixture
def sound(tmp_path):
    signals = np.random.default_rng(1).normal(scale=0.1, size=(2, 600))
    savemat(tmp_path / "sound.mat", {"pos": signals[0], "tq": signals[1]})
    return tmp_path / "sound.mat"


def worker_pid():
    (process,) = worker._executor(os.getpid())._processes.values()
    return process.pid


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the limits are those of Linux")
@pytest.mark.parametrize("name", sorted(file.name for file in DAMAGED.iterdir()))
def test_a_file_that_kills_its_library_is_an_error_and_the_next_is_read(name, sound, monkeypatch):
    if name.endswith(".c3d"):
        pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    happened = "did not finish in 2 s" if name == "endless.c3d" else "crashed"
    message = rf"{name}: (the library .* {happened}|cannot be read)"
    depends = name == "bus-error.mat"  # what is in memory decides whether this one crashes
    describe_file(sound)  # the process runs before its time is limited
    with monkeypatch.context() as limited:
        if depends or name == "endless.c3d":
            limited.setattr(worker, "TIMEOUT_S", 2.0)
        with suppress(tv.InputError) if depends else pytest.raises(tv.InputError, match=message):
            describe_file(DAMAGED / name)
    assert set(describe_file(sound)) == {"pos", "tq"}


@pytest.mark.slow
def test_a_script_needs_no_main_guard_and_leaves_no_process(sound, tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, tmp_path / "script.py", sound]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout.startswith("Recording(6 s at 100 Hz")


@pytest.mark.slow
def test_ctrl_c_ends_a_library_that_does_not_answer(sound):
    pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    describe_file(sound)
    child = worker_pid()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs begin without
    thread = threading.main_thread().ident
    threading.Timer(1.0, lambda: signal.pthread_kill(thread, signal.SIGINT)).start()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        describe_file(DAMAGED / "endless.c3d")
    assert time.monotonic() - begun < 4
    wait_for(lambda: not Path(f"/proc/{child}/stat").exists(), 10.0)
    assert set(describe_file(sound)) == {"pos", "tq"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="processes are those of Linux")
def test_the_worker_ends_with_a_process_that_is_killed(sound):
    started = subprocess.Popen(
        [sys.executable, "-c", "from tvsysid.recordings import describe_file as d, worker; import "
         "os, sys, time; d(sys.argv[1]); print(*worker._executor(os.getpid())._processes, "
         "flush=True); time.sleep(60)", sound],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    child = int(started.stdout.readline())
    started.kill()
    started.communicate()
    wait_for(lambda: "State:\tZ" in status(child), 10.0)


def status(process):
    try:
        return Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return "State:\tZ"


@pytest.mark.slow
def test_paths_are_those_of_the_caller(sound, tmp_path, monkeypatch):
    (tmp_path / "inner").mkdir()
    for folder, path in ((tmp_path, "sound.mat"), (tmp_path / "inner", "../sound.mat")):
        monkeypatch.chdir(folder)
        assert describe_file(path)
    os.mkfifo("pipe.mat")
    with pytest.raises(tv.InputError, match=r"^pipe\.mat: no such file"):
        describe_file("pipe.mat")
