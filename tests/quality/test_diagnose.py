import re
import warnings

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests import faults
from tests.faults import cut, simulated

import tvsysid as tv
from tvsysid.quality import FAULTS, Finding


@pytest.fixture(scope="module")
def spoilt():
    return tv.diagnose(faults.mixed(cut(faults.late(simulated()))))


def test_a_finding_says_what_how_strong_what_it_does_and_what_to_do(spoilt):
    assert [check.name for check in spoilt.findings] == ["delay", "unlike-realizations"]
    delay, unlike = spoilt.findings
    assert delay.value == pytest.approx(30, abs=0.5)
    assert unlike.strength == "11 realizations, should be at most 0"
    assert unlike.what.endswith("outliers (realizations 1, 8, 15, 22, 29, 36, 43, 50, 57, 64, …)")
    assert re.search(
        r"^Diagnosis of 75 realizations of 2 s at 100 Hz: 2 faults found, 1 uncertain \(27 of.*\n"
        r"- delay: the torque is (29|30).* ms late; without this delay, inertia is .* kg·m² and "
        r"not .*, and viscosity .*\n"
        r"    effect: a torque that is late by d .*\n"
        r"    remedy: find what delays a channel .* tv.preprocess.align_channels.*\n"
        r"(.|\n)*not judged: mean-torque, mean-angle \(the mean over realizations has been subtr",
        repr(spoilt),
    )


def test_its_table_has_a_row_for_everything(spoilt):
    table = spoilt.table.set_index("name")
    of_other_data = {"loop-bias", "gaps", "mains"}
    assert list(table.index) == [name for name in FAULTS if name not in of_other_data]
    assert set(table.index[table.state == "found"]) == {"delay", "unlike-realizations"}
    assert table.limit["drift"] == FAULTS["drift"].limit


def test_what_is_beyond_its_limit_by_chance_is_uncertain(diagnosis):
    assert "uncertain" not in set(diagnosis.table.state)
    checks = tuple(
        attrs.evolve(check, value=24.3, significant=False) if check.name == "drift" else check
        for check in diagnosis.checks
    )
    unsure = attrs.evolve(diagnosis, checks=checks)
    assert unsure.findings == ()
    assert any(note.startswith("uncertain: drift (") for note in unsure.notes)
    assert unsure.verdict == "no fault found, 1 uncertain (27 of 32 checks are possible)"


def test_measures_and_curves_are_those_of_the_joint(diagnosis):
    measures = {name: value for name, (value, _) in diagnosis.measures.items()}
    expected = {"mean stiffness": 100, "inertia": 0.02, "natural frequency": 11.25}
    assert {name: measures[name] for name in expected} == pytest.approx(expected, rel=0.03)
    assert 6 < measures["bandwidth of the angle"] < 12  # a second-order low-pass at 5 Hz
    assert measures["angle RMS"] == pytest.approx(np.radians(0.5), rel=0.05)
    assert measures["signal-to-noise ratio"] == pytest.approx(11.2, abs=0.5)  # 10 dB up to 500 Hz
    curves = diagnosis.curves
    power = np.trapezoid(curves.angle_power, curves.frequency)
    assert power == pytest.approx(measures["angle RMS"] ** 2, rel=0.15)
    truth = 100 + 50 * np.sin(np.pi * curves.time)
    np.testing.assert_allclose(curves.stiffness_halves, np.stack([truth, truth]), atol=25)
    # A joint of second order that is moved from outside leaves noise alone.
    assert np.mean(np.abs(curves.correlation) < curves.chance) > 0.85


@pytest.mark.parametrize(
    ("given", "expected", "advice"),
    [
        ([1, 2], "expected an Ensemble, got list", "tvsysid.preprocess.segment"),
        ("one", "at least 2 realizations .* got 1 with", "another period"),
        ("short", "30 samples at which derivatives are known, got .* with 16 at 100 Hz", "context"),
    ],
)
def test_what_cannot_be_diagnosed_is_told(given, expected, advice, clean):
    made = {
        "one": lambda: clean.select([0]),
        "short": lambda: tv.Ensemble(clean.angle[:, :40], clean.torque[:, :40], 100.0),
    }
    ensemble = made[given]() if isinstance(given, str) else given
    with pytest.raises(tv.InputError, match=f"{expected}.*{advice}"):
        tv.diagnose(ensemble)


@pytest.mark.slow
@given(
    st.integers(0, 10_000), st.integers(2, 20), st.integers(60, 150), st.sampled_from([0, 12, 30]),
    st.sampled_from([20.0, 100.0, 500.0]), st.integers(0, 4),
)  # fmt: skip
def test_whatever_comes_is_judged_or_told_why_not(seed, realizations, samples, context, rate, kind):
    random = np.random.default_rng(seed)
    noise = random.normal(size=(2, realizations, samples + 2 * context))
    angle = 10.0 ** random.uniform(-6, 2) * noise[0]
    angle = (angle, np.cumsum(angle, axis=1), np.sign(angle), 0 * angle + angle[0], angle)[kind]
    torque = noise[1] if kind % 2 else 3 * angle + (kind == 4) * (angle[0] - angle)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        diagnosis = tv.diagnose(tv.Ensemble(angle, torque, rate, context=context))
    for check in diagnosis.checks:
        assert type(check.value) is float
        assert check.state != "not judged" or check.what
        assert check.state == "not judged" or np.isfinite(check.value)
    assert repr(diagnosis)


@pytest.mark.parametrize(
    ("name", "value", "significant", "state", "strength"),
    [
        ("drift", -16.1, True, "found", "-16.1 %, should be at most ±10"),
        ("drift", 24.3, False, "uncertain", "24.3 %, should be at most 10"),
        ("drift", float("nan"), False, "not judged", "–"),
        ("torque-unit", 0.1, True, "found", "0.1 N·m/rad, should be at least 0.2"),
    ],
)
def test_states_of_a_check(name, value, significant, state, strength):
    finding = Finding(name, value, "", significant)
    assert (finding.state, finding.strength) == (state, strength)
