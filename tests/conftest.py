"""What tests share: simulated ensembles, and where the real recordings are."""

import gc
import os
import shlex
import shutil
import signal
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401
from hypothesis import given, settings
from hypothesis.strategies import none
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.models import IMPEDANCE

# Small matrices: threads would only wait for each other, in this process (which has loaded SciPy's
# BLAS by now) and in
# those that tests start.
threadpool_limits(1)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What tests start finds its modules compiled, also where nobody else may keep them so.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Studies write thousands of small files, each synchronized with its disk: less work where files
# live in memory.
MEMORY = "/dev/shm"
if os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > 2 * 2**30:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", MEMORY)
    os.environ.setdefault("TMPDIR", MEMORY)
    tempfile.tempdir = None  # it may have been asked for already

settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=25)
settings.load_profile("repeatable")


def pytest_collection_finish():
    """Freeze what is loaded: repeated garbage collection takes a tenth of the tests' time."""
    given(none())(
        lambda _: None
    )()  # Hypothesis 6.100 looks for what refers to its random numbers, once
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)


@cache
def ensemble_of(
    duration: float = 40.0,
    profile: str = "sine",
    perturbation: str = "noise",
    snr_db: float = 10.0,
    seed: int = 0,
    context: float = 0.5,
    period: float = 2.0,
) -> tv.Ensemble:
    simulation = tv.simulate.Joint(stiffness=tv.simulate.PROFILES[profile]).simulate(
        duration, perturbation=tv.simulate.PERTURBATIONS[perturbation], snr_db=snr_db, seed=seed
    )
    return tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period, context)


def standard_errors_of(model):
    """Standard errors of stiffness, viscosity and inertia, shape (3, time)."""
    return np.stack([model.estimates[name].standard_error.values for name in IMPEDANCE])


def freedom_of(model):
    """Degrees of freedom of the standard errors, shape (3, time)."""
    return np.stack([model.estimates[name].standard_error.freedom for name in IMPEDANCE])


def wait_for(condition, seconds=300.0):
    """Until it is true, as of a process that somebody started or ended."""
    ends = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < ends, "waited in vain"
        time.sleep(0.01)


@pytest.fixture(name="ensemble_of")
def ensemble_of_fixture():
    """Simulated ensemble at 100 Hz; made once for each set of arguments."""
    return ensemble_of


@pytest.fixture(autouse=True)
def _signals():
    """The command line handles SIGTERM, here in the tests' own process."""
    kept = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, kept)


@pytest.fixture
def tvsysid(monkeypatch, capsys, tmp_path):
    """Run the command line in this process, in a folder of its own.

    Takes words, or all of them in one text. Returns exit code, output and errors.
    """
    from tvsysid import cli
    from tvsysid.cli.console import errors, output

    monkeypatch.chdir(tmp_path)
    # An installed command has no current folder in its path
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    monkeypatch.setenv("COLUMNS", "200")
    for console in (output, errors):  # made before, they have read another width
        monkeypatch.setattr(console, "width", 200)

    def command(*words):
        if len(words) == 1:
            words = shlex.split(words[0])
        monkeypatch.setattr(sys, "argv", ["tvsysid", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        captured = capsys.readouterr()
        return stopped.value.code, captured.out, captured.err

    return command


@pytest.fixture
def undrawn(monkeypatch):
    """Without figures, which take most of the time; other tests have them."""
    monkeypatch.setattr("tvsysid.studies.published_study.draw_all", lambda *given: {})
    diagnosis = "tvsysid.studies.van_de_ruit_2021.folder.write_diagnosis"
    monkeypatch.setattr(diagnosis, lambda *given: None)
    for module in ("report.folder", "figures"):
        monkeypatch.setattr(f"tvsysid.{module}.save", lambda figure, file: None)
    monkeypatch.setattr("tvsysid.report.folder.write_identification", lambda *given, **_: None)


@cache
def _empty_figure():
    from matplotlib.figure import Figure

    from tvsysid.figures.saving import drawn

    return {ending: drawn(Figure((3, 2)), ending) for ending in ("svg", "pdf", "png")}


@pytest.fixture
def sketched(monkeypatch):
    """Each file of a figure is that of an empty one: other tests look at what is in them."""
    from tvsysid.figures import saving

    empty = _empty_figure()
    monkeypatch.setattr(saving, "drawn", lambda figure, format: empty[format])


@pytest.fixture(scope="module")
def brief_cases():
    """Halve the joints that `check_method` simulates: as much is expected, of fewer data."""
    from tvsysid import check

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "DURATION_S", check.DURATION_S / 2)
        yield


@pytest.fixture
def random():
    return np.random.default_rng(12345)


def _shared(name: str) -> Path:
    if name == "data" and "TVSYSID_DATA" in os.environ:
        return Path(os.environ["TVSYSID_DATA"])
    return Path(__file__).parents[2] / "shared" / name


@pytest.fixture(scope="session")
def recordings_folder() -> Path:
    folder = _shared("data")
    if not (folder / "tonic_ankle.mat").exists():
        pytest.skip(f"real recordings are not at {folder}; set TVSYSID_DATA to where they are")
    return folder


def _reference(name: str) -> dict[str, np.ndarray]:
    file = _shared("oracle") / name
    if not file.exists():
        pytest.skip(f"reference outputs are not at {file}")
    with np.load(file, allow_pickle=False) as arrays:
        return dict(arrays)


@pytest.fixture(scope="session")
def reference():
    """Outputs of the methods' authors' own code, and the data they were made from."""
    return _reference("ensemble_noise_150s.npz")


@pytest.fixture(scope="session")
def parallel_reference():
    """Outputs of the authors' own code for two pathways, on the tonic ankle records."""
    return _reference("parallel_cascade_tonic_ankle.npz")
