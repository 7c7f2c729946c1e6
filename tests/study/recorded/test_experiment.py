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
    assert [item.label for item in experiment.recordings][:3] == ["P1-noise", "P1-prbs", "P2-noise"]
    assert len(experiment.recordings) == 12
    assert [item.label for item in experiment.analyses] == [
        *(
            "eirf-75",
            "eirf-150",
            "sds-75",
            "sds-150",
            "birf-75",
            "birf-150",
            "esm-75",
            "esm-150",
            "kbr-20",
            "kbr-40",
        )
    ]
    assert experiment.bootstraps == 100
    methods = experiment.named_methods
    samples = {name: round(128 * methods[name].max_lag, 9) for name in ("eirf", "sds", "birf")}
    assert samples == {"eirf": 15, "sds": 15, "birf": 15}
    assert (128 * methods["sds"].window, 128 * methods["esm"].window) == (12, 30)
    assert methods["kbr"] == KBR


def test_files_take_the_place_of_virtual_participants(tmp_path):
    experiment = Experiment(participants={"anna": {"walking": "anna*.mat"}}, reading=READING)
    assert [item.label for item in experiment.recordings] == ["anna-walking"]
    both = Experiment(
        participants={"anna": {"noise": "anna*.mat"}},
        reading=READING,
        virtual=2,
        perturbation="noise",
    )
    assert [item.label for item in both.recordings] == ["anna-noise", "P2-noise"]


def test_methods_are_texts_or_objects_with_as_many_realizations():
    experiment = Experiment(
        methods=["kbr", tv.BasisIRF(), "sds:window=0.1", "kbr:gamma=9"], realizations=[40]
    )
    assert [item.label for item in experiment.analyses] == [
        *("kbr-40", f"{tv.BasisIRF()!r}-40", "sds:window=0.1-40", "kbr:gamma=9-40")
    ]
    assert experiment.named_methods["kbr"] == KBR
    assert experiment.named_methods["sds:window=0.1"].window == 0.1


def test_settings_that_are_told_make_the_same_experiment_again(tmp_path):
    experiment = Experiment(
        participants={"a": {"noise": ["x.mat", "y.mat"]}}, reading=READING, folder=tmp_path,
        virtual=3,
        preparation={"reference": None, "period": 1.5}, methods=["sds", "kbr"],
    )  # fmt: skip
    again = Experiment(**json.loads(experiment.to_json()))
    assert again.to_json() == experiment.to_json()
    assert again.preparation["reference"] is None
    assert again.analyses == experiment.analyses
    assert again.recordings == experiment.recordings


def test_a_toml_file_says_the_same(tmp_path):
    (tmp_path / "study.toml").write_text(
        "perturbation = 'noise'\nbootstraps = 7\nrealizations = [30]\nmethods = ['sds', "
        "'sds:window=0.2']\n[participants.P1]\nnoise = "
        "'P1/*.mat'\n[reading]\nangle = 'pos'\ntorque = 'tq'\nsampling_rate = 1000\ntorque_sign = "
        "-1\n[preparation]\nreference = false\nends = 0\nperiod = 1.5\n"
    )
    experiment = Experiment.from_toml(tmp_path / "study.toml", bootstraps=9)
    assert experiment.folder == str(tmp_path)
    assert (experiment.bootstraps, experiment.preparation["reference"]) == (9, None)
    assert [item.label for item in experiment.analyses] == ["sds-30", "sds:window=0.2-30"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bootstraps": 1}, r"bootstraps must be a whole number of 2 or more, got 1"),
        ({"methods": "nosuch"}, r"unknown method 'nosuch'"),
        (
            {"methods": ["sds", "sds"]},
            r"methods: .* each with a name of its own; got sds-75, sds-150, sds-75",
        ),
        ({"perturbation": "pbrs"}, r"participants: expected at least 1"),
        (
            {"participants": {"a": {"noise": "a.mat"}}},
            r"reading: files need it: which channels are angle and torque",
        ),
        (
            {"reading": {"angle": "pos", "torque": "tq"}},
            r"sampling_rate is missing; add --rate",
        ),
        (
            {"preparation": {"ratee": 1}},
            r"preparation.ratee: unknown key \(known: reference, rate, ends",
        ),
        (
            {"virtual": [1, 1]},
            r"participants: .* a name of its own; got P1-noise, P1-prbs, P1-noise",
        ),
        (
            {"participants": {"A": "a.mat"}, "reading": READING},
            r"files by participant and perturbation.*got {'A': 'a.mat'}",
        ),
        *(
            ({"participants": {name: {"noise": "a"}}, "reading": READING}, "cannot name a file")
            for name in ("a/b", "a\0", "=a", ".a", "a" * 81)
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


def test_draws_depend_on_the_recording_and_the_number_of_realizations_alone():
    one, two = (
        Experiment(methods="sds"),
        Experiment(methods=["kbr", "birf"], virtual=[2], bootstraps=5),
    )
    recorded = next(item for item in one.recordings if item.label == "P2-noise")
    assert one.seed_of(recorded, 75) == two.seed_of(two.recordings[0], 75)
    seeds = {one.seed_of(item, count) for item in one.recordings for count in (75, 150)}
    assert len(seeds) == 24
    assert one.seed_of(recorded, 75) != Experiment(seed=1).seed_of(recorded, 75)
