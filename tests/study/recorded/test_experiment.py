"""What may be studied, and what is said of what may not."""

import json
import math

import pytest

import tvsysid as tv
from tvsysid.study import Experiment

KBR = tv.KernelRegression(length_periodic=math.exp(-1), length_decay=30.0, gamma=13.8)

READING = {"angle": "pos", "torque": "tq", "sampling_rate": 1000}


def test_by_default_it_is_the_papers_on_six_virtual_participants():
    experiment = Experiment()
    assert [item.label for item in experiment.recordings] == [
        f"P{number}-{perturbation}" for number in range(1, 7) for perturbation in ("noise", "prbs")
    ]
    counts = {**dict.fromkeys(("eirf", "sds", "birf", "esm"), (75, 150)), "kbr": (20, 40)}
    assert [item.label for item in experiment.analyses] == [
        f"{name}-{count}" for name, pair in counts.items() for count in pair
    ]
    assert experiment.bootstraps == 100
    methods = {each.name: each.method for each in experiment.analyses}
    samples = [round(128 * methods[name].max_lag, 9) for name in ("eirf", "sds", "birf")]
    assert samples == [15, 15, 15]
    assert (128 * methods["sds"].window, 128 * methods["esm"].window) == (12, 30)
    assert methods["kbr"] == KBR


def test_files_take_the_place_of_virtual_participants_and_both_may_be_named():
    files = {"participants": {"anna": {"walking": "a*.mat", "noise": "b.mat"}}, "reading": READING}
    files["preparation"] = {"period": 2}
    for settings, labels in (
        ({}, ["anna-walking", "anna-noise"]),
        ({"virtual": 2, "perturbation": "noise"}, ["anna-noise", "P2-noise"]),
    ):
        experiment = Experiment(**files, **settings)
        assert [item.label for item in experiment.recordings] == labels


def test_methods_are_texts_or_objects_with_as_many_realizations():
    texts = ["kbr", "sds:window=0.1", "kbr:gamma=9"]
    experiment = Experiment(methods=[*texts, tv.BasisIRF()], realizations=[40])
    assert [item.label for item in experiment.analyses] == [
        f"{name}-40" for name in (*texts, repr(tv.BasisIRF()))
    ]
    assert experiment.analyses[0].method == KBR
    assert experiment.analyses[1].method.window == 0.1


def test_settings_that_are_told_make_the_same_experiment_again(tmp_path):
    experiment = Experiment(
        participants={"a": {"noise": ["x.mat", "y.mat"]}}, reading=READING, folder=tmp_path,
        virtual=3,
        preparation={"reference": None, "period": 1.5}, methods=["sds", "kbr"],
    )  # fmt: skip
    assert Experiment(**json.loads(experiment.to_json())) == experiment


def test_a_toml_file_says_the_same(tmp_path):
    (tmp_path / "study.toml").write_text(
        "perturbation = 'noise'\nbootstraps = 7\nrealizations = [30]\nmethods = ['sds']\n"
        "[participants.P1]\nnoise = 'P1/*.mat'\n[reading]\nangle = 'pos'\ntorque = 'tq'\n"
        "sampling_rate = 1000\n[preparation]\nreference = false\nends = 0\nperiod = 1.5\n"
    )
    preparation = {"reference": None, "ends": 0, "period": 1.5}
    assert Experiment.from_toml(tmp_path / "study.toml", bootstraps=9) == Experiment(
        participants={"P1": {"noise": "P1/*.mat"}}, reading=READING, folder=tmp_path,
        preparation=preparation, methods="sds", perturbation="noise", realizations=30, bootstraps=9,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bootstraps": 1}, r"bootstraps must be a whole number of 2 or more, got 1"),
        ({"methods": "nosuch"}, r"unknown method 'nosuch'"),
        ({"perturbation": "pbrs"}, r"participants: expected at least 1"),
        (
            {"participants": {"a": {"noise": "a.mat"}}},
            r"reading: files need it: which channels are angle and torque",
        ),
        (
            {"reading": {"angle": "pos", "torque": "tq"}},
            r"missing: sampling_rate; add --rate",
        ),
        (
            {"reading": READING},
            "preparation.period: a setting is missing",
        ),
        (
            {"preparation": {"ratee": 1}},
            r"preparation.ratee: unknown key \(known: reference, rate, ends",
        ),
        (
            {"participants": {"A": "a.mat"}, "reading": READING, "preparation": {"period": 2}},
            r"files by participant and perturbation.*got {'A': 'a.mat'}",
        ),
        ({"reading": READING | {"strat": 1}}, r"reading.strat: unknown key"),
        ({"virtual": []}, r"participants: expected at least 1"),
        ({"realizations": 1}, r"realizations must be a whole number of 2 or more, got 1"),
        (
            {"methods": [3]},
            r"expected the key of a method, or a tvsysid.Method; got 3",
        ),
    ],
)
def test_what_is_wrong_is_told_by_key(settings, message):
    with pytest.raises(tv.InputError, match=message):
        Experiment(**settings)


@pytest.mark.parametrize(
    ("recorded", "period", "rate"),
    [(1000, 2.0, 125), (1000, 1.5, 100), (2048, 2.0, 128), (60, 2.0, 60)],
)
def test_the_default_rate_divides_that_of_the_files_and_nothing_is_aligned(recorded, period, rate):
    reading = READING | {"sampling_rate": recorded}
    experiment = Experiment(reading=reading, preparation={"period": period})
    assert (experiment.preparation["rate"], experiment.preparation["reference"]) == (rate, None)
    named = Experiment(
        reading=reading | {"channels": {"target": "level"}}, preparation={"period": period}
    )
    assert named.preparation["reference"] == "target"


def test_draws_depend_on_the_recording_and_the_number_of_realizations_alone():
    one, two = Experiment(methods="sds"), Experiment(methods="kbr", virtual=2, bootstraps=5)
    recorded = two.recordings[0]
    assert one.seed_of(recorded, 75) == two.seed_of(recorded, 75)
    seeds = {one.seed_of(item, count) for item in one.recordings for count in (75, 150)}
    assert len(seeds) == 24
    assert one.seed_of(recorded, 75) != Experiment(seed=1).seed_of(recorded, 75)
