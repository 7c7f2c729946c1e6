import json
import os
import pickle
import shutil
import warnings

import numpy as np
import pytest
import xarray as xr
from tests.study.conftest import SMALL, TIMES

import tvsysid as tv
from tvsysid.cli.report import report
from tvsysid.study import Study, fixed, read_results, run, store
from tvsysid.study.contents import OF_TRIAL, layout_of
from tvsysid.study.store import open_store
from tvsysid.study.task import versions

STUDY = Study(**SMALL)


MADE = {}


@pytest.fixture(autouse=True)
def _made_once(monkeypatch):
    """Files of a store without results follow from its layout alone, and take long."""

    def made(layout, make=fixed.contents_of):
        key = pickle.dumps(layout)
        if key not in MADE:
            MADE[key] = make(layout)
        return dict(MADE[key])

    monkeypatch.setattr(fixed, "contents_of", made)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "results.zarr"
    run(STUDY, store=path, workers=1)
    return path


@pytest.fixture
def copy(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "results.zarr")


def rerun(path):
    """Resume a study, count the trials that run, and check that the results are the same."""
    seen = []
    found = run(STUDY, store=path, workers=1, progress=lambda done, total: seen.append(done))
    return found, len(seen) - 1


def same(one, other):
    xr.testing.assert_identical(one.load().drop_vars(TIMES), other.drop_vars(TIMES))


@pytest.mark.slow
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
@pytest.mark.parametrize(
    "left", [0, *(pytest.param(each, marks=pytest.mark.slow) for each in (11, -2)), "blank", None]
)
def test_a_chunk_that_is_missing_or_cut_short_is_run_again(copy, results, name, left):
    tear(next(file for file in sorted((copy / name / "c").rglob("*")) if file.is_file()), left)
    found, count = rerun(copy)
    assert count == 1
    same(found, results)


@pytest.mark.parametrize(
    "count", [1, 5, 20, *(pytest.param(each, marks=pytest.mark.slow) for each in (60, 200))]
)
def test_a_loss_of_power_that_cuts_the_newest_files_short_loses_only_their_trials(
    copy, results, count
):
    newest = sorted(
        (file for file in copy.rglob("*") if file.is_file()),
        key=lambda file: file.stat().st_mtime_ns,
    )
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
    flip(chunk, 0)
    with pytest.raises(
        tv.InputError, match=r"estimate/c/1/2/0/0/0: this file does not hold what was written there"
    ):
        rerun(copy)
    chunk.unlink()
    assert rerun(copy)[1] == 1


FIXED = ["estimate/zarr.json", "duration_s/c/0", "truth/c/0/0/0", "truth/zarr.json", "zarr.json"]


@pytest.mark.parametrize("name", FIXED)
def test_damaged_metadata_is_refused_whoever_reads_and_made_again_when_it_is_removed(
    copy, results, name
):
    flip(copy / name)
    for read in (rerun, read_results):
        with pytest.raises(
            tv.InputError,
            match=rf"{name}: this file does not hold what was written there; remove it;",
        ):
            read(copy)
    (copy / name).unlink()
    found, count = rerun(copy)
    assert count == 0
    same(found, results)


@pytest.mark.parametrize(
    ("name", "left"),
    [
        *zip(FIXED, [11, 0, "blank", None, "blank"], strict=True),
        ("zarr.json", None),
        ("manifest", 11),
    ],
)
def test_metadata_cut_short_is_not_read_and_made_again_by_the_command(copy, results, name, left):
    tear(copy / name, left)
    expected = (
        rf"incomplete: missing or cut short, as a loss of power leaves them: {name}; give "
        rf"the command that ran"
    )
    with pytest.raises(tv.InputError, match=expected):
        read_results(copy)
    found, count = rerun(copy)
    assert count == 0
    same(found, results)
    same(read_results(copy), results)


def test_a_report_of_a_store_that_lost_files_names_the_command_that_makes_them_again(copy, results):
    for name in ("zarr.json", "manifest"):
        tear(copy / name, "blank")
    with pytest.raises(
        tv.InputError, match=r"zarr.json and manifest are missing or cut short; give the command"
    ):
        report(copy.parent)
    same(rerun(copy)[0], results)


def flip(file, place=0.5):
    content = bytearray(file.read_bytes())
    content[int(place * len(content))] ^= 1
    file.write_bytes(content)


def tear(file, left):
    if left is None:
        file.unlink()
    elif left == "blank":
        file.write_bytes(bytes(file.stat().st_size))
    else:
        os.truncate(file, left % file.stat().st_size)


def test_chunks_that_changed_places_are_damage(copy, results):
    """Each has what its checksums say, but those say of which task they are."""
    there, here = ([*copy.glob(f"*/c/{place}")] for place in ("0/1", "1/2"))
    for one, other in zip(sorted(there), sorted(here), strict=True):
        one.rename(other.parent / "x")
        other.rename(one)
        (other.parent / "x").rename(other)
    with pytest.raises(
        tv.InputError, match=r"2 files do not hold .*: \S+checksums/c/0/1/0, \S+checksums/c/1/2/0;"
    ):
        read_results(copy)
    for name in ("0/1", "1/2"):
        (copy / "checksums" / "c" / name / "0").unlink()
    found, count = rerun(copy)
    assert count == 2
    same(found, results)


def test_tasks_of_another_study_are_damage(copy, results, tmp_path):
    other = Study(**SMALL | {"seed": 7})
    with open_store(tmp_path / "other.zarr", layout_of(other)) as opened:
        opened.write((0, 1), store_outcome(results, 1, 2))
    for chunk in tmp_path.glob("other.zarr/*/c/0/1"):
        shutil.copytree(
            chunk, copy / chunk.relative_to(tmp_path / "other.zarr"), dirs_exist_ok=True
        )
    with pytest.raises(
        tv.InputError, match=r"checksums/c/0/1/0: this file does not hold what was written there"
    ):
        read_results(copy)


@pytest.mark.parametrize("name", ["estimate/c/1/2/0/0/0", "truth/zarr.json", "checksums/c/1/2/0"])
def test_what_is_no_file_is_not_read_and_can_be_moved_away(copy, results, name):
    (copy / name).unlink()
    (copy / name).mkdir()
    for read in (rerun, read_results):
        with pytest.raises(
            tv.InputError, match=rf"{name}: expected a file, found something else; move it away"
        ):
            read(copy)
    (copy / name).rmdir()
    os.mkfifo(copy / name)  # opening it would wait for ever
    with pytest.raises(tv.InputError, match="expected a file"):
        read_results(copy)
    (copy / name).rename(copy.parent / "moved")
    same(rerun(copy)[0], results)
    folder = (copy / name).parent
    folder.rename(copy.parent / "chunks")
    folder.touch()
    with pytest.raises(
        tv.InputError,
        match=rf"{name}: this file cannot be read: Not a directory; .* move away what",
    ):
        read_results(copy)


@pytest.mark.skipif(
    os.name != "posix" or os.geteuid() == 0, reason="the superuser reads everything"
)
def test_a_file_that_may_not_be_read(copy):
    (copy / "truth" / "c" / "0" / "0" / "0").chmod(0)
    with pytest.raises(tv.InputError, match="cannot be read: Permission denied; make it readable"):
        read_results(copy)


def test_links_are_followed_and_their_content_verified(copy, results):
    folder, chunk = copy / "truth", copy / "estimate" / "c" / "1" / "2" / "0" / "0" / "0"
    for path in (folder, chunk):
        elsewhere = copy.parent / path.name
        path.rename(elsewhere)
        path.symlink_to(elsewhere)
    same(read_results(copy), results)
    flip(copy.parent / "truth" / "c" / "0" / "0" / "0")
    with pytest.raises(tv.InputError, match="truth/c/0/0/0: this file does not hold"):
        read_results(copy)
    shutil.rmtree(copy.parent / "truth")
    folder.unlink()
    chunk.resolve().unlink()
    with pytest.raises(
        tv.InputError, match=r"incomplete: .*truth/zarr.json, truth/c/0/0/0; give the command"
    ):
        read_results(copy)
    found, count = rerun(copy)
    assert count == 1
    same(found, results)


@pytest.mark.parametrize("share", [0.02, 0.7])
def test_a_store_that_was_copied_in_part(copy, results, share):
    files = sorted(file for file in copy.rglob("*") if file.is_file())
    np.random.default_rng(int(100 * share)).shuffle(files)
    for file in files[: int(share * len(files))]:
        file.unlink()
    with pytest.raises(
        tv.InputError, match=r"cut short.*give the command that ran the study again"
    ):
        read_results(copy)
    same(rerun(copy)[0], results)
    same(read_results(copy), results)


def test_files_that_are_none_of_the_study_are_left_alone(copy, results):
    (copy / "notes.txt").write_text("mine")
    shutil.copytree(copy / "truth", copy / "truth2")
    (copy / "estimate" / "c" / "7" / "7").mkdir(parents=True)
    same(read_results(copy), results)
    same(rerun(copy)[0], results)
    assert (copy / "notes.txt").read_text() == "mine"


def test_nothing_is_read_of_a_task_that_is_not_done(copy, results):
    """A kill leaves chunks whose checksums are not written yet; nobody knows what they hold."""
    flip(copy / "estimate" / "c" / "1" / "2" / "0" / "0" / "0")
    (copy / "checksums" / "c" / "1" / "2" / "0").unlink()
    part = read_results(copy)
    assert np.isnan(part.estimate.values[1, 2]).all()
    assert part.checksums.values.any(axis=-1).sum() == 5
    found, count = rerun(copy)
    assert count == 1
    same(found, results)


def test_results_that_are_read_when_they_are_used_are_verified_too(copy, results, monkeypatch):
    monkeypatch.setattr(store, "IN_MEMORY", 0)
    same(pickle.loads(pickle.dumps(read_results(copy))), results)  # as figures get them
    (copy / "checksums" / "c" / "1" / "2" / "0").unlink()
    part = read_results(copy)
    np.testing.assert_array_equal(part.estimate.values[1, :2], results.estimate.values[1, :2])
    assert np.isnan(part.estimate.values[1, 2]).all()
    part = read_results(copy)
    flip(copy / "estimate" / "c" / "0" / "1" / "0" / "0" / "0")
    with pytest.raises(tv.InputError, match="estimate/c/0/1/0/0/0: this file does not hold"):
        part.estimate.load()


def test_the_store_of_another_study_is_refused_with_what_differs(copy):
    other = Study(**SMALL | {"trials": 4, "seed": 7})
    with pytest.raises(
        tv.InputError,
        match=r"of another study: trials: 3 there, 4 here; seed: 0 there, 7 here; give",
    ):
        run(other, store=copy, workers=1)


def test_the_store_of_another_version_is_refused_with_what_differs(copy):
    root = copy / "zarr.json"
    found = json.loads(root.read_text())
    manifest = copy / fixed.MANIFEST
    sums = fixed._manifest(copy).sums

    def of_that_version():
        """Write the store's metadata as another version would have."""
        root.write_text(json.dumps(found))
        manifest.write_bytes(
            fixed._manifest_of({name: (copy / name).read_bytes() for name in sums})
        )

    found["attributes"]["versions"] = json.dumps(versions() | {"numpy": "1.26.0"})
    of_that_version()
    with pytest.raises(
        tv.InputError,
        match=r"of other versions of the software: numpy: 1.26.0 there, \S+ here; give",
    ):
        rerun(copy)
    tear(root, "blank")  # then only the manifest knows
    with pytest.raises(
        tv.InputError,
        match=r"of another study: zarr.json: \d+ there, \d+ here; give another folder",
    ):
        rerun(copy)
    found["attributes"]["layout"] = 99
    of_that_version()
    for read in (rerun, read_results):
        with pytest.raises(
            tv.InputError, match=r"layout 6, found .*layout 99; give another folder$"
        ):
            read(copy)
    manifest.unlink()  # a layout that had none
    for read in (rerun, read_results):
        with pytest.raises(
            tv.InputError, match=r"layout 99; if \S+zarr.json is damaged, remove that file and run"
        ):
            read(copy)


def test_a_method_that_was_changed_is_another_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    source = (
        "import tvsysid as tv\n"
        "class Mine(tv.Method):\n"
        "    def fit(self, ensemble):\n        return tv.Model.of(ensemble, GAIN)\n"
    )
    (tmp_path / "changing.py").write_text(source.replace("GAIN", "90.0"))
    study = Study(duration_s=40, trials=1, perturbation="prbs", methods="changing:Mine")
    run(study, store=tmp_path / "results.zarr", workers=1)
    run(study, store=tmp_path / "results.zarr", workers=1)
    (tmp_path / "changing.py").write_text(source.replace("GAIN", "100.0"))
    with pytest.raises(
        tv.InputError, match=r"files were other ones .*changing:Mine: \w{12} there, \w{12} here"
    ):
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


@pytest.mark.parametrize("left", [0, 100, "blank", None])
def test_torn_results_are_not_read(copy, left):
    tear(copy / "estimate" / "c" / "1" / "2" / "0" / "0" / "0", left)
    with pytest.raises(
        tv.InputError, match=r"1 results are cut short.*give the command that ran the study again"
    ):
        read_results(copy)


def test_damaged_results_are_not_read(copy):
    chunk = copy / "vaf" / "c" / "1" / "2" / "0" / "0"
    chunk.write_bytes(bytes(reversed(chunk.read_bytes())))
    with pytest.raises(
        tv.InputError, match=r"vaf/c/1/2/0/0: this file does not hold what was written there"
    ):
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
