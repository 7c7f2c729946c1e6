import json
import os
import shutil
import warnings

import numpy as np
import pytest
import xarray as xr
from tests.study.conftest import SMALL, TIMES

import tvsysid as tv
from tvsysid.study import Study, read_results, run
from tvsysid.study.contents import OF_TRIAL, layout_of
from tvsysid.study.store import open_store
from tvsysid.study.task import versions

STUDY = Study(**SMALL)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "results.zarr"
    run(STUDY, store=path, workers=1)
    return path


@pytest.fixture
def copy(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "results.zarr")


def rerun(path):
    """Go on with a study, count the trials that are run, and see that the results are those of the other tests."""
    seen = []
    found = run(STUDY, store=path, workers=1, progress=lambda done, total: seen.append(done))
    return found, len(seen) - 1


def same(one, other):
    xr.testing.assert_identical(one.load().drop_vars(TIMES), other.drop_vars(TIMES))


def test_reading_needs_only_xarray_and_gives_no_warning(finished, results):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = xr.open_zarr(finished).load()
    np.testing.assert_array_equal(plain.estimate, results.estimate)
    assert list(plain.perturbation.values) == ["noise", "prbs"]
    assert "perturbation" in plain.coords
    same(read_results(finished), results)


def test_each_trial_has_a_chunk_of_its_own(finished):
    chunks = [file for file in (finished / "estimate" / "c").rglob("*") if file.is_file()]
    assert len(chunks) == 2 * 3
    assert {file.stat().st_size for file in chunks} == {2 * 3 * 200 * 8}


def test_a_finished_study_is_not_run_again(copy, results):
    found, count = rerun(copy)
    assert count == 0
    same(found, results)


@pytest.mark.parametrize("name", ["estimate", "vaf", "checksums"])
@pytest.mark.parametrize("left", [0, 11, None])
def test_a_chunk_that_is_missing_or_cut_short_is_run_again(copy, results, name, left):
    chunk = next(file for file in sorted((copy / name / "c").rglob("*")) if file.is_file())
    if left is None:
        chunk.unlink()
    else:
        os.truncate(chunk, left)
    found, count = rerun(copy)
    assert count == 1
    same(found, results)


@pytest.mark.parametrize("count", [1, 5, 20, 60, 200])
def test_a_loss_of_power_that_cuts_the_newest_files_short_loses_only_their_trials(copy, results, count):
    newest = sorted((file for file in copy.rglob("*") if file.is_file()), key=lambda file: file.stat().st_mtime_ns)
    random = np.random.default_rng(count)
    for file in newest[-count:]:
        os.truncate(file, random.integers(0, max(1, file.stat().st_size)))
    found, rerun_trials = rerun(copy)
    assert 1 <= rerun_trials <= 6
    same(found, results)


def test_the_leavings_of_a_kill_are_cleared_away(copy):
    partial = copy / "estimate" / "c" / "0" / "0" / "0" / "0" / "0.abc.partial"
    partial.write_bytes(b"half")
    leftover, mine = copy.parent / ".results.zarr.new", copy.parent / ".results.zarr-mine"
    leftover.mkdir()
    (leftover / "half").touch()
    mine.mkdir()
    rerun(copy)
    assert not partial.exists()
    assert not leftover.exists()
    assert mine.exists()


def test_damage_is_refused_and_the_file_named(copy):
    chunk = copy / "estimate" / "c" / "1" / "2" / "0" / "0" / "0"
    content = bytearray(chunk.read_bytes())
    content[5] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(tv.InputError, match=r"estimate/c/1/2/0/0/0: this file does not hold what was written there"):
        rerun(copy)
    chunk.unlink()
    assert rerun(copy)[1] == 1


@pytest.mark.parametrize("name", ["estimate/zarr.json", "duration_s/c/0", "zarr.json"])
def test_damaged_metadata_is_refused(copy, name):
    file = copy / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(tv.InputError, match=r"damaged|store is of"):
        rerun(copy)


def test_the_store_of_another_study_is_refused_with_what_differs(copy):
    other = Study(**SMALL | {"trials": 4, "seed": 7})
    with pytest.raises(tv.InputError, match=r"of another study: trials: 3 there, 4 here; seed: 0 there, 7 here; give"):
        run(other, store=copy, workers=1)


def test_the_store_of_another_version_is_refused_with_what_differs(copy):
    root = copy / "zarr.json"
    found = json.loads(root.read_text())
    found["attributes"]["versions"] = json.dumps(versions() | {"numpy": "1.26.0"})
    root.write_text(json.dumps(found))
    with pytest.raises(tv.InputError, match=r"of other versions of the software: numpy: 1.26.0 there, \S+ here"):
        rerun(copy)
    found["attributes"]["layout"] = 99
    root.write_text(json.dumps(found))
    with pytest.raises(tv.InputError, match=r"layout 5, found .*layout 99"):
        rerun(copy)
    with pytest.raises(tv.InputError, match=r"layout 5, found .*layout 99"):
        read_results(copy)


def test_a_method_that_was_changed_is_another_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    source = (
        "class Model:\n    stiffness = [GAIN] * 200\n"
        "    def predict(self, e):\n        return GAIN * e.angle[:, e.core]\n"
        "class Mine:\n    def identify(self, ensemble):\n        return Model()\n"
    )
    (tmp_path / "changing.py").write_text(source.replace("GAIN", "90.0"))
    study = Study(duration_s=40, trials=1, perturbation="prbs", methods="changing:Mine")
    run(study, store=tmp_path / "results.zarr", workers=1)
    run(study, store=tmp_path / "results.zarr", workers=1)
    (tmp_path / "changing.py").write_text(source.replace("GAIN", "100.0"))
    with pytest.raises(tv.InputError, match=r"files were other ones .*changing:Mine: \w{12} there, \w{12} here"):
        run(study, store=tmp_path / "results.zarr", workers=1)


def test_something_else_in_the_way_is_refused(tmp_path):
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.write_text("mine")
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    for place in (file, folder):
        with pytest.raises(tv.InputError, match="something else is in the way"):
            run(STUDY, store=place, workers=1)
    assert file.read_text() == "mine"
    assert [item.name for item in folder.iterdir()] == ["mine.txt"]
    foreign = tmp_path / "foreign.zarr"
    xr.Dataset({"a": ("x", np.arange(3.0))}).to_zarr(foreign, zarr_format=3, consolidated=False)
    with pytest.raises(tv.InputError, match=r"found .something else., layout none"):
        run(STUDY, store=foreign, workers=1)
    for place in (file, folder, foreign):
        with pytest.raises(tv.InputError, match=r"no such folder|no store of results|layout none"):
            read_results(place)


def test_two_processes_cannot_write_to_one_store(copy):
    with (
        open_store(copy, layout_of(STUDY)),
        pytest.raises(tv.InputError, match="another process is writing to this store"),
    ):
        rerun(copy)
    rerun(copy)


def test_failed_trials_are_tried_again(tmp_path, results):
    path = tmp_path / "results.zarr"
    with open_store(path, layout_of(STUDY)) as opened:
        outcome = store_outcome(results, 0, 1)
        outcome["failure"][0] = "it was a bad day"
        opened.write((0, 1), outcome)
        assert len(opened.missing()) == 6
    found, count = rerun(path)
    assert count == 6
    same(found, results)


def store_outcome(results, scenario, trial):
    names = list(OF_TRIAL)
    return {name: np.array(results[name].values[scenario, trial]) for name in names}


def test_a_failure_never_takes_the_place_of_a_result(tmp_path, results):
    path = tmp_path / "results.zarr"
    with open_store(path, layout_of(STUDY)) as opened:
        good, bad = store_outcome(results, 0, 1), store_outcome(results, 0, 1)
        good["failure"][1] = "kbr failed the first time"
        good["estimate"][1] = np.nan
        opened.write((0, 1), good)
        bad["failure"][0] = "sds failed the second time"
        bad["estimate"][0] = np.nan
        opened.write((0, 1), bad)
        assert (0, 1) not in opened.missing()
    np.testing.assert_array_equal(read_results(path).estimate[0, 1], results.estimate[0, 1])


@pytest.mark.parametrize("left", [0, 100, None])
def test_torn_results_are_not_read(copy, left):
    chunk = copy / "estimate" / "c" / "1" / "2" / "0" / "0" / "0"
    chunk.unlink() if left is None else os.truncate(chunk, left)
    with pytest.raises(tv.InputError, match=r"1 results are cut short.*give the command that ran the study again"):
        read_results(copy)


def test_damaged_results_are_not_read(copy):
    chunk = copy / "vaf" / "c" / "1" / "2" / "0" / "0"
    chunk.write_bytes(bytes(reversed(chunk.read_bytes())))
    with pytest.raises(tv.InputError, match=r"vaf/c/1/2/0/0: this file does not hold what was written there"):
        read_results(copy)


def test_written_trials_are_there_and_others_missing(tmp_path, results):
    path = tmp_path / "results.zarr"
    with open_store(path, layout_of(STUDY)) as opened:
        opened.write((1, 0), store_outcome(results, 1, 0))
        assert (1, 0) not in opened.missing()
        assert len(opened.missing()) == 5
    part = read_results(path)
    assert part.checksums.values.any(axis=-1).sum() == 1
    np.testing.assert_array_equal(part.estimate[1, 0], results.estimate[1, 0])
    assert np.isnan(part.estimate.sel(quantity="stiffness")[0]).all()


def test_unfinished_results_are_scored(tmp_path, results):
    path = tmp_path / "results.zarr"
    with open_store(path, layout_of(STUDY)) as opened:
        for trial in range(2):
            opened.write((1, trial), store_outcome(results, 1, trial))
    scores = tv.study.score(read_results(path))
    assert scores.trials.values.tolist() == [[0, 0], [2, 2]]
    assert np.isnan(scores.value.sel(metric="bias_error").values[0]).all()
    two = results.estimate.sel(quantity="stiffness").values[1, :2, 0]
    assert scores.value.sel(metric="random_error").values[1, 0] == tv.metrics.random_error(two)
