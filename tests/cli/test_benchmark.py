"""`tvsysid benchmark` and `tvsysid report` of what it wrote."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.cli.conftest import rows_of


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_benchmark(tvsysid, tmp_path, request):
    code, out, err = tvsysid(
        "benchmark --trials 2 --duration 40 --method sds --method esm:window=0.4 --workers 1",
    )
    assert (code, err) == (0, "")
    assert "square-wave stiffness, filtered noise, 40 s, 10 dB, 2 trials" in out
    assert "esm:window=0.4" in out
    assert "s of data per s" in out
    folder = tmp_path / "tvsysid-benchmark"
    table = pd.read_csv(folder / "summary.csv")
    assert list(table.columns[:8]) == [
        "stiffness", "perturbation", "duration_s", "snr_db", "method", "trials", "metric", "value",
    ]  # fmt: skip
    assert set(table.perturbation) == {"noise", "prbs"}
    assert set(table.method) == {"sds", "esm:window=0.4"}
    assert xr.load_dataset(folder / "results.nc").estimate.sizes["trial"] == 2
    assert set(pd.read_csv(folder / "claims.csv").verdict) <= {
        "holds",
        "does not hold",
        "undecided",
        "not studied",
    }
    for ending in ("png", "pdf", "svg"):
        for perturbation in ("noise", "prbs"):
            assert (
                folder / "figures" / f"comparison-square-{perturbation}.{ending}"
            ).stat().st_size > 0
        assert (folder / "figures" / f"coverage-square.{ending}").stat().st_size > 0
    page = (folder / "report.html").read_text()
    assert "esm:window=0.4" in page
    assert (
        "tvsysid benchmark --trials 2 --duration 40 --method sds --method esm:window=0.4 "
        "--workers 1" in page
    )
    before = (folder / "summary.csv").read_text()
    for name in ("summary.csv", "report.html"):
        (folder / name).unlink()
    request.getfixturevalue("undrawn")
    code, out, err = tvsysid(f"report {folder}")
    assert (code, err) == (0, "")
    assert (folder / "summary.csv").read_text() == before
    assert (folder / "report.html").exists()


def test_a_dry_run_runs_nothing(tvsysid, tmp_path):
    code, out, _ = tvsysid("benchmark --preset paper --trials 4 --method birf --dry-run")
    assert code == 0
    assert "4 trials of each of 12 scenarios, seed 0: 48 trials, 10,560 s of data" in out
    assert "nothing was run" in out
    assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("undrawn")
def test_a_study_from_a_file_with_options_in_its_place(tvsysid, tmp_path):
    (tmp_path / "study.toml").write_text(
        'duration_s = 40\nperturbation = "prbs"\nmethods = "birf"\ntrials = 9\n'
    )
    code, _, _ = tvsysid("benchmark study.toml --trials 2 --workers 1 --out out")
    assert code == 0
    table = pd.read_csv(tmp_path / "out" / "summary.csv")
    assert (set(table.perturbation), set(table.duration_s), set(table.trials)) == (
        {"prbs"},
        {40.0},
        {2},
    )


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_own_method_that_fails_is_told_and_the_others_are_kept(tvsysid, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "faulty.py").write_text(
        "import tvsysid\nclass Mine(tvsysid.Method):\n    def fit(self, ensemble):\n"
        "        raise KeyError('no key')\n"
    )
    code, _, err = tvsysid(
        "benchmark --duration 40 --perturbation prbs --trials 2 --workers 1 --method sds "
        "--method faulty:Mine"
    )
    assert code == 1
    assert "error: faulty:Mine: failed in 2 of 2; the first: KeyError: 'no key'" in err
    assert "faulty.py" in err
    table = (
        pd.read_csv(tmp_path / "tvsysid-benchmark" / "summary.csv")
        .query("quantity not in ['viscosity', 'inertia']")
        .set_index(["method", "metric"])
        .value
    )
    assert table["faulty:Mine", "failed"] == 2
    assert table["sds", "failed"] == 0
    assert np.isfinite(table["sds", "bias_error"])


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "sketched")  # claims about reflexes have figures of their own
def test_methods_of_one_and_of_two_pathways_side_by_side(tvsysid, tmp_path):
    code, out, _ = tvsysid(
        "benchmark --system reflex-sine --stiffness sine --perturbation noise --duration 20 "
        "--trials 1 --method birf --method cascade --workers 1"
    )
    assert code == 0
    birf, cascade = (
        next(row for row in rows_of(out) if row[0] == name) for name in ("birf", "cascade")
    )
    assert birf.count("-") == cascade.count("-") + 2  # neither gain nor torque of a reflex
    table = pd.read_csv(tmp_path / "tvsysid-benchmark" / "claims.csv")
    assert table.claim.str.contains("take a reflex for stiffness").any()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_doubts_in_a_benchmark_are_told(tvsysid):
    code, _, err = tvsysid("benchmark --trials 2 --duration 40 --method eirf --workers 1")
    assert code == 0
    assert "warning: eirf: " in err
    assert "fewer than the 25 lags" in err


@pytest.mark.usefixtures("undrawn")
def test_a_system_a_profile_and_a_perturbation_of_one_s_own(tvsysid, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "mysystem.py").write_text(
        "import numpy as np\nimport tvsysid as tv\n"
        "def ramp(time):\n    return 80 + 20 * np.mod(time, 1.0)\n"
        "class Joint(tv.simulate.Joint):\n    pass\n"
        "class Noise(tv.simulate.FilteredNoise):\n    pass\n"
    )
    own = "--system mysystem:Joint --stiffness mysystem:ramp --perturbation mysystem:Noise"
    options = "--duration 8 --period 1 --rate 125 --trials 1 --method birf --workers 1"
    assert tvsysid(f"benchmark {own} {options}")[0] == 0
    table = pd.read_csv(tmp_path / "tvsysid-benchmark" / "summary.csv")
    assert set(table.system) == {"mysystem:Joint"}
    assert set(table.quantity.dropna()) == {"stiffness", "viscosity", "inertia"}
    code, _, err = tvsysid("benchmark --system ankle --dry-run")
    assert code == 2
    assert (
        "unknown system 'ankle'; expected one of joint, reflex, reflex-sine, reflex-square, "
        "compliant, sch" in err
    )


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_titles_of_tables_tell_systems_apart(tvsysid):
    code, out, _ = tvsysid(
        "benchmark --system joint --system reflex --trials 1 --duration 20 --perturbation prbs "
        "--method birf --workers 1"
    )
    assert code == 0
    assert "\nreflex, square-wave stiffness, PRBS, 20 s, 10 dB, 1 trial" in out
    assert out.startswith("\nsquare-wave stiffness, PRBS, 20 s, 10 dB, 1 trial")
