"""Methods that do what no method should spoil no other, and are reported with what they did."""

import os
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest
from tests.conftest import ensemble_of, wait_for
from tests.study import hostile

import tvsysid as tv
from tvsysid.methods import forkserver
from tvsysid.report import problems
from tvsysid.study import Study, run

OWN = ["sds", "birf"]
SETTINGS = {"duration_s": 20.0, "trials": 2, "perturbation": "prbs"}
HANGING = (hostile.Hangs, hostile.HangsInNativeCode, hostile.HangsWhenAsked)
LIMIT = 0.5  # s, where all that it is for hang


def studied(*kinds, **settings):
    return run(Study(**SETTINGS, methods=[OWN[0], *(kind() for kind in kinds), OWN[1]]), workers=1, **settings)


@pytest.fixture(scope="module")
def results():
    return studied(*(kind for kind in (*hostile.FAILURES, *hostile.HARMLESS) if kind not in HANGING))


@pytest.fixture(scope="module")
def hung():
    return studied(*HANGING, time_limit=LIMIT)


@pytest.mark.slow
def test_the_package_s_own_methods_give_the_same_bits(results, hung):
    alone = studied()
    for together in (each.sel(method_key=OWN) for each in (results, hung)):
        assert (together.failure == "").all()
        for name in (
            "estimate", "standard_error", "covered", "vaf", "bandpassed_vaf", "time_varying_vaf", "parameters"
        ):  # fmt: skip
            np.testing.assert_array_equal(together[name], alone[name], err_msg=name)


@pytest.mark.slow
def test_each_is_reported_with_what_it_did(results, hung):
    found = [*problems(results), *problems(hung)]
    told = {problem["method"]: problem for problem in found if problem["kind"] == "failed"}
    assert set(told) == {kind.__name__ for kind in hostile.FAILURES}
    for kind, reason in hostile.FAILURES.items():
        assert reason in told[kind.__name__]["first"]
        assert told[kind.__name__]["count"] == SETTINGS["trials"]
        assert told[kind.__name__]["first"].isprintable()
        assert np.isnan((hung if kind in HANGING else results).estimate.sel(method_key=kind.__name__)).all()
    assert results.warnings.sel(method_key="WarnsAtEachSample").item(0).endswith("; and 19980 more warnings")
    for kind in hostile.HARMLESS:
        assert (results.estimate.sel(method_key=kind.__name__, quantity="stiffness") == 100.0).all()


@pytest.mark.slow
def test_one_that_hangs_is_not_tried_again_in_the_run(hung):
    second, first = hung.failure.sel(method_key="Hangs").values.ravel()  # the last trial is run first
    assert first.startswith(f"it took longer than the time limit of {LIMIT:g} s")
    assert second.startswith("not tried again in this run: it took longer")


@pytest.mark.slow
def test_this_process_is_as_it_was(results):
    assert os.getcwd() != "/"
    assert callable(np.linalg.solve)
    assert np.geterr()["divide"] == "warn"
    assert not sys.stdout.closed


@pytest.mark.slow
@pytest.mark.usefixtures("quick_workers")
def test_one_that_hangs_in_a_worker_is_ended_there_and_resuming_tries_it_again(tmp_path):
    study = Study(**SETTINGS, methods=["sds", hostile.HangsInNativeCode(), hostile.Interrupts()])
    for workers in (2, 1):
        found = run(study, workers=workers, time_limit=1.0, store=tmp_path / "results.zarr")
        assert (found.failure.sel(method_key="sds") == "").all()
        assert any(text.startswith("it took longer") for text in found.failure.values[..., 1].ravel())
        assert all(text.startswith("KeyboardInterrupt") for text in found.failure.values[..., 2].ravel())


@pytest.mark.slow
def test_all_that_it_started_ends_with_the_process_that_asked(forking):
    """Killed in the middle of a hang."""
    here, there = forking.Pipe()
    program = forking.Process(target=leaves_processes_and_hangs, args=(there,))
    program.start()
    pids = here.recv()
    assert len(pids) == 3
    program.kill()
    program.join()
    wait_for(lambda: not any(map(is_alive, pids)), 10.0)


def leaves_processes_and_hangs(pipe):
    tv.compare(ensemble_of(), ["sds", hostile.LeavesFork(), hostile.LeavesThread()])
    (server,) = forkserver._servers
    pipe.send([*(each.process for each in server.children.values()), server.program.pid])
    tv.compare(ensemble_of(), ["sds", hostile.Hangs()])


def is_alive(process):
    try:
        os.killpg(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_in_a_comparison_the_others_finish():
    ensemble = ensemble_of()
    methods = [hostile.SetsFlags(), "sds", hostile.HasNoPathways(), hostile.Interrupts(), hostile.LeavesThread()]
    found = tv.compare(ensemble, methods)
    assert list(found.models) == ["sds", "LeavesThread"]
    assert "it changed the ensemble" in found.failed["SetsFlags"]
    assert "KeyboardInterrupt (hostile.py, line" in found.failed["Interrupts"]
    assert "failed: SetsFlags, HasNoPathways, Interrupts" in repr(found)
    np.testing.assert_array_equal(found.models["sds"].stiffness, tv.ShortDataSegments().identify(ensemble).stiffness)
    other = ensemble.select([0, 1, 2])
    assert found.models["LeavesThread"].predict(ensemble).shape == (len(ensemble), ensemble.samples)
    with pytest.raises(tv.InputError, match="must be of shape"):  # its own code, on other data
        found.models["LeavesThread"].predict(other)


def test_no_more_processes_are_kept_than_some(monkeypatch):
    monkeypatch.setattr(forkserver, "KEPT", 2)
    for number in (1, 2, 3, 2):
        tv.compare(ensemble_of(), [hostile.LeavesThread(), Numbered(number)])
    children = forkserver._servers[0].children
    assert len(children) == 2
    assert len({child.process for child in children.values() if is_alive(child.process)}) == 2


@dataclass(frozen=True)
class Numbered:
    number: int

    def identify(self, ensemble):
        return hostile.found(ensemble)


@pytest.mark.slow
def test_one_that_kills_the_server_is_followed_by_others():
    class KillsParent:
        def identify(self, ensemble):
            os.kill(os.getppid(), 9)
            time.sleep(0.1)
            return hostile.found(ensemble)

    found = tv.compare(ensemble_of(), [KillsParent(), hostile.LeavesThread(), "esm"])
    assert list(found.models)[-2:] == ["LeavesThread", "esm"]


@pytest.mark.parametrize("limit", [0, -1, float("nan"), float("inf"), True, "10"])
def test_a_limit_is_a_positive_number_of_seconds(limit):
    with pytest.raises(tv.InputError, match="time_limit: expected a positive number of seconds"):
        tv.compare(ensemble_of(), ["sds"], time_limit=limit)
    with pytest.raises(tv.InputError, match="time_limit: expected a positive number of seconds"):
        run(Study(**SETTINGS, methods="sds"), time_limit=limit)


def test_where_nothing_can_be_forked_methods_run_in_this_process(monkeypatch):
    monkeypatch.setattr(forkserver, "FORKS", False)
    found = tv.compare(ensemble_of(), [hostile.SetsAttribute(), hostile.GivesComplex(), "sds"])
    assert list(found.models) == ["sds"]
    assert "it changed the ensemble" in found.failed["SetsAttribute"]
