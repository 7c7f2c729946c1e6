"""`tvsysid experiment`, typed."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import savemat
from tests.cli.conftest import text_of
from tests.study.recorded.conftest import write_trials

import tvsysid as tv

pytestmark = pytest.mark.slow

FILES = """
methods = ["birf", "esm"]
realizations = [10, 20]
bootstraps = 4

[participants.anna]
noise = "trial*.mat"

[participants.bert]
noise = "nobody*.mat"

[reading]
angle = "angle"
torque = "torque"
sampling_rate = 128

[preparation]
reference = false
task_limit = false
residual_limit = false
ends = 1
period = 2
"""


@pytest.mark.usefixtures("sketched")
def test_virtual_participants(tvsysid, tmp_path, request):
    words = "experiment --virtual 1 --perturbation prbs --method birf --realizations 20"
    code, _, err = tvsysid(f"{words} --bootstraps 3 --workers 1")
    assert code == 0
    assert "warning" not in err
    folder = tmp_path / "tvsysid-experiment"
    page = text_of(folder / "report.html")
    assert "tvsysid experiment --virtual 1 --perturbation prbs --method birf" in page
    assert (folder / "diagnosis.html").exists()
    excluded = pd.read_csv(folder / "exclusions.csv")
    assert len(excluded) == 300
    kept = excluded.excluded_by.isna()
    assert len(tv.recordings.load_ensemble(folder / "prepared" / "P1-prbs.nc")) == kept.sum()
    figures = {file.name for file in (folder / "figures").iterdir()}
    assert {"participant.png", "preparation.pdf", "recorded-signals.svg"} <= figures
    with xr.open_dataset(folder / "results.nc") as results:
        assert results.estimate.sel(quantity="stiffness").shape == (1, 1, 3, 256)
    names = ("summary.csv", "claims.csv", "answers.csv")
    tables = {name: (folder / name).read_bytes() for name in names}
    for name in names[:2]:
        (folder / name).unlink()
    request.getfixturevalue("undrawn")
    assert tvsysid(f"report {folder}")[0] == 0
    assert {name: (folder / name).read_bytes() for name in tables} == tables


@pytest.mark.usefixtures("undrawn")
def test_files_of_which_some_cannot_be_used(tvsysid, tmp_path):
    write_trials(tmp_path)
    savemat(tmp_path / "trial3.mat", {"angle": np.zeros(3000)})
    (tmp_path / "study.toml").write_text(FILES)
    code, _, err = tvsysid("experiment study.toml --out found")
    # What could not be done makes the exit code 1, and what could is there.
    assert code == 1
    assert "anna-noise: trial3.mat is left out: no channel 'torque'; the file holds angle" in err
    assert "bert-noise: nobody*.mat is left out: no such file" in err
    assert "bert-noise: no trial can be used" in err
    table = pd.read_csv(tmp_path / "found" / "stiffness.csv").dropna(subset="stiffness")
    assert set(table.participant) == {"anna"}
    assert table.stiffness.mean() == pytest.approx(80, rel=0.1)
    page = (tmp_path / "found" / "report.html").read_text()
    assert "trial3.mat is left out" in page
    # Again, what was done is not done twice.
    code, _, err = tvsysid("experiment study.toml --out found --workers 1")
    assert code == 1
    assert "resuming: 8 of 8 tasks are done already" in err


def test_a_virtual_participants_file_is_what_the_study_reads(tvsysid, tmp_path):
    code, out, _ = tvsysid("simulate P3-prbs.mat --participant 3 --perturbation prbs")
    assert code == 0
    (tmp_path / "study.toml").write_text(out.split("put this into study.toml:")[1])
    experiment = tv.study.Experiment.from_toml(tmp_path / "study.toml")
    (prepared,) = tv.study.prepared_recordings(experiment)
    virtual = tv.study.Experiment(virtual=3, perturbation="prbs")
    (expected,) = tv.study.prepared_recordings(virtual)
    np.testing.assert_array_equal(prepared.ensemble.torque, expected.ensemble.torque)
    assert tvsysid("simulate P3.csv --participant 3")[0] == 2
