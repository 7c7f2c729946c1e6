import re
import warnings

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
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
    assert re.match(
        r"the torque is (29|30).* ms late; that makes inertia .* kg·m² .*and viscosity", delay.what
    )
    assert (delay.value, delay.fault.unit, delay.fault.limit, delay.fault.wrong) == (
        pytest.approx(30, abs=0.5),
        "ms",
        0.75,
        "above",
    )
    assert "takes viscosity times d from the inertia" in delay.fault.effect
    assert "align_channels" in delay.fault.remedy
    assert unlike.strength == "11 realizations, at most 0 is in order"


def test_it_prints(spoilt, diagnosis):
    text = repr(spoilt)
    assert text.startswith(
        "Diagnosis of 75 realizations of 2 s at 100 Hz: 2 faults found in 29 of 34 checks"
    )
    assert "- delay: the torque is" in text
    assert "    effect: a torque that is late by d" in text
    assert "    remedy: find what delays a channel" in text
    assert text.endswith(
        "\nnot judged: mean-torque, mean-angle (the mean over realizations has been subtracted)"
    )
    assert repr(diagnosis).count("\n") == 1
    assert "no fault found" in repr(diagnosis)


def test_its_table_has_a_row_for_everything(spoilt):
    table = spoilt.table.set_index("name")
    assert list(table.index) == [
        name for name in FAULTS if name not in ("loop-bias", "gaps", "mains")
    ]  # these need more
    assert set(table.index[table.found]) == {"delay", "unlike-realizations"}
    assert set(table.state) <= {"found", "in order", "uncertain", "not judged"}
    assert table.limit["drift"] == FAULTS["drift"].limit


def test_it_is_frozen(spoilt):
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        spoilt.checks = ()
    with pytest.raises(ValueError, match="read-only"):
        spoilt.curves.coherence[0] = 1


def test_clean_means_no_findings(spoilt, diagnosis):
    assert diagnosis.clean
    assert diagnosis.findings == ()
    assert not spoilt.clean


def test_what_is_uncertain_is_not_called_clean(diagnosis):
    checks = tuple(
        attrs.evolve(check, value=24.3, significant=False) if check.name == "drift" else check
        for check in diagnosis.checks
    )
    unsure = attrs.evolve(diagnosis, checks=checks)
    assert not unsure.findings
    assert not unsure.clean
    assert [check.name for check in unsure.uncertain] == ["drift"]
    assert unsure.verdict == "1 uncertain in 29 of 34 checks, nothing found for sure"
    assert "no fault found" not in repr(unsure)


def test_measures_are_those_of_the_joint(diagnosis):
    measures = diagnosis.measures
    assert measures["mean stiffness"][0] == pytest.approx(100, rel=0.03)
    assert measures["inertia"] == (pytest.approx(0.02, rel=0.03), "kg·m²")
    assert measures["natural frequency"][0] == pytest.approx(
        np.sqrt(100 / 0.02) / (2 * np.pi), rel=0.03
    )
    assert measures["coherence within the bandwidth"][0] > 0.85
    assert 6 < measures["bandwidth of the angle"][0] < 12  # a second-order low-pass at 5 Hz
    assert measures["angle RMS"][0] == pytest.approx(np.radians(0.5), rel=0.05)
    assert measures["signal-to-noise ratio"][0] == pytest.approx(
        11.2, abs=0.5
    )  # 10 dB up to 500 Hz


def test_curves_are_those_of_the_joint(diagnosis):
    curves = diagnosis.curves
    power = np.trapezoid(curves.angle_power, curves.frequency)
    assert power == pytest.approx(diagnosis.measures["angle RMS"][0] ** 2, rel=0.15)
    truth = 100 + 50 * np.sin(np.pi * curves.time)
    np.testing.assert_allclose(curves.stiffness_halves, np.stack([truth, truth]), atol=25)
    assert np.median(curves.stiffness) == pytest.approx(1)
    assert np.median(curves.noise) == pytest.approx(1)
    assert ((curves.coherence >= 0) & (curves.coherence <= 1 + 1e-9)).all()
    low = curves.coherence[:, (curves.coherence_frequency > 1) & (curves.coherence_frequency < 4)]
    assert low.min() > 0.8
    # A joint of second order that is moved from outside leaves noise alone.
    assert np.mean(np.abs(curves.correlation) < curves.chance) > 0.85


@pytest.mark.slow
def test_the_comb_shows_reflex_and_feedback():
    late = tv.diagnose(faults.reflexive(8.0)).curves
    speed = late.correlation[1]
    assert 0.04 < late.lag[np.argmax(speed)] < 0.25
    early = tv.diagnose(cut(faults.giving_way())).curves
    assert -0.05 < early.lag[np.argmax(np.abs(early.correlation[0]))] < 0


@pytest.mark.parametrize(
    ("given", "expected", "advice"),
    [
        ([1, 2], "expected an Ensemble, got list", "tvsysid.preprocess.segment"),
        ("one", "at least two realizations to compare, got one", "shorter period"),
        (
            "short",
            "derivatives are known at 16 samples of a realization at 100 Hz, it takes 30",
            "0.12 s of context",
        ),
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


@given(factor=st.floats(0.2, 5))
@settings(max_examples=5)
@pytest.mark.slow
def test_the_size_of_the_torque_changes_only_what_has_its_unit(factor, clean, diagnosis):
    scaled = tv.diagnose(attrs.evolve(clean, torque=factor * clean.torque))
    for before, after in zip(diagnosis.checks, scaled.checks, strict=True):
        own = before.fault.unit == "N·m/rad" or before.name == "sampling-rate"
        if not own:
            assert after.found == before.found
            assert after.value == pytest.approx(before.value, rel=1e-4, abs=1e-6, nan_ok=True)


def test_the_order_of_rows_does_not_matter(clean, diagnosis):
    shuffled = tv.diagnose(clean.select(np.random.default_rng(1).permutation(len(clean))))
    for before, after in zip(diagnosis.checks, shuffled.checks, strict=True):
        # Cross-validation and split halves go by rows; their verdict does not.
        assert after.found == before.found
        if before.name in ("drift", "wrong-period", "weak-answer", "delay", "torque-spikes"):
            assert after.value == pytest.approx(before.value, rel=1e-6)


def test_what_was_given_is_not_altered(clean):
    before = clean.torque.copy()
    tv.diagnose(clean)
    np.testing.assert_array_equal(clean.torque, before)


@pytest.mark.slow
@given(
    st.integers(0, 10_000), st.integers(2, 20), st.integers(60, 150), st.sampled_from([0, 12, 30]),
    st.sampled_from([20.0, 100.0, 500.0]), st.integers(0, 4),
)  # fmt: skip
def test_whatever_comes_is_judged_or_told_why_not(seed, realizations, samples, context, rate, kind):
    random = np.random.default_rng(seed)
    angle = random.normal(size=(realizations, samples + 2 * context)) * 10.0 ** random.uniform(
        -6, 2
    )
    angle = [
        angle,
        np.cumsum(angle, axis=1),
        np.sign(angle),
        np.tile(angle[:1], (realizations, 1)),
        angle,
    ][kind]
    torque = random.normal(size=angle.shape) if kind % 2 else 3 * angle
    if kind == 4:
        torque = np.tile(torque[:1], (realizations, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        diagnosis = tv.diagnose(tv.Ensemble(angle, torque, rate, context=context))
    for check in diagnosis.checks:
        assert type(check.value) is float
        assert check.judged or check.what
        assert not check.judged or np.isfinite(check.value)
        assert not check.found or check.beyond
    assert repr(diagnosis)


@pytest.mark.parametrize("name", FAULTS)
def test_every_kind_tells_what_how_much_why_and_how(name):
    kind = FAULTS[name]
    assert name == name.lower()
    assert kind.title[0].isupper()
    assert kind.unit
    assert kind.wrong in ("above", "below")
    assert len(kind.effect) > 30
    assert len(kind.remedy) > 20


def test_states_of_a_check():
    states = [
        Finding("drift", 24.3, True, "").state,
        Finding("drift", 24.3, False, "").state,
        Finding("drift", -3.0, False, "").state,
        Finding("drift", float("nan"), False, "").state,
    ]
    assert states == ["found", "uncertain", "in order", "not judged"]
    assert Finding("drift", 24.3, False, "").strength.endswith("but not significant")
    assert Finding("weak-answer", 0.0, True, "").strength == "0 %, at least 30 is in order"
    assert Finding("torque-unit", 0.1, True, "").strength == "0.1 N·m/rad, at least 0.2 is in order"
    assert (
        Finding("torque-unit", 2000.0, True, "").strength
        == "2e+03 N·m/rad, at most 1500 is in order"
    )
    assert Finding("drift", -16.1, True, "").strength == "-16.1 %, at most ±10 is in order"
