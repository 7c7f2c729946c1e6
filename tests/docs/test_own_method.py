"""What the page on a method of one's own says is so."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.docs.pages import blocks

import tvsysid as tv

PAGE = "own-method.md"
METHOD, SCRIPT, SCHEDULED = blocks(PAGE)
CHECK, BENCHMARK = blocks(PAGE, "")
PACKAGE = Path(tv.__file__).parents[1]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "mymethod.py").write_text(METHOD, encoding="utf-8")
    for name in ("mymethod", "scheduled"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def words_of(command):
    name, *words = command.split()
    assert name == "tvsysid"
    return words


@pytest.mark.slow
def test_the_method_passes_as_the_page_shows(tvsysid, folder):
    code, out, err = tvsysid(*words_of(CHECK))
    assert code == 0, out + err
    (shown,) = blocks(PAGE, "text")
    for line, said in zip(out.splitlines(), shown.splitlines(), strict=True):
        # The figures may differ in their last digit from one machine to another.
        assert re.sub(r"\d+(\.\d+)?", "#", line) == re.sub(r"\d+(\.\d+)?", "#", said)
        assert "✗" not in line


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_method_is_in_the_benchmark(tvsysid, folder):
    command = re.sub(r"--trials \d+", "--trials 2", BENCHMARK)
    code, out, err = tvsysid(
        *words_of(command), "--duration", "40", "--perturbation", "noise", "--workers", "1"
    )
    assert code == 0, out + err
    table = pd.read_csv(folder / "sliding" / "summary.csv")
    total = table[table.metric == "total_error"].set_index("method").value
    assert set(total.index) == {"sds", "mymethod:SlidingFit"}
    assert total["mymethod:SlidingFit"] < total["sds"]


@pytest.mark.slow
def test_the_script_compares_the_object(folder):
    """In a Python of its own, which starts a worker for the only trial."""
    script = SCRIPT.replace("trials=5", 'trials=1, duration_s=[40], perturbation=["noise"]')
    assert script != SCRIPT
    (folder / "compare.py").write_text(script, encoding="utf-8")
    variables = {
        "PYTHONPATH": str(PACKAGE),
        "PYTHONIOENCODING": "utf-8",
        "OPENBLAS_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, "compare.py"],
        cwd=folder,
        env=os.environ | variables,
        capture_output=True,
        encoding="utf-8",
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "SlidingFit(window=0.1)" in done.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_method_that_reads_a_channel(tvsysid, folder):
    (folder / "scheduled.py").write_text(SCHEDULED, encoding="utf-8")
    commands, benchmark = blocks(PAGE, "sh")
    check, *others = [
        *commands.splitlines(),
        f"{benchmark} --trials 1 --duration 20 --perturbation noise --workers 1",
    ]
    code, out, err = tvsysid(*words_of(check))
    assert code == 0, out + err
    assert "✗" not in out
    assert "identifies a joint: from angle, torque, emg of" in out
    for command in others:
        code, out, err = tvsysid(*words_of(command))
        assert code == 0, out + err
    table = pd.read_csv(folder / "scheduled" / "summary.csv")
    scored = table[table.metric == "total_error"]
    assert set(scored.method) == {"scheduled:ScheduledFit", "sds"}
    assert np.isfinite(scored.value).all()
    with xr.open_datatree(folder / "tvsysid-identify" / "models.nc") as tree:
        stored = tree["scheduled:ScheduledFit"].to_dataset().load()
    assert stored.stiffness.dims == ("realization", "time")
    assert stored.stiffness_at_emg.dims == ("emg",)
    # The joint that is simulated has 20 + 200 x EMG, in N·m/rad.
    np.testing.assert_allclose(stored.stiffness_at_emg, 20 + 200 * stored.emg, atol=10)
    assert stored.torque_intrinsic.dims == ("realization", "time")
