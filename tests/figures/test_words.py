import pandas as pd

from tvsysid.figures.words import described, differing, perturbation_name, trait, unit_name, wrapped

SCENARIO = {
    "system": "joint",
    "profile": "square",
    "perturbation": "noise",
    "duration_s": 150.0,
    "snr_db": 10.0,
}
SCENARIO["viscosity"] = "constant"


def test_perturbations_and_units_have_names():
    assert (perturbation_name("noise"), perturbation_name("steps")) == ("filtered noise", "steps")
    assert [unit_name(unit) for unit in ("N m s/rad", "kg m2", "1")] == ["N·m·s/rad", "kg·m²", "–"]


def differing_of(*scenarios):
    return differing(pd.DataFrame(scenarios))


def test_traits_in_words():
    pairs = [("duration_s", 40.0), ("perturbation", "prbs"), ("viscosity", "covarying")]
    assert [trait(*pair) for pair in pairs] == ["40 s", "PRBS", "b covarying"]
    assert differing_of(SCENARIO, SCENARIO | {"perturbation": "prbs"}) == ["noise", "PRBS"]
    variants = [
        "reflex:reflex_gain=4,noise_bandwidth=1",
        "reflex:reflex_gain=8,noise_bandwidth=1",
        "reflex",
    ]
    told = differing_of(*(SCENARIO | {"system": each} for each in variants[:2]))
    assert told == ["reflex gain=4", "reflex gain=8"]  # what all share says nothing
    assert differing_of(*(SCENARIO | {"system": each} for each in variants[1:])) == [
        "reflex gain=8, noise bandwidth=1",
        "",
    ]
    assert described(SCENARIO) == "square-wave stiffness, filtered noise, 150 s, 10 dB"


def test_labels_are_broken_behind_punctuation():
    assert wrapped("sds:window=0.2,max_lag=0.1", 16) == "sds:window=0.2,\nmax_lag=0.1"
    assert wrapped("kbr:weighting=residual", 17) == "kbr:weighting=\nresidual"
