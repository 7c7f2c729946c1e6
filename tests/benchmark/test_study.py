import dataclasses

import numpy as np
import pytest
import xarray as xr

import tvsysid as tv
from tvsysid.benchmark import Study, run, summarize
from tvsysid.benchmark.summary import COLUMNS

SMALL = {"duration_s": [60.0], "trials": 3, "methods": ["sds", "kbr"]}


@dataclasses.dataclass(frozen=True)
class Mine:
    """A researcher's own method: stiffness of a constant joint by regression on the angle alone."""

    gain: float = 1.0

    def identify(self, ensemble):
        angle, torque = ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]
        return MyModel(np.full(ensemble.samples, self.gain * np.sum(angle * torque) / np.sum(angle * angle)))


@dataclasses.dataclass(frozen=True)
class MyModel:
    stiffness: np.ndarray

    def predict(self, ensemble):
        return ensemble.angle[:, ensemble.core] * self.stiffness


@pytest.fixture(scope="module")
def results():
    return run(Study(**SMALL), workers=1)


def test_results_are_labelled_and_whole(results):
    assert results.stiffness.dims == (
        "profile", "perturbation", "duration_s", "snr_db", "method_key", "trial", "time",
    )  # fmt: skip
    assert results.sizes["time"] == 200
    assert results.stiffness.attrs["units"] == "N m/rad"
    for name, values in results.data_vars.items():
        assert (values == "").all() if name == "doubts" else np.isfinite(values).all()
    np.testing.assert_array_equal(
        results.true_stiffness.sel(profile="square"), tv.simulate.SquareWave()(results.time.values)
    )


def test_the_number_of_workers_changes_no_number(results):
    again = run(Study(**SMALL), workers=2)
    xr.testing.assert_identical(again.drop_vars("seconds"), results.drop_vars("seconds"))


def test_more_methods_trials_and_scenarios_change_no_number(results):
    more = run(
        Study(duration_s=[60.0, 40.0], trials=4, methods=["esm", "kbr", "sds"], perturbation=["prbs", "noise"]),
        workers=1,
    )
    part = more.sel(duration_s=[60.0], trial=[0, 1, 2], method_key=["sds", "kbr"], perturbation=["noise", "prbs"])
    xr.testing.assert_equal(part.drop_vars("seconds"), results.drop_vars("seconds"))
    other = run(Study(**SMALL | {"seed": 1}), workers=1)
    assert not np.array_equal(other.stiffness, results.stiffness)


def test_progress_is_reported():
    seen = []
    run(Study(**SMALL | {"perturbation": ["prbs"]}), workers=1, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_own_method_enters(results):
    both = run(Study(**SMALL | {"methods": ["sds", Mine()]}), workers=1)
    assert list(both.method_key.values) == ["sds", "Mine(gain=1.0)"]
    xr.testing.assert_equal(both.stiffness.sel(method_key="sds"), results.stiffness.sel(method_key="sds"))
    table = summarize(both)
    assert len(table[table.method == "Mine(gain=1.0)"]) == len(table[table.method == "sds"])


def test_summary_holds_every_metric(results):
    table = summarize(results)
    assert tuple(table.columns) == COLUMNS
    cell = table[(table.method == "sds") & (table.perturbation == "prbs")].set_index("metric").value
    estimates = results.stiffness.sel(profile="square", perturbation="prbs", method_key="sds").values.reshape(3, 200)
    truth = results.true_stiffness.values[0]
    assert cell["bias_error"] == tv.metrics.bias_error(estimates, truth)
    assert cell["total_error"] ** 2 == pytest.approx(cell["bias_error"] ** 2 + cell["random_error"] ** 2)
    assert cell["rise_time"] == tv.metrics.rise_time(results.time.values, estimates)
    assert cell["vaf"] == pytest.approx(float(results.vaf.sel(perturbation="prbs", method_key="sds").mean()))
    assert cell["lowest_vaf"] <= cell["vaf"]
    assert cell["left_out"] == 0
    assert set(table.trials) == {3}
    assert "rise_time" not in set(summarize(run(Study(**SMALL | {"stiffness": ["sine"]}), workers=1)).metric)


def test_store_is_written_whole_and_never_over_another(tmp_path, results):
    store = tmp_path / "results.zarr"
    small = Study(**SMALL | {"perturbation": ["prbs"]})
    written = run(small, workers=1, store=store)
    read = xr.open_zarr(store).load()
    xr.testing.assert_equal(read, written)
    assert [item.name for item in tmp_path.iterdir()] == ["results.zarr"]
    with pytest.raises(tv.InputError, match="the store exists already"):
        run(small, workers=1, store=store)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"stiffness": ["step"]}, "unknown name 'step'; expected one of square, sine, constant"),
        ({"perturbation": ["white"]}, "unknown name 'white'; expected one of noise, prbs"),
        ({"methods": ["arx"]}, "unknown method 'arx'"),
        ({"methods": [3]}, r"object with identify\(ensemble\)"),
        ({"methods": []}, "methods: .*at least 1"),
        ({"methods": ["sds", "sds"]}, "the same value is given twice"),
        ({"trials": 0}, "trials: .*greater than or equal to 1"),
        ({"trials": "many"}, "trials: .*valid integer"),
        ({"seed": -1}, "seed: "),
        ({"duration_s": [3.0]}, "whole realizations of 2 s"),
        ({"duration_s": [-2.0]}, "whole realizations of 2 s"),
        ({"duration_s": [float("nan")]}, "whole realizations of 2 s"),
        ({"snr_db": [float("nan")]}, "expected decibels"),
        ({"trails": 3}, "settings of a study: stiffness, perturbation, duration_s, snr_db, methods, trials, seed"),
    ],
)
def test_a_wrong_study_is_refused(settings, message):
    with pytest.raises(tv.InputError, match=message):
        Study(**settings)


def test_wrong_workers_are_refused():
    with pytest.raises(tv.InputError, match="workers must be at least 1"):
        run(Study(**SMALL), workers=0)


def test_settings_that_do_not_fit_the_data_are_refused_from_a_worker():
    with pytest.raises(tv.InputError, match="longer than a realization"):
        run(Study(**SMALL | {"methods": ["sds:window=5"]}), workers=2)
