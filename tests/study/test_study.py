import json

import pytest

import tvsysid as tv
from tvsysid.studies import PRESETS, preset
from tvsysid.study import Study


def labels_of(study):
    return [scenario.label for scenario in study.scenarios]


def test_the_default_is_the_quick_study():
    assert Study() == preset("quick")
    assert labels_of(Study()) == ["square-noise-150s-10dB", "square-prbs-150s-10dB"]
    assert list(Study().parts["methods"]) == ["eirf", "sds", "birf", "esm", "kbr", "adaptive"]


def test_the_paper_s_study():
    study = preset("paper")
    assert labels_of(study) == [
        *(f"square-{p}-{d}s-10dB" for p in ("noise", "prbs") for d in (40, 80, 150, 300, 600)),
        *("sine-noise-150s-10dB", "sine-prbs-150s-10dB"),
    ]
    squares = [each for each in study.scenarios if each.stiffness == "square"]
    assert sum(each.duration_s for each in squares) * study.trials == 234_000


def test_covarying_viscosity_lies_between_1_and_3():
    study = Study(viscosity="covarying")
    joint = study.system_of(study.scenarios[0])
    truth = joint.simulate(4.0, perturbation=tv.simulate.PRBS(), snr_db=10, seed=0).truth
    for stiffness, viscosity in ((50, 1.0), (150, 3.0)):
        assert set(truth["viscosity"][truth["stiffness"] == stiffness]) == {viscosity}


def test_settings_take_the_place_of_a_preset_s_everywhere():
    study = preset("paper", duration_s=[40.0], trials=3)
    assert {(s.duration_s, s.stiffness) for s in study.scenarios} == {(40, "square"), (40, "sine")}
    assert study.trials == 3
    assert {s.stiffness for s in preset("paper", stiffness="sine").scenarios} == {"sine"}


def test_a_study_from_toml(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        'duration_s = [40, 80]\nperturbation = "prbs"\nsnr_db = [10, inf]\nmethods = '
        '["sds:window=0.2", "kbr"]\n'
        'trials = 7\n[[also]]\nstiffness = ["sine"]\nsnr_db = 0\n'
    )
    study = Study.from_toml(path)
    assert labels_of(study) == [
        "square-prbs-40s-10dB", "square-prbs-40s-infdB", "square-prbs-80s-10dB",
        "square-prbs-80s-infdB",
        "sine-prbs-40s-0dB", "sine-prbs-80s-0dB",
    ]  # fmt: skip
    assert list(study.parts["methods"]) == ["sds:window=0.2", "kbr"]
    assert Study.from_toml(path, trials=2).trials == 2
    assert json.loads(study.to_json())["also"] == [{"stiffness": ["sine"], "snr_db": 0}]


def test_a_toml_file_names_a_system_of_ones_own(tmp_path, monkeypatch):
    (tmp_path / "own_system.py").write_text("class Spring:\n    simulate = None\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "study.toml").write_text('[[also]]\nsystem = "own_system:Spring"\n')
    study = Study.from_toml(tmp_path / "study.toml")
    assert study.scenarios[-1].label == "own_system_Spring-square-prbs-150s-10dB"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trails = 3", r"study.toml: trails: unknown key \(known: stiffness"),
        ('duration_s = ["150 s"]', "duration_s must be a positive number, got '150 s'"),
        (
            "[[also]]\ntrials = 5",
            r"also: scenario .*trials: unknown key.*known: stiffness, .* system, methods\)",
        ),
        ("trials = ", "study.toml: Invalid value"),
        ('also = "sine"', "scenario 'sine'"),
        ("also = [3]", "also"),
    ],
)
def test_a_wrong_file_is_refused_and_the_key_named(tmp_path, text, message):
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(tv.InputError, match=message):
        Study.from_toml(path)


def test_an_unknown_preset_is_refused():
    with pytest.raises(tv.InputError, match=f"the presets are {', '.join(PRESETS)}"):
        preset("journal")


def test_seeds_differ_by_scenario_and_trial_and_pair_viscosities():
    study = Study(viscosity=["constant", "covarying"], perturbation=["noise", "prbs"])
    keys = [study.seed_of(each, trial).spawn_key for each in study.scenarios for trial in range(3)]
    assert len(set(keys)) == 6
    assert keys[:3] == keys[3:6]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"stiffness": ["step"]}, "unknown profile 'step'; expected one of square, sine, constant"),
        ({"perturbation": ["white"]}, "unknown perturbation 'white'; expected one of noise, prbs"),
        ({"methods": ["arx"]}, "unknown method 'arx'"),
        ({"methods": [3]}, "or a tvsysid.Method"),
        ({"viscosity": ["high"]}, "viscosity must be one of 'constant', 'covarying', got 'high'"),
        ({"trials": 0}, "trials must be a whole number of 1 or more, got 0"),
        ({"seed": -1}, "seed must be a whole number of 0 or more, got -1"),
        ({"duration_s": [float("nan")]}, "duration_s must be a positive number, got nan"),
        ({"snr_db": [float("nan")]}, "snr_db must be a number of decibels"),
    ],
)
def test_a_wrong_study_is_refused(settings, message):
    with pytest.raises(tv.InputError, match=message):
        Study(**settings)
