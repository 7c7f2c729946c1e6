"""Faults planted in simulated and in real records are found by name."""

import re

import attrs
import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from tests import faults
from tests.faults import changed, cut, simulated
from tests.independent import ensemble_of, imposed, in_loop

import tvsysid as tv


def brief(**settings):
    """A record in which all but the slowest and the rarest shows as it does in one of 150 s."""
    return simulated(80.0, **settings)


def found(ensemble):
    return {check.name: check for check in tv.diagnose(ensemble).findings}


def uncut(recording, period):
    return tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period))


def noisy(ensemble):
    noise = np.random.default_rng(0).standard_normal(ensemble.torque.shape)
    return attrs.evolve(ensemble, torque=ensemble.torque + 2 * ensemble.torque.std() * noise)


EVERYWHERE = {
    "clipped-torque": lambda record, period: uncut(faults.clipped(record, "torque"), period),
    "angle-spikes": lambda record, period: cut(faults.spiked(record, "angle"), period),
    "torque-spikes": lambda record, period: cut(faults.spiked(record, "torque"), period),
    "lost-angle": lambda record, period: cut(faults.held(record, "angle"), period),
    "lost-torque": lambda record, period: cut(faults.held(record, "torque"), period),
    "delay": lambda record, period: cut(faults.late(record), period),
    "drift": lambda record, period: cut(faults.softening(record, 0.5), period),
    "unlike-realizations": lambda record, period: faults.mixed(cut(record, period)),
    "same-perturbation": lambda record, period: tv.preprocess.subtract_mean(
        faults.repeated(record, period)
    ),
    "reversed-torque": lambda record, period: cut(changed(record, torque=-record.torque), period),
    "mean-torque": lambda record, period: tv.preprocess.segment(
        tv.preprocess.decimate(
            changed(record, torque=record.torque - record.torque.mean() + 5.0), 100
        ),
        period,
    ),
    "mean-angle": lambda record, period: tv.preprocess.segment(
        tv.preprocess.decimate(
            changed(record, angle=record.angle - record.angle.mean() + 0.1), 100
        ),
        period,
    ),
    "angle-unit": lambda record, period: cut(
        changed(record, angle=np.degrees(record.angle)), period
    ),
    "torque-unit": lambda record, period: cut(changed(record, torque=record.torque / 1000), period),
    "sampling-rate": lambda record, period: attrs.evolve(cut(record, period), sampling_rate=10.0),
    "coarse-angle": lambda record, period: uncut(faults.coarse(record), period),
    "repeated-realizations": lambda record, period: faults.thrice(cut(record, period)),
    "angle-offset": lambda record, period: cut(faults.drifting(record, "angle"), period),
    "torque-offset": lambda record, period: cut(faults.drifting(record, "torque"), period),
    "few-realizations": lambda record, period: cut(record, period).select(np.arange(12)),
    "weak-answer": lambda record, period: noisy(cut(record, period)),
}
"""Faults by the finding that names them."""


@pytest.mark.parametrize("name", EVERYWHERE)
@pytest.mark.parametrize(
    ("perturbation", "profile"),
    [("noise", "sine"), pytest.param("prbs", "square", marks=pytest.mark.slow)],
)
def test_faults_in_simulated_records_are_named(name, perturbation, profile):
    recording = brief(perturbation=perturbation, profile=profile)
    assert name in found(EVERYWHERE[name](recording, 2.0))


@pytest.mark.parametrize("name", EVERYWHERE)
@pytest.mark.parametrize("record", ["walking", "dorsiflexor"])
@pytest.mark.slow
def test_faults_in_real_records_are_named(recordings, name, record):
    assert name in found(EVERYWHERE[name](*recordings[record]))


@pytest.mark.parametrize(("perturbation", "profile"), [("noise", "sine"), ("prbs", "square")])
def test_faults_that_take_a_behaviour_that_varies(perturbation, profile):
    recording = brief(perturbation=perturbation, profile=profile)
    assert "misaligned-realizations" in found(faults.shifted(recording))
    check = found(cut(recording, 1.9))["wrong-period"]
    assert "with 2 s, beside what repeats every 1.9 s" in check.what


def test_a_wrong_period_is_found_in_walking_too(recordings):
    recording, period = recordings["walking"]
    check = found(cut(recording, 1.3 * period))["wrong-period"]
    assert check.value > 30


@pytest.mark.parametrize(
    ("profile", "parts", "gain"),
    [
        ("sine", 2, "twice as many realizations, and the random error is some 29 % smaller"),
        ("square", 3, "three times"),
    ],
)
def test_a_period_that_is_a_multiple_of_the_true_one_is_remarked(profile, parts, gain):
    recording = brief(profile=profile)
    assert tv.diagnose(cut(recording)).remarks == ()
    (remark,) = tv.diagnose(cut(recording, 2.0 * parts)).remarks
    assert remark.startswith("stiffness repeats every 2 s; what does not repeat, ")
    assert gain in remark
    assert remark in repr(tv.diagnose(cut(recording, 2.0 * parts)))


@pytest.mark.parametrize(
    ("profile", "period"), [("constant", 2.0), ("constant", 4.0), ("sine", 3.0)]
)
def test_no_shorter_period_is_remarked_where_stiffness_has_none_or_another(profile, period):
    assert tv.diagnose(cut(brief(profile=profile), period)).remarks == ()


def test_no_shorter_period_is_remarked_where_a_part_of_the_change_has_the_longer_one():
    def slower(time):
        return 100 + 50 * np.sin(np.pi * time) + 12 * np.sin(np.pi * time / 2)

    joint, prbs = tv.simulate.Joint(stiffness=slower), tv.simulate.PRBS()
    recording = joint.simulate(150.0, perturbation=prbs, snr_db=10.0, seed=1).recording
    assert tv.diagnose(cut(recording, 4.0)).remarks == ()


def test_torque_that_repeats_within_a_realization_is_no_shorter_period():
    recording = brief(profile="sine")
    wave = 1 + np.sin(2 * np.pi * np.arange(len(recording)) / 1000)
    noise = np.random.default_rng(1).normal(size=len(recording))
    torque = recording.torque + recording.torque.std() * wave * (2 + noise)
    assert tv.diagnose(cut(faults.changed(recording, torque=torque))).remarks == ()


@pytest.mark.slow
def test_a_shorter_period_is_remarked_in_real_records_that_have_one(recordings):
    recording, period = recordings["walking"]
    for parts in (2, 3):
        (remark,) = tv.diagnose(cut(recording, parts * period)).remarks
        assert remark.startswith("stiffness repeats every 1.5 s; ")
    for name, (each, own) in recordings.items():
        assert tv.diagnose(cut(each, own)).remarks == (), name


def test_a_clipped_angle(recordings):
    for recording, period in ((brief(), 2.0), recordings["dorsiflexor"]):
        assert "clipped-angle" in found(cut(faults.clipped(recording, "angle"), period))


def test_clipping_is_seen_earlier_before_decimation():
    recording = faults.clipped(brief(), "torque", 2.0)
    assert "clipped-torque" in found(uncut(recording, 2.0))
    assert "clipped-torque" not in found(cut(recording, 2.0))


@pytest.mark.parametrize("seconds", [-0.05, -0.02, 0.02, 0.06])
def test_a_delay_is_measured(seconds):
    for perturbation in ("noise", "prbs"):
        findings = found(cut(faults.late(brief(perturbation=perturbation), seconds)))
        assert list(findings) == ["delay"]
        assert findings["delay"].value == pytest.approx(1000 * seconds, abs=5)


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize(
    ("seconds", "snr_db"), [(0.002, 20.0), (0.004, 30.0), (-0.008, 30.0), (0.012, 30.0)]
)
def test_a_small_delay_is_nothing_else(perturbation, seconds, snr_db):
    findings = found(cut(faults.late(brief(perturbation=perturbation, snr_db=snr_db), seconds)))
    assert set(findings) == {"delay"}
    assert findings["delay"].value == pytest.approx(1000 * seconds, abs=0.4)


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize("seconds", [0.007, 0.010, 0.014])
def test_a_delay_that_takes_a_third_of_the_viscosity_is_told_in_noise(perturbation, seconds):
    """Stiffness over viscosity is 45 per second."""
    findings = found(cut(faults.late(brief(perturbation=perturbation, snr_db=5.0), seconds)))
    assert list(findings) == ["delay"]
    assert findings["delay"].value == pytest.approx(1000 * seconds, abs=2)


@pytest.mark.parametrize("which", ["angle", "torque"])
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_an_offset_that_drifts_is_nothing_else(perturbation, which):
    findings = found(cut(faults.drifting(brief(perturbation=perturbation), which)))
    assert list(findings) == [f"{which}-offset"]
    assert findings[f"{which}-offset"].value > 300


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_clocks_that_run_apart(perturbation):
    check = found(cut(faults.skewed(simulated(perturbation=perturbation))))["clock-skew"]
    # 45 ms by the end of 150 s: half of that between the middles of the halves.
    assert check.value == pytest.approx(22.5, abs=8)


def test_clocks_that_run_apart_in_a_real_record(recordings):
    recording, period = recordings["dorsiflexor"]
    assert "clock-skew" in found(cut(faults.skewed(recording, 0.1 / 60), period))


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_a_sign_that_is_turned_half_way(perturbation):
    findings = found(cut(faults.turned(brief(perturbation=perturbation))))
    assert set(findings) == {"weak-answer", "drift"}
    assert findings["drift"].value == pytest.approx(-200, abs=10)


@pytest.mark.parametrize("record", ["walking", "dorsiflexor", "dorsiflexor_2"])
def test_a_delay_on_top_of_a_real_record_s_own_is_measured(recordings, record):
    recording, period = recordings[record]
    told = {}
    for milliseconds in (-3, 0, 3):
        checks = tv.diagnose(cut(faults.late(recording, milliseconds / 1000), period)).checks
        told[milliseconds] = next(check for check in checks if check.name == "delay")
    assert told[-3].value == pytest.approx(told[0].value - 3, abs=0.4)
    assert told[3].value == pytest.approx(told[0].value + 3, abs=0.4)
    assert told[3].found


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_a_torque_in_millinewton_metres(perturbation):
    recording = brief(perturbation=perturbation)
    assert "torque-unit" in found(cut(changed(recording, torque=1000 * recording.torque)))


def test_a_rate_of_half_the_true_one_is_named_with_the_period():
    recording = brief()
    check = found(cut(attrs.evolve(recording, sampling_rate=500.0)))["wrong-period"]
    assert "4 s" in check.what
    assert check.what.endswith(
        "if that should be 2 s, the sampling rate is 2 times higher than stated"
    )


def test_a_coarse_angle_is_no_wrong_rate():
    recording = brief()
    findings = found(cut(faults.coarse(recording, 0.5)))
    assert "sampling-rate" not in findings
    assert "delay" not in findings


def test_a_torque_that_is_held_briefly_shows_at_the_recorded_rate():
    assert "lost-torque" in found(uncut(faults.held(brief(), "torque", length=0.1), 2.0))
    kept = tv.preprocess.segment(faults.zero(brief(perturbation="prbs"), "torque", length=0.1), 2.0)
    assert "lost-torque" in found(kept)


@pytest.mark.parametrize(("perturbation", "profile"), [("noise", "sine"), ("prbs", "square")])
@pytest.mark.parametrize(("order", "cutoff", "both_ways"), [(2, 10, False), (4, 20, True)])
def test_equal_filters_of_both_channels_are_no_fault(
    perturbation, profile, order, cutoff, both_ways
):
    recording = brief(perturbation=perturbation, profile=profile)
    assert not found(cut(faults.filtered(recording, order, cutoff, both_ways)))


def test_a_coarse_angle_is_no_feedback():
    ensemble = cut(faults.coarse(tv.preprocess.decimate(brief(), 100)))
    checks = {check.name: check for check in tv.diagnose(ensemble).checks}
    assert not checks["feedback"].judged
    assert "in steps so coarse" in checks["feedback"].what


def test_a_torque_smoothed_both_ways_knows_of_later_movement():
    recording = brief()
    smooth = sosfiltfilt(butter(2, 5.0, fs=1000, output="sos"), recording.torque)
    findings = found(cut(changed(recording, torque=smooth)))
    assert "delay" not in findings
    assert "check that both channels pass the same filters" in findings["feedback"].fault.remedy


@pytest.mark.parametrize(
    ("load", "colour", "snr_db"),
    [(60, "wide", 0), (60, "first-order", 5), (250, "wide", 0), (250, "pink", 5)],
)
def test_noise_of_any_colour_that_moves_the_angle(load, colour, snr_db):
    angle, torque, _ = in_loop(load, colour, snr_db, seed=0)
    findings = found(ensemble_of(angle, torque))
    assert "feedback" in findings
    assert "delay" not in findings  # the torque seems to be up to 17 ms early


@pytest.mark.parametrize(
    ("wave", "colour", "snr_db", "seed"),
    [
        ("triangle", "wide", 0, 29),
        ("chirp", "wide", 5, 34),
        ("triangle", "first-order", 5, 74),
        ("stairs", "slow", 0, 105),
    ],
)
def test_noise_of_any_colour_is_no_fault_where_the_angle_is_imposed(wave, colour, snr_db, seed):
    signals, _ = imposed(wave, "noise", colour, snr_db, seed)
    assert not found(ensemble_of(*signals))


def test_one_channel_as_both():
    recording = brief()
    for factor in (1.0, -1000.0):
        findings = found(cut(changed(recording, torque=factor * recording.angle)))
        assert list(findings) == ["same-channel"]


@pytest.mark.parametrize(("which", "other"), [("angle", "torque"), ("torque", "angle")])
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_spikes_are_no_losses_of_the_other_signal(perturbation, which, other):
    findings = found(cut(faults.spiked(brief(perturbation=perturbation), which, height=20.0)))
    assert f"{which}-spikes" in findings
    assert f"lost-{other}" not in findings


def test_a_drift_is_no_other_period():
    recording = brief(profile="square")
    late = np.arange(len(recording)) > len(recording) / 2
    findings = found(cut(changed(recording, torque=np.where(late, 1.6, 1.0) * recording.torque)))
    assert list(findings) == ["drift"]


def test_swapped_channels_are_hinted_at():
    recording = brief()
    check = found(cut(changed(recording, angle=recording.torque, torque=recording.angle)))[
        "angle-unit"
    ]
    assert "the other way round" in check.fault.remedy


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_a_torque_that_moves_the_angle(perturbation):
    findings = found(cut(faults.giving_way(perturbation=perturbation)))
    assert "feedback" in findings
    assert "delay" not in findings


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_a_stiff_actuator_is_no_feedback(perturbation):
    assert "feedback" not in found(
        cut(faults.giving_way(perturbation=perturbation, actuator=10_000.0))
    )


@pytest.mark.parametrize(("actuator", "wrong"), [(100.0, True), (10_000.0, False)])
def test_slow_noise_that_moves_the_angle_is_found_with_the_reference(actuator, wrong):
    # It moves farther while it is compliant; the mean is over time all the same: 100 N·m/rad.
    changes = {"stiffness": tv.simulate.SquareWave()} if wrong else {}
    recording = faults.giving_way(actuator=actuator, duration=100.0, noise_bandwidth=3.0, **changes)
    ensemble = cut(recording)
    checks = {
        check.name: check
        for check in tv.diagnose(ensemble, reference="disturbance", repeats=False).checks
    }
    assert {name for name, check in checks.items() if check.what == "the behaviour is not "
                                                                    "repeated"} == {
        "drift", "misaligned-realizations", "unlike-realizations", "wrong-period",
        "scattered-realizations",
    }  # fmt: skip
    assert not checks["feedback"].found
    assert checks["loop-bias"].found == wrong
    if wrong:
        assert -60 < checks["loop-bias"].value < -10
        assert "--method kbr:reference=disturbance,weighting=residual" in checks["loop-bias"].what
        closed = float(re.search(r"([\d.]+) with 'disturbance'", checks["loop-bias"].what)[1])
        assert closed == pytest.approx(100, abs=7)  # 83 if times counted by how far the angle moves
    else:
        still = attrs.evolve(
            ensemble, channels={"other": np.random.default_rng(0).random(ensemble.angle.shape)}
        )
        unrelated = {check.name: check for check in tv.diagnose(still, reference="other").checks}
        assert "hardly moves the angle" in unrelated["loop-bias"].what


@pytest.mark.parametrize(("colour", "bias"), [("pink", -6), ("slow", -11.5)])
def test_a_small_bias_shows_by_a_command_that_nobody_named(colour, bias):
    angle, torque, command = in_loop(400, colour, 5, seed=1)
    check = tv.quality.find_reference(ensemble_of(angle, torque, command=command), "command")
    assert check.found
    assert check.value == pytest.approx(bias, abs=1)


@pytest.mark.slow
def test_a_reflex():
    assert set(found(faults.reflexive(8.0))) >= {"reflex"}


def test_a_torque_that_is_zero_for_a_while():
    check = found(cut(faults.zero(brief(), "torque")))["lost-torque"]
    assert "first in realization" in check.what


def test_a_torque_that_is_zero_for_a_while_without_subtracted_mean():
    ensemble = tv.preprocess.segment(
        tv.preprocess.decimate(faults.zero(brief(), "torque"), 100), 2.0
    )
    assert "lost-torque" in found(ensemble)


def test_a_slow_perturbation_leaves_impedance_undetermined(random):
    time = np.arange(20000) / 100
    angle = 0.01 * np.sin(2 * np.pi * 0.3 * time) + 1e-7 * random.normal(size=time.size)
    recording = tv.Recording(angle, 100 * angle + 0.1 * random.normal(size=time.size), 100.0)
    assert list(found(tv.preprocess.subtract_mean(tv.preprocess.segment(recording, 4.0)))) == [
        "narrow-excitation"
    ]


def test_the_same_perturbation_with_its_mean():
    findings = found(faults.repeated(brief()))
    assert {"same-perturbation", "mean-torque", "mean-angle"} <= set(findings)


def against_the_wave(ensemble):
    """Torque of a joint that is soft where it was stiff; the wave's mean is 100 N·m/rad."""
    time = (np.arange(ensemble.torque.shape[1]) - ensemble.context) / ensemble.sampling_rate
    return ensemble.torque + 2 * (100 - tv.simulate.SineWave()(time)) * ensemble.angle


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize(
    ("differently", "expected", "least"),
    [
        (lambda ensemble: 1.3 * ensemble.torque, {"scattered-realizations"}, 10),
        (lambda ensemble: 2 * ensemble.torque, {"scattered-realizations"}, 25),
        (against_the_wave, {"scattered-realizations"}, 30),
        (lambda ensemble: -ensemble.torque, {"scattered-realizations", "weak-answer"}, 90),
    ],
)
def test_half_of_the_realizations_of_another_behaviour(perturbation, differently, expected, least):
    findings = found(faults.halved(cut(simulated(perturbation=perturbation)), differently))
    # Some of those twice as stiff may also fit better a little later.
    assert expected <= set(findings) <= expected | {"misaligned-realizations"}
    assert findings["scattered-realizations"].value > least


@pytest.mark.slow
def test_strengths_grow_with_the_fault():
    strengths = [
        tv.diagnose(cut(faults.softening(brief(), share))).checks for share in (0.0, 0.2, 0.4, 0.6)
    ]
    drifts = [
        next(check.value for check in checks if check.name == "drift") for checks in strengths
    ]
    assert drifts == sorted(drifts, reverse=True)
    # A torque that falls by 60 % in a straight line: 85 % of it in the first half, 55 % in the
    # second.
    assert drifts[-1] == pytest.approx(-100 * 30 / 85, abs=3)


def test_the_realizations_that_differ_are_named():
    ensemble = cut(brief())
    factors = np.ones(len(ensemble))
    factors[[7, 30]] = 2.0
    check = found(attrs.evolve(ensemble, torque=ensemble.torque * factors[:, None]))[
        "unlike-realizations"
    ]
    assert check.value == 2
    assert "first realization 7" in check.what
