"""The process that reads files: what it survives, and what becomes of it."""

import os
import re
import signal
import struct
import subprocess
import sys
import threading
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.conftest import wait_for

import tvsysid as tv
from tvsysid import limits
from tvsysid.recordings import describe_file, process

DAMAGED = Path(__file__).parent / "damaged"
MESSAGES = {
    "crash.c3d": r"the library that reads such files crashed \(SIG(SEGV|BUS|ABRT)\); it is "
    r"damaged: copy it again",
    "endless.c3d": r"reading it took more than 1 s of processor time, and was stopped; it is "
    r"probably damaged",
    "memory.c3d": r"takes more memory than there is, or than what it holds accounts for",
    "crash-uncompressed.mat": r"the library that reads such files crashed \(SIG(SEGV|BUS|ABRT)\); "
    r"it is damaged",
    "crash-structure.mat": r"the library that reads such files crashed \(SIG(SEGV|BUS|ABRT)\); it "
    r"is damaged",
    "bus-error.mat": "crashed|is it whole",
}
pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the limits and signals are those of Linux"
)


@pytest.fixture
def sound(tmp_path):
    np.savez(
        tmp_path / "sound.npz", pos=np.arange(6.0).reshape(2, 3), tq=np.arange(6.0).reshape(3, 2).T
    )
    return tmp_path / "sound.npz"


def assert_sound(file):
    described = describe_file(file)
    for name, values in np.load(file).items():
        np.testing.assert_array_equal(described[name].read(name), values)


def processor_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.slow
def test_a_file_that_kills_its_library_is_an_error_and_the_next_is_read(sound):
    assert_sound(sound)
    first = process._reader.process.pid
    with pytest.raises(
        tv.InputError, match=rf"crash-structure\.mat: {MESSAGES['crash-structure.mat']}"
    ):
        describe_file(DAMAGED / "crash-structure.mat")
    assert_sound(sound)
    assert process._reader.process.pid != first


@pytest.mark.slow
def test_damaged_files_are_errors_within_seconds_and_a_gigabyte():
    pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    program = """
import resource, sys, tvsysid
from tvsysid.recordings import describe_file, limits, process
limits.SECONDS = 1.0  # instead of 5, here and in the process that reads
soon = "import tvsysid.recordings.limits as limits; limits.SECONDS = 1.0; "
process.PROGRAM = process.PROGRAM.replace("from tvsysid", soon + "from tvsysid", 1)
for file in sys.argv[1:]:
    try:
        describe_file(file)
    except tvsysid.InputError as error:
        print(error)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(1024 * used.ru_maxrss, used.ru_utime + used.ru_stime)
"""
    files = [str(DAMAGED / name) for name in MESSAGES]
    ended = subprocess.run(
        [sys.executable, "-c", program, *files], capture_output=True, text=True, check=True
    )
    *told, used = ended.stdout.splitlines()
    for name, text in zip(MESSAGES, told, strict=True):
        assert re.search(rf"{name}: .*({MESSAGES[name]})", text)
    memory, seconds = map(float, used.split())
    assert memory < 2**30
    assert seconds < 20  # all six; a loaded machine is no excuse, for this is processor time


@pytest.mark.slow
def test_ctrl_c_ends_a_library_that_does_not_answer(sound):
    pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    assert_sound(sound)
    child = process._reader.process
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a job in the background begins without
    begun = processor_seconds(child.pid)

    def interrupt():
        # Then the library is at work, and this process waits for it.
        wait_for(lambda: processor_seconds(child.pid) >= begun + 0.2)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        describe_file(DAMAGED / "endless.c3d")
    assert child.returncode == -signal.SIGKILL
    assert_sound(sound)


def has_ended(process):
    """What ends with its parent takes a moment to do so, and another to be buried."""
    try:
        return "State:\tZ" in Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.mark.slow
def test_sigterm_ends_the_command_and_what_it_started():
    pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    command = [sys.executable, "-m", "tvsysid.cli", "inspect", str(DAMAGED / "endless.c3d")]
    started = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    children = Path(f"/proc/{started.pid}/task/{started.pid}/children")
    wait_for(children.read_text)
    (child,) = children.read_text().split()
    started.terminate()
    started.communicate(timeout=20)
    assert started.returncode
    wait_for(lambda: has_ended(child), 10.0)


@pytest.mark.slow
def test_it_starts_again_after_its_end_and_for_a_fork(sound):
    assert_sound(sound)
    first = process._reader.process
    first.kill()
    first.wait()
    assert_sound(sound)
    process._reader.__init__()  # what a fork does in the new process
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(assert_sound, [sound] * 20))


def test_a_wedged_process_is_ended_by_the_clock(sound, monkeypatch):
    assert_sound(sound)
    os.kill(process._reader.process.pid, signal.SIGSTOP)
    monkeypatch.setattr(process, "PATIENCE", 0.02)
    with pytest.raises(
        tv.InputError, match=r"sound\.npz: reading it took too long, and was stopped"
    ):
        describe_file(sound)


@pytest.mark.slow
def test_paths_are_those_of_the_one_who_asks(sound, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_sound(Path("sound.npz"))
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "inner")
    assert_sound(Path("../sound.npz"))
    strange = Path(os.fsdecode(b"\xff \xe4.npz"))
    sound.rename(strange)
    assert_sound(strange)
    with pytest.raises(tv.InputError, match=r"^missing\.npz: no such file"):
        describe_file("missing.npz")
    os.mkfifo("pipe.npz")
    with pytest.raises(tv.InputError, match=r"^pipe\.npz: expected a file, this is none"):
        describe_file("pipe.npz")


def test_what_inflates_beyond_its_header_is_refused(tmp_path):
    """A vector of ten values, by its header, whose values take two gigabytes by their tag."""
    savemat(tmp_path / "a.mat", {"pos": np.ones(10)})
    content = (tmp_path / "a.mat").read_bytes()
    tag = struct.pack("<II", 9, 80)
    element = zlib.compress(
        content[128:].replace(tag, struct.pack("<II", 9, 2**31)) + bytes(10_000_000)
    )
    (tmp_path / "bomb.mat").write_bytes(
        content[:128] + struct.pack("<II", 15, len(element)) + element
    )
    with pytest.raises(
        tv.InputError,
        match=r"bomb\.mat: reading this file of .* MB takes more memory than there is",
    ):
        describe_file(tmp_path / "bomb.mat")


def test_memory_is_that_of_the_strictest(tmp_path, monkeypatch):
    assert limits.available() > 0
    folder = tmp_path / "v2" / "user" / "job"
    folder.mkdir(parents=True)
    for place, limit in {folder: "max", folder.parent: "1000000"}.items():
        (place / "memory.max").write_text(f"{limit}\n")
        (place / "memory.current").write_text("400000\n")
        (place / "memory.stat").write_text("anon 300000\ninactive_file 100000\n")
    (tmp_path / "own").write_text("0::/user/job\n")
    assert list(limits._control_groups(tmp_path / "v2", tmp_path / "own")) == [700_000]
    old = tmp_path / "v1" / "memory" / "job"
    old.mkdir(parents=True)
    for name, text in {
        "limit_in_bytes": "900",
        "usage_in_bytes": "500",
        "stat": "total_inactive_file 20",
    }.items():
        (old / f"memory.{name}").write_text(text)
    (tmp_path / "own").write_text("3:cpu,cpuacct:/job\n2:memory:/job\n")
    assert list(limits._control_groups(tmp_path / "v1", tmp_path / "own")) == [420]
    monkeypatch.setattr(limits.resource, "getrlimit", lambda _: (limits.addresses() + 10**6, -1))
    assert limits.available() <= 10**6
