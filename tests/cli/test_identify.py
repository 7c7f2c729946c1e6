"""`tvsysid identify`."""

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import loadmat, savemat
from tests import faults
from tests.cli.conftest import IDENTIFY, rows_of

import tvsysid as tv
from tvsysid.methods import DEFAULT_METHODS


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "only_identified")
def test_identify_by_an_own_method(tvsysid, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "plainly.py").write_text(
        "import tvsysid as tv\n"
        "class Mine(tv.Method):\n"
        "    def fit(self, ensemble):\n        return tv.Model.of(ensemble, 80.0)\n"
        "class Faulty(tv.Method):\n    def fit(self, ensemble):\n        return 1 / 0\n"
    )
    tvsysid("simulate joint.mat --duration 40")
    code, out, err = tvsysid(f"identify joint.mat {IDENTIFY} --method plainly:Mine --method sds")
    assert (code, err) == (0, "")
    assert "plainly:Mine" in out
    table = pd.read_csv(tmp_path / "tvsysid-identify" / "stiffness.csv").groupby("method")
    assert set(table.get_group("plainly:Mine").stiffness) == {80.0}
    assert table.get_group("plainly:Mine").inertia.isna().all()
    code, _, err = tvsysid(f"identify joint.mat {IDENTIFY} --method plainly:Faulty")
    assert code == 2
    assert "plainly:Faulty: ZeroDivisionError: division by zero (plainly.py, line 7)" in err
    code, out, err = tvsysid(
        f"identify joint.mat {IDENTIFY} --method plainly:Faulty --method sds --out others"
    )
    assert code == 1
    assert (
        "error: plainly:Faulty failed: ZeroDivisionError: division by zero (plainly.py, line 7)"
        in err
    )
    assert set(pd.read_csv(tmp_path / "others" / "stiffness.csv").method) == {"sds"}


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_what_was_found_is_kept_when_holding_out_is_interrupted(tvsysid, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("tvsysid.comparison.Comparison.held_out_vaf", interrupted)
    tvsysid("simulate joint.mat --duration 40")
    tvsysid(f"identify joint.mat {IDENTIFY} --method birf --out found")
    assert sorted(
        each.name for each in (tmp_path / "found").iterdir() if each.suffix in {".csv", ".nc"}
    ) == [
        "models.nc",
        "stiffness.csv",
    ]
    with xr.open_datatree(tmp_path / "found" / "models.nc", engine="h5netcdf") as tree:
        assert set(tree.children) == {"birf"}


@pytest.mark.slow
def test_simulate_then_identify(tvsysid, tmp_path):
    code, out, _ = tvsysid("simulate joint.mat --duration 60 --perturbation prbs --snr 20")
    assert code == 0
    assert (
        "tvsysid identify joint.mat --angle angle --torque torque --rate 1000 --decimate 100 "
        "--period 2" in out
    )
    code, out, err = tvsysid(
        f"identify joint.mat {IDENTIFY} --method sds --method kbr --out found --sheet",
    )
    assert (code, err) == (0, "")
    assert "28 realizations of 2 s" in out
    assert "diagnosis: no fault found in " in out
    assert "wrote report.html, sheet.html, models.nc" in out
    table = pd.read_csv(tmp_path / "found" / "stiffness.csv")
    assert list(table.columns[:3]) == ["time_s", "method", "stiffness"]
    for method in ("sds", "kbr"):
        found = table[table.method == method]
        truth = np.where((found.time_s >= 0.5) & (found.time_s < 1.5), 150.0, 50.0)
        assert np.sqrt(np.mean((found.stiffness - truth) ** 2)) < 15
        assert found.time_varying_vaf.mean() > 90
    with xr.open_datatree(tmp_path / "found" / "models.nc", engine="h5netcdf") as tree:
        assert set(tree.children) == {"sds", "kbr"}
    assert (tmp_path / "found" / "stiffness.png").stat().st_size > 5000
    assert "tvsysid identify joint" in (tmp_path / "found" / "report.html").read_text()
    code, out, err = tvsysid("report found found --sheet")
    assert (code, out, err) == (0, "wrote sheet.html to found/\n", "")
    assert "2. found" in (tmp_path / "found" / "sheet.html").read_text()
    code, _, err = tvsysid("report found found")
    assert code == 2
    assert "wrote its report already" in tvsysid("report found")[2]
    assert "several folders are visits of one person: add --sheet" in err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
def test_by_default_the_answer_comes_first(tvsysid, tmp_path):
    tvsysid("simulate joint.mat --duration 40")
    code, out, _ = tvsysid(f"identify joint.mat {IDENTIFY}")
    assert code == 0
    _, first, switch, other, between, *table = out.splitlines()
    found = re.fullmatch(
        r"recommended \(adaptive\): stiffness ([\d.]+) to ([\d.]+) N·m/rad, .* band ± [\d.]+", first
    )
    assert [float(each) for each in found.groups()] == pytest.approx([50, 150], abs=5)
    assert switch.startswith("  switch at ")
    assert float(re.search(r"at ([\d.]+) s", other)[1]) == pytest.approx(1.5, abs=0.02)
    assert between.startswith("  smooth change between switches")
    names = [row[0] for row in rows_of("\n".join(table)) if row[0] in DEFAULT_METHODS]
    assert names == list(DEFAULT_METHODS)
    frame = pd.read_csv(tmp_path / "tvsysid-identify" / "stiffness.csv")
    assert list(dict.fromkeys(frame.method)) == list(DEFAULT_METHODS)


def told_with_period(tvsysid, period):
    tvsysid("simulate joint.mat --duration 60")  # of 2 s
    code, out, err = tvsysid(f"identify joint.mat {IDENTIFY} --period {period} --method birf")
    assert code == 0
    return out, err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
def test_a_wrong_period_is_said_right_under_the_answer(tvsysid):
    out, _ = told_with_period(tvsysid, 1.9)
    _, told, *rest = out.splitlines()
    assert told.startswith(
        "no stiffness is stated. The movement does not repeat with this period: stiffness varies "
        "by "
    )
    assert told.endswith("cancel out. Check --period and --rate.")
    assert rest[1].startswith("not valid: stiffness with its band")
    assert not any("not repeat" in line for line in rest)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
@pytest.mark.parametrize(
    ("angle", "torque", "reason", "remedy"),
    [
        ("degrees", "torque", "The movement is too large for radians", "--angle-unit deg."),
        ("torque", "angle", "Angle and torque are probably swapped", "--angle-unit deg."),
        ("angle", "mm", "No joint is so stiff or so soft", "or leave out a unit that is there."),
    ],
)
def test_no_stiffness_is_stated_from_wrong_channels_or_units(
    tvsysid, angle, torque, reason, remedy
):
    tvsysid("simulate joint.mat --duration 40")
    signals = loadmat("joint.mat")
    more = {"degrees": np.degrees(signals["angle"]), "mm": 1000 * signals["torque"]}
    savemat("joint.mat", {"angle": signals["angle"], "torque": signals["torque"]} | more)
    channels = f"--angle {angle} --torque {torque}"
    code, out, _ = tvsysid(f"identify joint.mat {IDENTIFY} {channels} --method adaptive")
    _, told, _, title, *_ = out.splitlines()
    assert code == 0
    assert told.startswith(f"no stiffness is stated. {reason}: ")
    assert told.endswith(remedy)
    assert title.startswith("not valid: stiffness")
    assert "recommended" not in out
    with xr.open_datatree("tvsysid-identify/models.nc", engine="h5netcdf") as tree:
        assert tree.attrs["trust"] == "none"


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
def test_a_command_in_the_file_that_nobody_named_withdraws_the_stiffness(tvsysid):
    joint = tv.simulate.CompliantActuator(tv.simulate.Constant(100.0), noise_bandwidth=5.0)
    recording = joint.simulate(
        80, perturbation=tv.simulate.FilteredNoise(), snr_db=0, seed=1
    ).recording
    signals = {
        "angle": recording.angle,
        "torque": recording.torque,
        "cmd": recording.channels["disturbance"],
    }
    savemat("loop.mat", signals)
    _, out, _ = tvsysid(f"identify loop.mat {IDENTIFY} --method adaptive")
    told = out.splitlines()[1]
    assert told.startswith(
        "no stiffness is stated. Channel 'cmd' moves the angle, and was not named as the "
        "reference: "
    )
    options = told.partition("identify by ")[2].removesuffix(".")
    assert options == "--channel cmd=cmd --method kbr:reference=cmd,weighting=residual"
    _, out, _ = tvsysid(f"identify loop.mat {IDENTIFY} {options}")
    (stiffness,) = (row[1] for row in rows_of(out) if row[0].startswith("kbr:reference"))
    assert float(stiffness) == pytest.approx(100, rel=0.1)
    assert "no stiffness" not in out


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
def test_a_period_twice_too_long_is_noted_once(tvsysid):
    out, err = told_with_period(tvsysid, 4)
    assert (out + err).count("repeats every") == 1
    assert "note: stiffness repeats every 2 s; what does not repeat, " in err


def test_a_high_rate_is_said_before_the_work_begins(tvsysid):
    tvsysid("simulate joint.mat --duration 10")
    _, _, err = tvsysid(
        "identify joint.mat --angle angle --torque torque --rate 1000 --period 99",
    )
    note, *_ = err.splitlines()
    assert note.startswith("note: at 1000 Hz this takes minutes; seconds with --decimate 100")


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "only_identified")
def test_trials_and_degrees(tvsysid, tmp_path):
    tvsysid("simulate joint.mat --duration 60 --snr 30")
    signals = loadmat("joint.mat")
    savemat(
        "trials.mat",
        {
            "angle": np.degrees(signals["angle"].reshape(6, 10_000).T),
            "torque": -signals["torque"].reshape(6, 10_000).T,
        },
    )
    options = "--columns trials --angle-unit deg --torque-sign -1 --method birf"
    code, out, _ = tvsysid(f"identify trials.mat {IDENTIFY} {options}")
    assert code == 0
    assert "18 realizations of 2 s" in out
    table = pd.read_csv(tmp_path / "tvsysid-identify" / "stiffness.csv")
    assert table.stiffness.mean() == pytest.approx(100, abs=3)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_delay_is_corrected_and_said_with_its_effect(tvsysid, tmp_path):
    tvsysid("simulate joint.mat --duration 40 --perturbation prbs --snr 20")
    signals = loadmat(tmp_path / "joint.mat")
    savemat(
        tmp_path / "late.mat", {"angle": signals["angle"], "torque": np.roll(signals["torque"], 3)}
    )
    inertia, said = {}, {}
    for file, options in (
        ("joint.mat", ""),
        ("late.mat", "--no-align-channels"),
        ("late.mat", ""),
    ):
        code, said[file, options], err = tvsysid(
            f"identify {file} {IDENTIFY} --method sds {options}"
        )
        assert (code, err) == (0, "")
        inertia[file, options] = pd.read_csv(
            tmp_path / "tvsysid-identify" / "stiffness.csv"
        ).inertia.mean()
    assert "corrected" not in said["joint.mat", ""] + said["late.mat", "--no-align-channels"]
    late = re.search(
        r"the torque is ([\d.]+) ± [\d.]+ ms late; all of it is corrected: held-out",
        said["late.mat", ""],
    )
    assert float(late[1]) == pytest.approx(3, abs=0.75)  # less is in order
    assert inertia["late.mat", "--no-align-channels"] < 0.7 * inertia["joint.mat", ""]
    assert inertia["late.mat", ""] == pytest.approx(0.02, rel=0.06)
    with xr.open_datatree(tmp_path / "tvsysid-identify" / "models.nc", engine="h5netcdf") as tree:
        assert 1000 * tree["sds"].attrs["delay_removed"] == pytest.approx(float(late[1]), abs=0.01)


@pytest.mark.usefixtures("undrawn", "only_identified")
def test_gaps_and_mains_are_taken_out_and_said(tvsysid, tmp_path):
    recording = faults.gapped(faults.humming(faults.simulated(40.0)))
    savemat(tmp_path / "joint.mat", {"angle": recording.angle, "torque": recording.torque})
    code, out, err = tvsysid(f"identify joint.mat {IDENTIFY} --method sds")
    assert (code, err) == (0, "")
    assert re.search(
        r"both signals .* for 0\.051? s .* 2 times more; realizations with gaps were left out .3.",
        out,
    )
    assert (
        "a line at 50 Hz has 4.9 % of the angle's RMS; mains hum was subtracted from all channels"
        in out
    )
    assert "16 realizations of 2 s" in out
    _, out, _ = tvsysid(f"identify joint.mat {IDENTIFY} --method sds --no-remove-mains")
    assert "mains hum" not in out


@pytest.mark.slow
@pytest.mark.usefixtures("sketched", "only_identified")
def test_identify_with_settings_from_the_data(tvsysid, tmp_path, request):
    tvsysid("simulate joint.mat --duration 40")
    code, out, err = tvsysid(f"identify joint.mat {IDENTIFY} --method birf --method kbr --tune")
    assert (code, err) == (0, "")
    assert (
        "birf: basis=HaarWavelets(functions=4) instead of basis=CubicBSplines(functions=10, "
        "periodic=False): " in out
    )
    folder = tmp_path / "tvsysid-identify"
    table = pd.read_csv(folder / "tuning.csv")
    assert list(table.columns) == [
        "method",
        "settings",
        "criterion",
        "value",
        "unit",
        "standard_error",
        "chosen",
    ]
    for _, rows in table.groupby("method"):
        assert rows.value[rows.chosen].item() == rows.value.max()
    assert (folder / "tuning.png").is_file()
    with xr.open_datatree(folder / "models.nc", engine="h5netcdf") as tree:
        assert (
            tree["birf"]
            .attrs["method"]
            .startswith("BasisIRF(max_lag=0.12, basis=HaarWavelets(functions=4)")
        )
    (again,) = (line for line in out.splitlines() if line.startswith("the same settings again: "))
    kept = pd.read_csv(folder / "stiffness.csv")
    request.getfixturevalue("undrawn")
    code, out, err = tvsysid(f"identify joint.mat {IDENTIFY} {again.partition(': ')[2]}")
    assert (code, err) == (0, "")
    repeated = pd.read_csv(folder / "stiffness.csv")
    np.testing.assert_array_equal(repeated.stiffness, kept.stiffness)
    # As in a study, one method may choose its settings and another not.
    code, out, err = tvsysid(f"identify joint.mat {IDENTIFY} --method birf:tuned=true --method sds")
    assert (code, err) == (0, "")
    assert "the same settings again: --method 'birf:basis=HaarWavelets(functions=4)'\n" in out


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "not_held_out")
def test_a_reflex_that_methods_take_for_stiffness_is_warned_of(tvsysid):
    tvsysid("simulate reflex.mat --system reflex --stiffness constant --duration 40")
    _, _, err = tvsysid(
        f"identify reflex.mat {IDENTIFY} --method sds --method cascade --no-align-channels"
    )
    assert err == "note: the stiffness of sds includes the torque of the reflex\n"
