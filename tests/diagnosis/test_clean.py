"""What is in order is called so; the survey of hundreds is benchmarks/diagnosis.py."""

import numpy as np
import pytest
from tests.faults import cut, simulated
from tests.virtual import prepared

import tvsysid as tv

# 40 to 300 s, 5 to 20 dB.
SCENARIOS = [
    (40.0, 5.0), (40.0, 20.0), (72.0, 8.0), (150.0, 12.0), (220.0, 17.0), (300.0, 6.0),
]  # fmt: skip


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize("profile", ["square", "sine", "constant"])
@pytest.mark.parametrize("number", range(2))
def test_simulated_joints_are_clean(profile, perturbation, number):
    index = 2 * ["square", "sine", "constant"].index(profile) + number
    duration, snr = SCENARIOS[index]
    diagnosis = tv.diagnose(cut(simulated(duration, perturbation, profile, snr, 100 + index)))
    assert diagnosis.clean, diagnosis


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_without_decimation_and_without_context(perturbation):
    recording = simulated(60.0, perturbation)
    for ensemble in (tv.preprocess.segment(recording, 2.0), tv.preprocess.segment(recording, 2.0, context=0.0)):
        diagnosis = tv.diagnose(tv.preprocess.subtract_mean(ensemble))
        assert diagnosis.clean, diagnosis


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_a_prepared_participant_is_clean(perturbation):
    diagnosis = tv.diagnose(prepared(1, perturbation).ensemble)
    assert diagnosis.clean, diagnosis


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        ("walking", set()),
        ("dorsiflexor", set()),
        ("dorsiflexor_2", set()),
        # Strong reflexes: an intrinsic model explains only some 60 % there.
        ("plantarflexor", {"reflex", "slow-answer"}),
    ],
)
def test_real_records_have_only_true_findings(recordings, record, expected):
    recording, period = recordings[record]
    for ensemble in (cut(recording, period), tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period))):
        assert {check.name for check in tv.diagnose(ensemble).findings} == expected


def test_a_constant_joint_cannot_be_misaligned():
    checks = {check.name: check for check in tv.diagnose(cut(simulated(profile="constant"))).checks}
    assert not checks["misaligned-realizations"].judged
    assert "stiffness hardly varies" in checks["misaligned-realizations"].what


def test_separate_trials_have_no_period_to_be_wrong(clean):
    alone = tv.Ensemble(clean.angle, clean.torque, 100.0, context=50)
    checks = {check.name: check for check in tv.diagnose(alone).checks}
    assert "each realization is a trial of its own" in checks["wrong-period"].what
    assert not checks["wrong-period"].judged


def test_no_noise_at_all():
    for perturbation in ("noise", "prbs"):
        assert tv.diagnose(cut(simulated(60.0, perturbation, snr_db=np.inf))).clean
