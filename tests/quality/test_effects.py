"""What a finding says that it does to the result, it does."""

import attrs
import numpy as np
import pytest
from tests import faults
from tests.faults import cut, simulated

import tvsysid as tv

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def impedance(ensemble):
    """Stiffness, viscosity and inertia, constant in time, as the diagnosis finds them."""
    measures = tv.diagnose(ensemble).measures
    return np.array([measures[name][0] for name in ("mean stiffness", "mean viscosity", "inertia")])


TRUTH = np.array([100, 2.2, 0.02])


@pytest.mark.parametrize(
    ("ensemble", "quantity", "low", "high"),
    [
        (lambda record: cut(faults.clipped(record, "angle")), 0, 1.2, 3),
        (lambda record: cut(faults.spiked(record, "angle")), 2, -1, 0.5),
        (lambda record: faults.mixed(cut(record)), 0, 1.05, 1.5),
        # A rate four times too high.
        (lambda record: attrs.evolve(cut(record), sampling_rate=400.0), 2, 0.95 / 16, 1.05 / 16),
    ],
)
def test_a_fault_changes_the_mean_impedance(ensemble, quantity, low, high):
    assert low < impedance(ensemble(simulated()))[quantity] / TRUTH[quantity] < high


def test_a_late_torque_lowers_the_viscosity_by_stiffness_times_delay():
    late = tv.BasisIRF().identify(cut(faults.late(simulated(), 0.03)))
    assert np.mean(late.viscosity) == pytest.approx(2.2 - 0.03 * 100, abs=0.5)
