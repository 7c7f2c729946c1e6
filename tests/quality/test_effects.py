"""What a finding says that it does to the result, it does."""

import attrs
import numpy as np
import pytest
from tests import faults
from tests.faults import changed, cut, simulated

import tvsysid as tv

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def impedance(ensemble):
    """Stiffness, viscosity and inertia, constant in time, as the diagnosis tells them."""
    measures = tv.quality.diagnose(ensemble).measures
    return [measures[name][0] for name in ("mean stiffness", "mean viscosity", "inertia")]


def stiffness(ensemble):
    return tv.ShortDataSegments().identify(ensemble).stiffness


@pytest.fixture(scope="module")
def recording():
    return simulated()


@pytest.fixture(scope="module")
def truth(recording):
    k, b, inertia = impedance(cut(recording))
    assert (k, b, inertia) == pytest.approx((100, 2.2, 0.02), rel=0.03)
    return k, b, inertia


def test_clipping_biases_the_stiffness(recording, truth):
    assert impedance(cut(faults.clipped(recording, "angle")))[0] > 1.2 * truth[0]
    assert impedance(cut(faults.clipped(recording, "torque")))[0] < 0.8 * truth[0]
    high = np.max(stiffness(cut(faults.clipped(recording, "torque")))) / np.max(
        stiffness(cut(recording))
    )
    low = np.min(stiffness(cut(faults.clipped(recording, "torque")))) / np.min(
        stiffness(cut(recording))
    )
    assert high < low < 1


def test_a_late_torque_lowers_the_viscosity_by_stiffness_times_delay(recording, truth):
    k, b, _ = truth
    assert tv.ShortDataSegments().identify(cut(recording)).stiffness.mean() == pytest.approx(
        k, rel=0.03
    )
    late = tv.BasisIRF().identify(cut(faults.late(recording, 0.03)))
    assert np.mean(late.viscosity) == pytest.approx(b - 0.03 * k, abs=0.5)
    assert np.mean(late.viscosity) < 0


def test_spikes_in_the_angle_hide_the_inertia(recording, truth):
    assert impedance(cut(faults.spiked(recording, "angle")))[2] < 0.5 * truth[2]


def test_what_is_lost_lowers_the_stiffness(recording, truth):
    for which in ("angle", "torque"):
        assert impedance(cut(faults.held(recording, which)))[0] < 0.98 * truth[0]


def test_degrees_make_stiffness_57_times_too_small(recording, truth):
    found = impedance(cut(changed(recording, angle=np.degrees(recording.angle))))
    assert found == pytest.approx(np.array(truth) / np.degrees(1), rel=1e-6)


def test_a_rate_too_high_makes_viscosity_too_small_and_inertia_by_the_square(recording, truth):
    k, b, inertia = truth
    assert impedance(attrs.evolve(cut(recording), sampling_rate=400.0))[0] == pytest.approx(
        k, rel=0.01
    )
    measures = tv.diagnose(attrs.evolve(cut(recording), sampling_rate=400.0)).measures
    assert measures["mean viscosity"][0] == pytest.approx(b / 4, rel=0.05)
    assert measures["inertia"][0] == pytest.approx(inertia / 16, rel=0.05)


def test_drift_gives_a_mean_that_belongs_to_neither_half(recording):
    ensemble = cut(faults.softening(recording, 0.5))
    half = len(ensemble) // 2
    first, second = (stiffness(ensemble.select(np.arange(len(ensemble))[part])).mean() for part in (
        slice(0, half), slice(half, None)
    ))  # fmt: skip
    assert second + 10 < stiffness(ensemble).mean() < first - 10


def test_shifted_realizations_smear_the_change(recording):
    clean, moved = stiffness(cut(recording)), stiffness(faults.shifted(recording))
    assert np.max(moved) < np.max(clean) - 3
    assert np.std(moved) < 0.95 * np.std(clean)


def test_a_wrong_period_averages_the_variation_out(recording):
    assert np.std(stiffness(cut(recording, 1.9))) < 0.3 * np.std(stiffness(cut(recording)))


@pytest.mark.slow
def test_feedback_lowers_all_three():
    stiff, soft = (
        impedance(cut(faults.giving_way(actuator=actuator))) for actuator in (10_000.0, 100.0)
    )
    assert all(low < 0.92 * high for low, high in zip(soft, stiff, strict=True))


@pytest.mark.slow
def test_a_reflex_lowers_viscosity_and_raises_stiffness():
    without, there = impedance(faults.reflexive(0.0)), impedance(faults.reflexive(8.0))
    assert there[0] > 1.1 * without[0]
    assert there[1] < 0.8 * without[1]


def test_unlike_realizations_pull_the_result_towards_theirs(recording, truth):
    assert impedance(faults.mixed(cut(recording)))[0] > 1.05 * truth[0]
