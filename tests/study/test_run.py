import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr
from tests.study.conftest import SMALL, TIMES, Mine

import tvsysid as tv
from tvsysid.study import Study, plan, run


def same(one, other):
    xr.testing.assert_identical(one.drop_vars(TIMES), other.drop_vars(TIMES))


def test_results_are_labelled_and_whole(results):
    assert (
        results.estimate.dims
        == results.covered.dims
        == ("scenario", "trial", "method_key", "quantity", "time")
    )
    assert results.truth.dims == ("scenario", "quantity", "time")
    assert results.vaf.dims == ("scenario", "trial", "method_key")
    assert results.sizes["time"] == 200
    assert results.unit.values.tolist() == ["N m/rad", "N m s/rad", "kg m2"]
    for name, values in results.data_vars.items():
        texts = name in ("warnings", "failure")
        assert (
            all(text == "" for text in values.values.ravel())
            if texts
            else np.isfinite(values).all()
        )
    cell = results.sel(scenario="square-prbs-60s-10dB")
    np.testing.assert_array_equal(
        cell.truth.sel(quantity="stiffness"), tv.simulate.SquareWave()(results.time.values)
    )
    assert (cell.perturbation, cell.duration_s) == ("prbs", 60)


def test_a_trial_is_what_its_parts_give(results):
    scenario = Study(**SMALL).scenarios[1]
    joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    simulation = joint.simulate(
        60.0, perturbation=tv.simulate.PRBS(), snr_db=10.0, seed=Study(**SMALL).seed_of(scenario, 2)
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100.0), 2.0)
    noiseless = tv.preprocess.segment(tv.preprocess.decimate(simulation.noiseless, 100.0), 2.0)
    torque = noiseless.torque[:, noiseless.core]
    model = tv.ShortDataSegments().identify(ensemble)
    found = results.sel(scenario=scenario.label, trial=2, method_key="sds")
    np.testing.assert_array_equal(found.estimate.sel(quantity="stiffness"), model.stiffness)
    np.testing.assert_array_equal(
        found.time_varying_vaf, tv.metrics.time_varying_vaf(torque, model.predict(ensemble))
    )
    for name, estimate in model.estimates.items():
        own = found.sel(quantity=name)
        lower, upper = estimate.band(0.95)
        np.testing.assert_array_equal(own.estimate, estimate.values)
        np.testing.assert_array_equal(own.covered, (lower <= own.truth) & (own.truth <= upper))
    vaf = tv.metrics.vaf(torque, model.predict(ensemble))
    np.testing.assert_allclose(found.vaf, vaf.mean(), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_workers")
def test_the_number_of_workers_changes_no_number(results):
    same(run(Study(**SMALL), workers=2), results)


@pytest.mark.slow
def test_more_methods_trials_and_scenarios_change_no_number(results):
    more = run(
        Study(
            duration_s=[60.0, 40.0],
            trials=4,
            methods=["esm", "kbr", "sds"],
            perturbation=["prbs", "noise"],
        ),
        workers=1,
    )
    part = more.sel(scenario=results.scenario.values, trial=[0, 1, 2], method_key=["sds", "kbr"])
    xr.testing.assert_equal(part.drop_vars(TIMES), results.drop_vars(TIMES))
    other = run(Study(**SMALL | {"seed": 1, "trials": 1}), workers=1)
    assert not np.array_equal(other.estimate, results.estimate.isel(trial=[0]))


@pytest.mark.slow
@pytest.mark.usefixtures("quick_workers")
def test_a_worker_that_dies_is_reported(tmp_path):
    settings = {"duration_s": 40, "trials": 3, "perturbation": "prbs"}
    with pytest.raises(tv.InputError, match=r"a worker failed .*It crashed"):
        run(Study(**settings, methods=["sds", Mine("dies")]), workers=2, folder=tmp_path)


@pytest.mark.slow
def test_threads_keep_each_trial_s_doubts():
    study = Study(duration_s=[40, 80], trials=2, methods=["eirf", "sds"])
    with ThreadPoolExecutor(4) as executor:
        same(run(study, executor=executor), run(study, workers=1))


def test_a_method_that_cannot_be_pickled_is_refused():
    method = Mine()
    object.__setattr__(method, "fault", threading.Lock())
    with pytest.raises(tv.InputError, match=r"a worker failed .TypeError: cannot pickle"):
        run(Study(**SMALL | {"methods": [method]}), workers=2)


def test_a_plan_tells_number_and_time():
    identifications, seconds = plan(Study(duration_s=[40, 80], trials=5, methods="sds"))
    assert identifications == 20
    assert 0 < seconds < 60


def test_an_executor_that_was_shut_down_gives_up_plainly():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(tv.InputError, match=r"a worker failed .*Run the same command again"):
        run(Study(duration_s=40, trials=1, methods="sds"), executor=executor)
