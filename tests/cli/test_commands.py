import shlex
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr


@pytest.fixture
def undrawn(monkeypatch):
    """Without the figures of a study, which take most of the time; test_benchmark has them."""
    monkeypatch.setattr("tvsysid.studies.van_de_ruit_2021.study_figures", lambda results, summary, responses=None: {})


IDENTIFY = ("--angle", "angle", "--torque", "torque", "--rate", 1000, "--decimate", 100, "--period", 2)


@pytest.mark.slow
def test_benchmark(tvsysid, tmp_path, request):
    code, out, err = tvsysid(
        "benchmark", "--trials", 2, "--duration", 60, "--method", "sds", "--method", "esm:window=0.4", "--workers", 1
    )
    assert (code, err) == (0, "")
    assert "square wave, filtered noise, 60 s, 10 dB, 2 trials" in out
    assert "esm:window=0.4" in out
    assert "simulated s per s" in out
    folder = tmp_path / "tvsysid-benchmark"
    table = pd.read_csv(folder / "summary.csv")
    assert list(table.columns[:8]) == [
        "stiffness", "perturbation", "duration_s", "snr_db", "method", "trials", "metric", "value",
    ]  # fmt: skip
    assert set(table.perturbation) == {"noise", "prbs"}
    assert set(table.method) == {"sds", "esm:window=0.4"}
    assert xr.open_zarr(folder / "results.zarr").stiffness.sizes["trial"] == 2
    assert set(pd.read_csv(folder / "claims.csv").verdict) <= {"holds", "does not hold", "undecided", "not studied"}
    for ending in ("png", "pdf", "svg"):
        for perturbation in ("noise", "prbs"):
            assert (folder / "figures" / f"comparison-square-{perturbation}.{ending}").stat().st_size > 5000
        assert (folder / "figures" / f"coverage-square.{ending}").stat().st_size > 5000
    page = (folder / "report.html").read_text()
    assert "esm:window=0.4" in page
    assert "tvsysid benchmark --trials 2 --duration 60 --method sds --method esm:window=0.4 --workers 1" in page
    before = (folder / "summary.csv").read_text()
    for name in ("summary.csv", "report.html"):
        (folder / name).unlink()
    request.getfixturevalue("undrawn")
    code, out, err = tvsysid("report", folder)
    assert (code, err) == (0, "")
    assert (folder / "summary.csv").read_text() == before
    assert (folder / "report.html").exists()


def test_a_dry_run_runs_nothing(tvsysid, tmp_path):
    code, out, _ = tvsysid("benchmark", "--preset", "paper", "--trials", 4, "--method", "birf", "--dry-run")
    assert code == 0
    assert "4 trials of each of 12 scenarios, seed 0: 48 trials, 10,560 s of data" in out
    assert "nothing was run" in out
    assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("undrawn")
def test_a_study_from_a_file_with_options_in_its_place(tvsysid, tmp_path):
    (tmp_path / "study.toml").write_text('duration_s = 40\nperturbation = "prbs"\nmethods = "birf"\ntrials = 9\n')
    code, _, _ = tvsysid("benchmark", "study.toml", "--trials", 2, "--workers", 1, "--out", "out")
    assert code == 0
    table = pd.read_csv(tmp_path / "out" / "summary.csv")
    assert (set(table.perturbation), set(table.duration_s), set(table.trials)) == ({"prbs"}, {40.0}, {2})


def test_identify_by_an_own_method(tvsysid, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "plainly.py").write_text(
        "import numpy as np\n"
        "class Model:\n"
        "    def __init__(self, stiffness):\n        self.stiffness = stiffness\n"
        "    def predict(self, ensemble):\n        return self.stiffness * ensemble.angle[:, ensemble.core]\n"
        "class Mine:\n"
        "    def identify(self, ensemble):\n        return Model(np.full(ensemble.samples, 80.0))\n"
        "class Faulty:\n    def identify(self, ensemble):\n        return 1 / 0\n"
    )
    tvsysid("simulate", "joint.mat", "--duration", 40)
    code, out, err = tvsysid("identify", "joint.mat", *IDENTIFY, "--method", "plainly:Mine", "--method", "sds")
    assert (code, err) == (0, "")
    assert "plainly:Mine" in out
    table = pd.read_csv(tmp_path / "tvsysid-identify" / "stiffness.csv").groupby("method")
    assert set(table.get_group("plainly:Mine").stiffness) == {80.0}
    assert table.get_group("plainly:Mine").inertia.isna().all()
    code, _, err = tvsysid("identify", "joint.mat", *IDENTIFY, "--method", "plainly:Faulty")
    assert code == 2
    assert "method plainly:Faulty: ZeroDivisionError: division by zero (plainly.py, line 12)" in err


@pytest.mark.usefixtures("undrawn")
def test_an_own_method_that_fails_is_told_and_the_others_are_kept(tvsysid, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "faulty.py").write_text(
        "class Mine:\n    def identify(self, ensemble):\n        raise KeyError('no key')\n"
    )
    words = ("--duration", 40, "--perturbation", "prbs", "--trials", 2, "--method", "sds", "--workers", 1)
    code, _, err = tvsysid("benchmark", *words, "--method", "faulty:Mine")
    assert code == 1
    assert "error: faulty:Mine: 2 of 2 trials failed and are left out; the first: KeyError: 'no key'" in err
    assert "faulty.py" in err
    table = pd.read_csv(tmp_path / "tvsysid-benchmark" / "summary.csv").set_index(["method", "metric"]).value
    assert table["faulty:Mine", "failed"] == 2
    assert table["sds", "failed"] == 0
    assert np.isfinite(table["sds", "bias_error"])


@pytest.mark.usefixtures("undrawn")
def test_the_same_seed_gives_the_same_table(tvsysid, tmp_path):
    def values(folder, *words):
        options = ("--trials", 2, "--duration", 40, "--method", "birf", "--perturbation", "prbs", "--workers", 1)
        assert tvsysid("benchmark", *options, "--out", folder, *words)[0] == 0
        table = pd.read_csv(tmp_path / folder / "summary.csv")
        return table[table.metric != "seconds"].value.to_numpy()

    np.testing.assert_array_equal(values("one"), values("two"))
    assert not np.array_equal(values("one"), values("three", "--seed", 7))


@pytest.mark.usefixtures("undrawn")
def test_doubts_in_a_benchmark_are_told(tvsysid):
    code, _, err = tvsysid("benchmark", "--trials", 2, "--duration", 40, "--method", "eirf", "--workers", 1)
    assert code == 0
    assert "warning: eirf: " in err
    assert "fewer than the 25 lags" in err


@pytest.mark.parametrize("name", ["joint.mat", "joint.csv"])
def test_simulate_then_identify(tvsysid, tmp_path, name):
    code, out, _ = tvsysid("simulate", name, "--duration", 60, "--perturbation", "prbs", "--snr", 20)
    assert code == 0
    assert f"tvsysid identify {name} --angle angle --torque torque --rate 1000 --decimate 100 --period 2" in out
    code, out, err = tvsysid("identify", name, *IDENTIFY, "--method", "sds", "--method", "kbr", "--out", "found")
    assert (code, err) == (0, "")
    assert "28 realizations of 2 s" in out
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


def test_reversed_torque_warns_in_one_line(tvsysid):
    tvsysid("simulate", "joint.mat", "--duration", 60)
    code, _, err = tvsysid("identify", "joint.mat", *IDENTIFY, "--torque-sign", -1, "--method", "sds")
    assert code == 0
    assert err.count("\n") == 1
    assert "warning: sds: stiffness is negative at" in err


def test_trials_and_degrees(tvsysid, tmp_path):
    tvsysid("simulate", "joint.mat", "--duration", 60, "--snr", 30)
    from scipy.io import loadmat, savemat

    signals = loadmat("joint.mat")
    savemat(
        "trials.mat",
        {
            "angle": np.degrees(signals["angle"].reshape(6, 10_000).T),
            "torque": -signals["torque"].reshape(6, 10_000).T,
        },
    )
    options = ("--columns", "trials", "--angle-unit", "deg", "--torque-sign", -1, "--method", "birf")
    code, out, _ = tvsysid("identify", "trials.mat", *IDENTIFY, *options)
    assert code == 0
    assert "18 realizations of 2 s" in out
    table = pd.read_csv(tmp_path / "tvsysid-identify" / "stiffness.csv")
    assert table.stiffness.mean() == pytest.approx(100, abs=3)


def test_inspect_lists_and_draws(tvsysid, tmp_path):
    tvsysid("simulate", "joint.mat", "--duration", 4)
    code, out, err = tvsysid("inspect", "joint.mat")
    assert (code, err) == (0, "")
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    assert ["angle", "4000 x 1", "float64", "-", "1000"] in rows
    assert ["sampling_rate", "1 x 1", "float64", "-", "-"] in rows
    assert "wrote tvsysid-inspect/joint.mat.png" in out
    assert (tmp_path / "tvsysid-inspect" / "joint.mat.png").stat().st_size > 5000
    assert tvsysid("inspect", "joint.mat", "--plot", "deep/joint.svg")[0] == 0
    assert "torque" in (tmp_path / "deep" / "joint.svg").read_text()


@pytest.mark.slow
def test_inspect_diagnoses(tvsysid, tmp_path):
    tvsysid("simulate", "joint.mat", "--duration", 100)
    code, out, err = tvsysid("inspect", "joint.mat", "--diagnose", *IDENTIFY)
    assert (code, err) == (0, "")
    assert "joint.mat (angle, torque): 48 realizations of 2 s at 1000 Hz: no fault found in 28 checks" in out
    assert "not judged: mean-torque, mean-angle (the mean over realizations has been subtracted)" in out
    assert "wrote tvsysid-inspect/joint.mat.angle-torque.diagnosis.html" in out
    page = (tmp_path / "tvsysid-inspect" / "joint.mat.angle-torque.diagnosis.html").read_text()
    assert "tvsysid inspect joint.mat --diagnose --angle angle" in page
    assert "Diagnosis of joint.mat (angle, torque)" in page
    code, out, err = tvsysid("inspect", "joint.mat", "--diagnose", *IDENTIFY, "--torque-sign", "-1", "--period", "1.9")
    assert (code, err) == (0, "")
    assert "reversed-torque (-" in out
    assert "remedy: read the file with torque_sign=-1 (--torque-sign -1)" in out
    assert "wrong-period (" in out
    assert "stiffness varies by" in out


def test_inspect_of_a_file_with_many_channels_and_none(tvsysid):
    np.savez("many.npz", note=np.array("[red]hello"), **{f"c{number}": np.ones((3, 2)) for number in range(14)})
    code, out, err = tvsysid("inspect", "many.npz")
    assert (code, err) == (0, "note: 2 more channels are not drawn\n")
    assert "text" in out
    np.savez("none.npz", note=np.array("hello"))
    assert "no signals to draw" in tvsysid("inspect", "none.npz")[1]


def test_identify_takes_other_formats(tvsysid, tmp_path):
    tvsysid("simulate", "joint.mat", "--duration", 60)
    from scipy.io import loadmat

    signals = loadmat("joint.mat")
    xr.Dataset({name: ("time", signals[name].ravel()) for name in ("angle", "torque")}).to_netcdf(
        "joint.nc", engine="h5netcdf"
    )
    code, out, err = tvsysid("identify", "joint.nc", *IDENTIFY, "--method", "birf")
    assert (code, err) == (0, "")
    assert "28 realizations of 2 s" in out


def test_methods_are_listed_with_what_they_assume(tvsysid):
    code, out, _ = tvsysid("methods")
    assert code == 0
    for words in ("eirf", "sds", "birf", "esm", "kbr", "max_lag = 0.12", "same in all realizations", "nearly periodic"):
        assert words in out


def test_installed_methods_are_listed_whatever_is_wrong_with_them(tvsysid, tmp_path, monkeypatch):
    info = tmp_path / "mypackage-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mypackage\nVersion: 1.0\n")
    points = "good = listed_module:Good\nbad = listed_module:Bad\nsds = listed_module:Good\n"
    (info / "entry_points.txt").write_text(f"[tvsysid.methods]\n{points}")
    (tmp_path / "listed_module.py").write_text(
        "class Good:\n"
        "    title = 'Good [red]method'\n"
        "    def __init__(self, order, gain=2.5): ...\n"
        "    def identify(self, ensemble): ...\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    code, out, err = tvsysid("methods")
    assert code == 0
    for words in ("Good [red]method", "order (must be given)", "gain = 2.5", "has no 'Bad'", "Short data segments"):
        assert words in out
    assert err.startswith("note: 'sds' is offered by the installed package mypackage too")


OWN = """
from dataclasses import dataclass

import numpy as np


@dataclass
class Constant:
    sign: float = 1.0

    def identify(self, ensemble):
        angle, torque = ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]
        self.stiffness = np.full(ensemble.samples, self.sign * np.sum(angle * torque) / np.sum(angle * angle))
        return self
"""


@pytest.fixture
def search_path(monkeypatch):
    """The path as it is for an installed command, which does not search the current folder by itself."""
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])


@pytest.mark.usefixtures("search_path")
def test_check_method_says_what_is_wrong(tvsysid, tmp_path):
    (tmp_path / "own_for_cli.py").write_text(OWN)
    code, out, err = tvsysid("check-method", "own_for_cli:Constant")
    assert (code, err) == (1, "")
    assert "✓ identifies a joint" in out
    assert "✗ returns a model: expected a model with stiffness and predict(ensemble), " in out
    assert "without predict(ensemble)" in out
    assert "✗ predicts the torque: not reached, because of 'returns a model'" in out
    assert "own_for_cli:Constant does not pass: 9 of 14 checks failed or were not reached" in out


@pytest.mark.parametrize("name", ["sds", "esm:window=0.4", "tvsysid.methods:KernelRegression"])
def test_check_method_passes_the_packages_own(tvsysid, name):
    code, out, err = tvsysid("check-method", name)
    assert (code, err) == (0, "")
    assert out.count("✓") == 14
    assert f"{name} passes; use it: tvsysid benchmark --method {name}\n" in out


@pytest.mark.parametrize(
    "command", [(), ("benchmark",), ("check-method",), ("identify",), ("inspect",), ("methods",), ("simulate",)]
)
def test_help(tvsysid, command):
    code, out, _ = tvsysid(*command, "--help")
    assert code == 0
    assert "Usage: tvsysid" in out


def test_version(tvsysid):
    assert tvsysid("--version")[:2] == (0, "tvsysid 0.1.0\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("identify", "nowhere.mat", *IDENTIFY), "nowhere.mat: no such file"),
        (
            ("identify", "joint.mat", "--angle", "pos", *IDENTIFY[2:]),
            "no channel 'pos'; it holds angle (40000 x 1, 1000 Hz)",
        ),
        (("identify", "joint.mat", *IDENTIFY, "--decimate", "300"), "not a whole multiple of 300 Hz"),
        (("identify", "joint.mat", *IDENTIFY, "--period", "90"), "no realization of 90 s"),
        (("identify", "joint.mat", *IDENTIFY, "--method", "arx"), "unknown method 'arx'"),
        (("identify", "joint.mat", *IDENTIFY, "--method", "sds:windw=1"), "unknown setting 'windw'"),
        (("identify", "joint.mat", *IDENTIFY, "--method", "sds:window=9"), "longer than a realization"),
        (("identify", "joint.mat", *IDENTIFY, "--torque-sign", "3"), "torque_sign must be 1 or -1"),
        (("identify", "joint.mat", *IDENTIFY, "--angle-unit", "grad"), "grad"),
        (("identify", "joint.mat", *IDENTIFY, "--columns", "rows"), "rows"),
        (("identify", "joint.mat", "--angle", "angle"), "Missing option"),
        (("identify", "joint.mat", *IDENTIFY, "--rate", "0"), "positive number of hertz"),
        (("identify", "joint.mat", *IDENTIFY, "--out", "joint.mat"), "joint.mat"),
        (("inspect", "nowhere.mat"), "nowhere.mat: no such file"),
        (
            ("inspect", "joint.mat", "--diagnose", *IDENTIFY[:4]),
            "--rate, --period missing; give them as for tvsysid identify",
        ),
        (("inspect", "joint.mat", *IDENTIFY), "--angle: is used with --diagnose only; add --diagnose"),
        (("inspect", "joint.mat", "--diagnose", *IDENTIFY, "--decimate", "300"), "not a whole multiple of 300 Hz"),
        (("inspect", "joint.mat", "--plot", "joint.doc"), "unknown ending '.doc'; give one of .png, .pdf, .svg"),
        (("simulate", "joint.docx"), "unknown ending '.docx'"),
        (("simulate", "other.mat", "--duration", "-1"), "duration must be a positive number"),
        (("benchmark", "--duration", "3"), "whole realizations of 2 s"),
        (("benchmark", "--trials", "0"), "trials"),
        (("benchmark", "--workers", "0"), "workers must be at least 1"),
        (("benchmark", "--method", "nothing"), "unknown method 'nothing'"),
        (("benchmark", "--method", "nowhere:Fit"), "there is no module 'nowhere'"),
        (
            ("check-method", "nowhere:Fit"),
            "there is no module 'nowhere'; the current folder and the installed",
        ),
        (("check-method", "json:Fit"), "module 'json' has no 'Fit'; nothing in it has identify"),
        (("check-method", "nothing"), "unknown method 'nothing'"),
        (("check-method",), "Missing argument"),
        (("benchmark", "--stiffness", "step"), "step"),
        (("benchmrk",), "benchmrk"),
        (("benchmark", "--trails", "3"), "--trails"),
    ],
)
def test_errors_are_one_line(tvsysid, words, message):
    tvsysid("simulate", "joint.mat", "--duration", 40)
    code, _, err = tvsysid(*words)
    assert code == 2
    assert message in err
    assert err.startswith("tvsysid: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err


@pytest.mark.slow
def test_identify_with_settings_from_the_data(tvsysid, tmp_path):
    tvsysid("simulate", "joint.mat", "--duration", 40)
    methods = ("--method", "birf", "--method", "kbr")
    code, out, err = tvsysid("identify", "joint.mat", *IDENTIFY, *methods, "--tune")
    assert (code, err) == (0, "")
    assert "birf: basis=HaarWavelets(functions=4) instead of basis=CubicBSplines(functions=10, periodic=False): " in out
    folder = tmp_path / "tvsysid-identify"
    table = pd.read_csv(folder / "tuning.csv")
    assert list(table.columns) == ["method", "settings", "criterion", "value", "unit", "standard_error", "chosen"]
    for _, rows in table.groupby("method"):
        assert rows.value[rows.chosen].item() == rows.value.max()
    assert (folder / "tuning.png").stat().st_size > 5000
    with xr.open_datatree(folder / "models.nc", engine="h5netcdf") as tree:
        assert tree["birf"].attrs["method"].startswith("BasisIRF(max_lag=0.12, basis=HaarWavelets(functions=4)")
    (again,) = (line for line in out.splitlines() if line.startswith("the same settings again: "))
    kept = pd.read_csv(folder / "stiffness.csv")
    code, out, err = tvsysid("identify", "joint.mat", *IDENTIFY, *shlex.split(again.partition(": ")[2]))
    assert (code, err) == (0, "")
    repeated = pd.read_csv(folder / "stiffness.csv")
    np.testing.assert_array_equal(repeated.stiffness, kept.stiffness)
    # As in a study, one method may choose its settings and another not.
    code, out, err = tvsysid("identify", "joint.mat", *IDENTIFY, "--method", "birf:tuned=true", "--method", "sds")
    assert (code, err) == (0, "")
    assert "the same settings again: --method 'birf:basis=HaarWavelets(functions=4)'\n" in out


def test_a_method_of_ones_own_cannot_be_tuned(tvsysid, tmp_path):
    (tmp_path / "untunable.py").write_text("class Mine:\n    def identify(self, ensemble):\n        return None\n")
    tvsysid("simulate", "joint.mat", "--duration", 40)
    code, _, err = tvsysid("identify", "joint.mat", *IDENTIFY, "--method", "untunable:Mine", "--tune")
    assert code == 2
    assert "leave out tune (--tune), and write key:tuned=true" in err
