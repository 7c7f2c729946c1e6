import os
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr
from tests.conftest import realizations
from tests.study.conftest import SMALL, Mine, same

import tvsysid as tv
from tvsysid.study import Study, estimate_duration, run
from tvsysid.study.trials import draw
from tvsysid.study.workers import local_workers

SHORT = {"duration_s": 40, "trials": 3, "perturbation": "prbs", "methods": "sds"}


def test_results_are_labelled_and_whole(results):
    cell = ("scenario", "trial", "method_key")
    assert results.estimate.dims == results.covered.dims == (*cell, "quantity", "time")
    assert results.truth.dims == ("scenario", "quantity", "time")
    assert results.vaf.dims == cell
    assert results.sizes["time"] == 200
    assert results.unit.values.tolist() == ["N m/rad", "N m s/rad", "kg m2"]
    for name, values in results.data_vars.items():
        whole = values == "" if name in ("warnings", "failure") else np.isfinite(values)
        assert whole.all(), name
    at = results.sel(scenario="square-prbs-60s-10dB", quantity="stiffness")
    np.testing.assert_array_equal(at.truth, tv.simulate.SquareWave()(results.time.values))
    assert (at.perturbation, at.duration_s) == ("prbs", 60)


def test_a_trial_is_what_its_parts_give(results):
    study = Study(**SMALL)
    scenario = study.scenarios[1]
    simulation = tv.simulate.Joint(stiffness=tv.simulate.SquareWave()).simulate(
        60.0, perturbation=tv.simulate.PRBS(), snr_db=10.0, seed=study.seed_of(scenario, 2)
    )
    ensemble, noiseless = (
        realizations(each) for each in (simulation.recording, simulation.noiseless)
    )
    model = tv.ShortDataSegments().identify(ensemble)
    pair = noiseless.torque[:, noiseless.core], model.predict(ensemble)
    found = results.sel(scenario=scenario.label, trial=2, method_key="sds")
    np.testing.assert_array_equal(found.time_varying_vaf, tv.metrics.time_varying_vaf(*pair))
    np.testing.assert_allclose(found.vaf, tv.metrics.vaf(*pair).mean(), rtol=1e-12)
    for name, estimate in model.estimates.items():
        own = found.sel(quantity=name)
        lower, upper = estimate.band(0.95)
        np.testing.assert_array_equal(own.estimate, estimate.values)
        np.testing.assert_array_equal(own.covered, (lower <= own.truth) & (own.truth <= upper))


@pytest.mark.slow
def test_the_number_of_workers_changes_no_number(results):
    same(run(Study(**SMALL), workers=2), results)


@pytest.mark.slow
def test_more_methods_trials_and_scenarios_change_no_number(results):
    more = {"duration_s": [60.0, 40.0], "trials": 4, "methods": ["esm", "kbr", "sds"]}
    part = run(Study(**more, perturbation=["prbs", "noise"]), workers=1)
    part = part.sel(scenario=results.scenario.values, trial=[0, 1, 2], method_key=["sds", "kbr"])
    xr.testing.assert_equal(part.drop_vars("seconds"), results.drop_vars("seconds"))
    study = Study(**SMALL | {"seed": 1})
    ensemble, other = (draw(each, each.scenarios[0], 0)[0] for each in (study, Study(**SMALL)))
    assert not np.array_equal(ensemble.angle, other.angle)


@pytest.mark.slow
def test_threads_keep_the_warnings_of_each_trial():
    study = Study(duration_s=[40, 80], trials=2, methods=["eirf", "sds"])
    with ThreadPoolExecutor(4) as executor:
        same(run(study, executor=executor), run(study, workers=1))


@pytest.mark.slow
def test_a_worker_that_dies_and_a_method_that_cannot_be_pickled_are_reported():
    unsendable = Mine()
    object.__setattr__(unsendable, "fault", threading.Lock())
    for method, message in (
        (Mine("dies"), "at square.* by .*It crashed"),
        (unsendable, "TypeError: cannot pickle"),
    ):
        with pytest.raises(tv.InputError, match=rf"a worker failed .*{message}"):
            run(Study(**SHORT | {"methods": method}), workers=2)


def test_an_executor_that_was_shut_down_gives_up_plainly():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(tv.InputError, match=r"a worker failed .*Run the same command again"):
        run(Study(**SHORT), executor=executor)


def test_a_plan_tells_number_and_time():
    methods, identifications, seconds = estimate_duration(Study(**SHORT | {"duration_s": [40, 80]}))
    assert (methods, identifications) == (["sds"], 6)
    assert 0 < seconds < 60


@pytest.mark.slow
def test_a_worker_that_dies_while_answers_are_found_is_told_in_one_line():
    message = "Run the same command again to resume"
    with pytest.raises(tv.InputError, match=message), local_workers(2) as pool:
        list(pool.map(os._exit, [1, 1]))
