"""`tvsysid benchmark` and `tvsysid report` of what it wrote."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.cli.conftest import text_of


@pytest.fixture
def benchmark(tvsysid):
    """Run a study in one process; return exit code, output, errors and the summary."""

    def command(options):
        code, out, err = tvsysid(f"benchmark {options} --workers 1 --out found")
        return code, out, err, pd.read_csv("found/summary.csv")

    return command


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_benchmark(benchmark, tvsysid, tmp_path, request):
    words = "--trials 2 --duration 40 --method sds --method esm:window=0.4"
    code, out, err, table = benchmark(words)
    assert (code, err) == (0, "")
    assert "square-noise-40s-10dB" in out
    rows = table[table.method == "sds"].groupby("metric").value
    shown = next(line for line in out.splitlines() if line.startswith("sds ")).split()
    assert float(shown[2]) == pytest.approx(rows.first()["bias_error"], abs=0.05)
    assert "esm:window=0.4" in out
    folder = tmp_path / "found"
    assert set(table.perturbation) == {"noise", "prbs"}
    assert set(table.method) == {"sds", "esm:window=0.4"}
    assert xr.load_dataset(folder / "results.nc").estimate.sizes["trial"] == 2
    figures = {file.name for file in (folder / "figures").iterdir()}
    assert {"comparison-square-noise.png", "comparison-square-noise.svg"} <= figures
    assert f"tvsysid benchmark {words} --workers 1" in text_of(folder / "report.html")
    tables = {name: (folder / name).read_bytes() for name in ("summary.csv", "claims.csv")}
    for name in (*tables, "report.html"):
        (folder / name).unlink()
    request.getfixturevalue("undrawn")
    code, _, err = tvsysid("report found")
    assert (code, err) == (0, "")
    assert {name: (folder / name).read_bytes() for name in tables} == tables
    assert (folder / "report.html").exists()


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (
            "benchmark --preset paper --trials 4 --method birf",
            "4 trials of each of 12 scenarios, seed 0: 48 identifications",
        ),
        pytest.param(
            "experiment --virtual 1 --method sds",
            "100 draws, seed 0: 400 identifications",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_dry_run_runs_nothing(tvsysid, tmp_path, command, said):
    code, out, _ = tvsysid(f"{command} --dry-run")
    assert code == 0
    assert said in out
    assert "nothing was run" in out
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_method_that_fails_or_warns_is_named_and_the_others_are_kept(
    benchmark, tmp_path, monkeypatch
):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "faulty.py").write_text(
        "import tvsysid\nclass Mine(tvsysid.Method):\n    def fit(self, ensemble):\n        raise "
        "KeyError('no key')\n"
    )
    methods = "--method sds --method eirf --method faulty:Mine"
    code, _, err, table = benchmark(f"--duration 40 --perturbation prbs --trials 2 {methods}")
    assert code == 1
    assert "error: faulty:Mine: failed in 2 of 2; the first: KeyError: 'no key' (faulty.py" in err
    assert "warning: eirf: " in err
    assert "fewer than the 25 lags" in err
    values = table.set_index(["method", "metric"]).value
    assert values["faulty:Mine", "failed"] == 2
    assert values["sds", "failed"] == 0
    assert np.isfinite(values["sds", "bias_error"])
