"""What tests share: simulated ensembles, and where the real recordings are."""

import gc
import os
import shlex
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401
from hypothesis import given, settings
from hypothesis.strategies import none
from tests.drawing import sketches
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.models import IMPEDANCE

# Threads would only wait for each other, here and in processes that tests start.
threadpool_limits(1)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=25)
settings.load_profile("repeatable")


def pytest_collection_finish():
    """Freeze what is loaded: repeated garbage collection takes a tenth of the tests' time."""
    given(none())(lambda _: None)()  # Hypothesis looks once for what refers to its random numbers
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)


def realizations(recording, period=2.0, *settings):
    """Return realizations of a recording at 100 Hz."""
    return tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period, *settings)


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
    """Return a simulated ensemble at 100 Hz, made once for each set of arguments."""
    simulation = tv.simulate.Joint(stiffness=tv.simulate.PROFILES[profile]).simulate(
        duration, perturbation=tv.simulate.PERTURBATIONS[perturbation], snr_db=snr_db, seed=seed
    )
    return realizations(simulation.recording, period, context)


def standard_errors_of(model):
    """Standard errors of stiffness, viscosity and inertia, shape (3, time)."""
    return np.stack([model.estimates[name].standard_error.values for name in IMPEDANCE])


def wait_for(condition, seconds=300.0):
    """Until it is true, as of a process that somebody started or ended."""
    ends = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < ends, "waited in vain"
        time.sleep(0.01)


@pytest.fixture
def tvsysid(monkeypatch, capsys, tmp_path):
    """Run words, or one text, as a command in a new folder. Return exit code, output and errors."""
    from tvsysid import cli
    from tvsysid.cli.console import errors, output

    monkeypatch.chdir(tmp_path)
    # An installed command has no current folder in its path
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    monkeypatch.setenv("COLUMNS", "200")
    for console in (output, errors):
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
    for module in ("published_study", "van_de_ruit_2021.experiment"):
        monkeypatch.setattr(f"tvsysid.studies.{module}.draw_all", lambda *given: {})
    for module in ("report.folder", "figures"):
        monkeypatch.setattr(f"tvsysid.{module}.save", lambda figure, file: None)
    diagnosis = "studies.van_de_ruit_2021.experiment.write_diagnosis"
    for writer in (diagnosis, "report.folder.write_identification"):
        monkeypatch.setattr(f"tvsysid.{writer}", lambda *given, **_: None)


@pytest.fixture
def sketched():
    """Write empty figures: other tests look at what is in them."""
    with sketches():
        yield


@pytest.fixture
def random():
    return np.random.default_rng(12345)


SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture(scope="session")
def recordings_folder() -> Path:
    folder = Path(os.environ.get("TVSYSID_DATA", SHARED / "data"))
    if not (folder / "tonic_ankle.mat").exists():
        pytest.skip(f"real recordings are not at {folder}; set TVSYSID_DATA to where they are")
    return folder


def _reference(name: str) -> dict[str, np.ndarray]:
    if not (file := SHARED / "oracle" / name).exists():
        pytest.skip(f"reference outputs are not at {file}")
    return dict(np.load(file, allow_pickle=False))


@pytest.fixture(scope="session")
def reference():
    """Outputs of the methods' authors' own code, and the data they were made from."""
    return _reference("ensemble_noise_150s.npz")


@pytest.fixture(scope="session")
def parallel_reference():
    """Outputs of the authors' own code for two pathways, on the tonic ankle records."""
    return _reference("parallel_cascade_tonic_ankle.npz")
