"""Files of tasks: whole or run again, and named by all that their scores depend on."""

import numpy as np
import pytest
from tests.study.conftest import same

import tvsysid as tv
from tvsysid.study import Study, read_results, run
from tvsysid.study.tasks import read_scores, write_scores
from tvsysid.study.trials import tasks_of

SETTINGS = {"duration_s": 40.0, "trials": 2, "perturbation": "prbs", "methods": ["sds"]}


def flipped(content, place):
    changed = bytearray(content)
    changed[place] ^= 1 << place % 8
    return bytes(changed)


def counted(folder, **settings):
    """Run a study, and return how many of its tasks were done at each moment, and the results."""
    counts = []
    study = Study(**SETTINGS | settings)
    results = run(study, folder, workers=1, progress=lambda *each: counts.append(each))
    return counts, results


def test_a_changed_byte_is_noticed_or_changes_nothing(tmp_path):
    scores = {"estimate": np.arange(4.0), "failure": np.array(["", "too few", "", ""])}
    file = tmp_path / "task.npz"
    write_scores(scores, file)
    content = file.read_bytes()
    expected = {name: each.tolist() for name, each in scores.items()}
    for place in range(len(content)):
        file.write_bytes(flipped(content, place))
        found = {name: each.tolist() for name, each in read_scores(file).items()}
        assert found in ({}, expected), place
        file.write_bytes(content[:place])
        assert not read_scores(file)
    file.unlink()
    assert not read_scores(file)


@pytest.mark.slow
def test_missing_cut_and_damaged_files_are_made_again(tmp_path):
    _, expected = counted(tmp_path, trials=4)
    _, cut, damaged, missing = sorted((tmp_path / "tasks").iterdir())
    cut.write_bytes(cut.read_bytes()[:-100])
    damaged.write_bytes(flipped(damaged.read_bytes(), 5000))
    missing.unlink()
    counts, results = counted(tmp_path, trials=4)
    assert counts == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert len(list((tmp_path / "tasks").iterdir())) == 4
    same(results, expected)


@pytest.mark.slow
def test_results_that_are_missing_or_damaged_are_refused_and_made_again(tmp_path):
    with pytest.raises(tv.InputError, match=r"results\.nc: this file is missing"):
        read_results(tmp_path)
    counted(tmp_path)
    file = tmp_path / "results.nc"
    content = file.read_bytes()
    for fault in (content[:-9], b""):
        file.write_bytes(fault)
        with pytest.raises(tv.InputError, match=r"results\.nc: this file is damaged"):
            read_results(tmp_path)
    _, results = counted(tmp_path)
    same(read_results(tmp_path), results)


@pytest.mark.slow
def test_a_folder_can_hold_several_studies(tmp_path):
    counted(tmp_path)
    counts, more = counted(tmp_path, trials=3)
    assert counts == [(2, 3), (3, 3)]
    assert more.sizes["trial"] == 3
    assert counted(tmp_path, methods=["birf"])[0][0] == (0, 2)
    counts, again = counted(tmp_path)
    assert counts == [(2, 2)]
    assert list(again.method_key.values) == ["sds"]


class Plain(tv.Method):
    """A method whose repr does not show its settings."""

    def __init__(self, size):
        self.size = size

    def fit(self, ensemble):
        return tv.Model.of(ensemble, 100.0 * self.size)


def names_of(**settings):
    return {task.file_name for task in tasks_of(Study(**SETTINGS | settings))}


def test_all_that_scores_depend_on_is_in_the_name():
    names = names_of()
    assert len(names) == 2
    assert names == names_of()
    assert names < names_of(trials=3)
    for change in (
        {"seed": 1},
        {"methods": ["sds:window=0.2"]},
        {"snr_db": 20},
        {"rate": 50},
        {"subtract_mean": True},
        {"system": "reflex"},
    ):
        assert not names & names_of(**change), change
    assert not names_of(methods=Plain(1)) & names_of(methods=Plain(2))
