"""`tvsysid identify`."""

import re
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import savemat
from tests.cli.conftest import IDENTIFY, rows_of

import tvsysid as tv
from tvsysid.methods import PAPER_METHODS


@pytest.fixture
def identify(tvsysid):
    """Identify a file; return exit code, output and errors."""
    return lambda options="", file="joint.mat": tvsysid(f"identify {file} {IDENTIFY} {options}")


def written(folder="tvsysid-identify"):
    return pd.read_csv(f"{folder}/stiffness.csv")


def models(folder="tvsysid-identify"):
    return xr.open_datatree(f"{folder}/models.nc", engine="h5netcdf")


@pytest.mark.slow
def test_simulate_then_identify(tvsysid, tmp_path):
    _, out, _ = tvsysid("simulate joint.mat --duration 60 --perturbation prbs --snr 20")
    command = out.splitlines()[1]
    code, out, err = tvsysid(f"{command[8:]} --method sds --method kbr --out found --sheet")
    assert (code, err) == (0, "")
    assert "28 realizations of 2 s" in out
    assert "diagnosis: no fault found (" in out
    assert "wrote report.html, sheet.html, models.nc" in out
    for _, found in written("found").groupby("method"):
        truth = np.where((found.time_s >= 0.5) & (found.time_s < 1.5), 150.0, 50.0)
        assert np.sqrt(np.mean((found.stiffness - truth) ** 2)) < 15
    with models("found") as tree:
        assert set(tree.children) == {"sds", "kbr"}
    assert (tmp_path / "found" / "stiffness.png").stat().st_size > 5000
    assert "tvsysid identify joint" in (tmp_path / "found" / "report.html").read_text()
    assert tvsysid("report found found --sheet") == (0, "wrote sheet.html to found/\n", "")
    for command, message in (
        ("report found found", "several folders are visits of one person: add --sheet"),
        ("report found", "no results of `tvsysid benchmark` or `experiment`"),
    ):
        code, _, err = tvsysid(command)
        assert code == 2
        assert message in err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out", "joint")
def test_by_default_the_answer_comes_first(identify):
    code, out, _ = identify()
    assert code == 0
    first, *lines = out.splitlines()
    found = re.fullmatch(
        r"recommended \(adaptive\): stiffness ([\d.]+) to ([\d.]+) N·m/rad, .* band ± [\d.]+", first
    )
    assert [float(each) for each in found.groups()] == pytest.approx([50, 150], abs=5)
    assert max(map(len, lines[: lines.index("") + 5])) <= 80
    assert any(line.startswith("switch at ") for line in lines)
    assert tuple(written().method.unique()) == ("adaptive", "sds")
    assert identify("--method published")[0] == 0
    assert tuple(written().method.unique()) == PAPER_METHODS


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
@pytest.mark.parametrize(
    ("options", "reason", "remedy"),
    [
        ("--angle degrees", "The angle is too large for radians", "--angle-unit deg"),
        ("--angle torque --torque angle", "Stiffer or softer than any joint", "--angle, --torque"),
        ("--torque mm", "Stiffer or softer than any joint", "--torque-unit Nmm"),
        ("--period 1.9", "The movement does not repeat with this", "Cut with the period"),
    ],
)
def test_no_stiffness_is_stated_from_data_that_make_it_wrong(
    identify, joint, options, reason, remedy
):
    savemat(
        "joint.mat",
        joint | {"degrees": np.degrees(joint["angle"]), "mm": 1000 * joint["torque"]},
    )
    code, out, _ = identify(f"{options} --method adaptive")
    assert code == 0
    first = out.splitlines()[0]
    assert first.startswith(f"no stiffness is stated. {reason}")
    assert remedy in first
    assert "\nnot valid: stiffness" in out
    assert "recommended" not in out
    with models() as tree:
        assert tree.attrs["trust"] == "none"


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
def test_a_command_in_the_file_that_nobody_named_withdraws_the_stiffness(identify):
    system = tv.simulate.CompliantActuator(tv.simulate.Constant(100.0), noise_bandwidth=5.0)
    recording = system.simulate(
        80, perturbation=tv.simulate.FilteredNoise(), snr_db=0, seed=1
    ).recording
    command = recording.channels["disturbance"]
    savemat("joint.mat", {"angle": recording.angle, "torque": recording.torque, "cmd": command})
    _, out, _ = identify("--method adaptive")
    first = out.splitlines()[0]
    assert first.startswith("no stiffness is stated. Channel 'cmd' moves the angle, and was not ")
    options = first.partition("identify by ")[2].removesuffix(".")
    assert options == "--channel cmd=cmd --method kbr:reference=cmd,weighting=residual"
    _, out, _ = identify(options)
    (stiffness,) = (row[1] for row in rows_of(out) if row[0] == options[-36:-6])
    assert float(stiffness) == pytest.approx(100, rel=0.1)
    assert "no stiffness" not in out


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_delay_is_corrected_and_said_with_its_effect(identify, joint):
    savemat("joint.mat", joint | {"torque": np.roll(joint["torque"], 3)})
    inertia = []
    for option in ("--no-align-channels", ""):
        code, out, err = identify(f"--method sds {option}")
        assert (code, err) == (0, "")
        assert ("corrected" in out) == (not option)
        inertia.append(written().inertia.mean())
    delay = re.search(r"the torque is ([\d.]+) ± [\d.]+ ms late; all of it is corrected", out)
    assert float(delay[1]) == pytest.approx(3, abs=0.75)  # less is in order
    assert inertia[0] < 0.7 * inertia[1]
    assert inertia[1] == pytest.approx(0.02, rel=0.1)
    with models() as tree:
        assert 1000 * tree["sds"].attrs["delay_removed"] == pytest.approx(float(delay[1]), abs=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("sketched", "only_identified", "joint")
def test_settings_from_the_data(identify, tmp_path, request):
    code, out, err = identify("--method birf --method kbr --tune")
    assert (code, err) == (0, "")
    assert "birf: basis=HaarWavelets(functions=4) instead of basis=CubicBSplines(func" in out
    for _, rows in pd.read_csv("tvsysid-identify/tuning.csv").groupby("method"):
        assert rows.value[rows.chosen].item() == rows.value.max()
    assert (tmp_path / "tvsysid-identify" / "tuning.png").is_file()
    (again,) = (line for line in out.splitlines() if line.startswith("to repeat these settings: "))
    tuned = written()
    request.getfixturevalue("undrawn")
    assert identify(again.partition(": ")[2])[0] == 0
    np.testing.assert_array_equal(written().stiffness, tuned.stiffness)


@pytest.mark.slow
@pytest.mark.usefixtures("sketched", "only_identified", "joint")
def test_a_folder_of_recordings_is_one_table_and_one_page(tvsysid, tmp_path):
    folder = tmp_path / "people"
    folder.mkdir()
    for name in ("anna.mat", "bert.mat"):
        shutil.copy("joint.mat", folder / name)
    (folder / "notes.csv").write_text("age\n30\n")
    tvsysid(f"inspect people/anna.mat {IDENTIFY} --save")
    code, out, err = tvsysid("identify people --method sds")
    assert code == 1
    assert err.splitlines()[-1] == "error: notes.csv: no channel 'angle'; the file holds age (1)"
    assert [row[:2] for row in rows_of(out)[-3:-1]] == [["anna.mat", "sds"], ["bert.mat", "sds"]]
    page = (tmp_path / "tvsysid-identify" / "report.html").read_text()
    assert "Stiffness of 2 recordings" in page
    assert 'href="anna.mat/report.html"' in page
    assert page.count("<figure") == 2
    assert written("tvsysid-identify/bert.mat").stiffness.mean() == pytest.approx(100, rel=0.1)
