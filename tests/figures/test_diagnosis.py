import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests import faults
from tests.drawing import draw
from tests.faults import cut, simulated

import tvsysid as tv
from tvsysid.figures import diagnosis_panels
from tvsysid.figures.style import PALETTE


@pytest.fixture(scope="module")
def diagnosis():
    return tv.diagnose(cut(simulated(60.0)))


def test_every_panel_shows_its_curve(diagnosis):
    curves = diagnosis.curves
    figure = diagnosis_panels(diagnosis, "A joint with $ in its name")
    angle, torque, coherence, halves, realizations, lags = figure.axes[:6]
    shown = (curves.frequency > 0) & (curves.frequency <= 40)
    np.testing.assert_array_equal(angle.lines[0].get_ydata(), curves.angle_power[shown])
    np.testing.assert_array_equal(torque.lines[1].get_ydata(), curves.residual_power[shown])
    assert coherence.collections[0].get_clim() == (0, 1)
    for line, values in zip(halves.lines[:2], curves.stiffness_halves, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), values)
    np.testing.assert_array_equal(realizations.lines[1].get_ydata(), curves.stiffness)
    np.testing.assert_array_equal(realizations.lines[2].get_ydata(), curves.noise)
    tops = [segment[1, 1] for segment in lags.collections[-2].get_segments()]
    np.testing.assert_array_equal(tops, curves.correlation[0])
    assert to_hex(lags.collections[-1].get_colors()[0]).upper() == PALETTE[1]
    labels = [axes.get_xlabel() for axes in figure.axes[:6]]
    assert labels == [
        "frequency "
        "(Hz)", "frequency (Hz)", "time within a realization (s)", "time within a realization (s)",
        "realization, as recorded", "lag of the torque (ms)",
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "ensemble",
    [
        tv.preprocess.subtract_mean(faults.repeated(simulated())),
        tv.Ensemble(*np.random.default_rng(0).normal(size=(2, 3, 60)), 20.0),
        tv.Ensemble(
            np.random.default_rng(0).normal(size=(5, 90)), np.tile(np.arange(90.0), (5, 1)), 100.0
        ),
    ],
    ids=["no answer", "short", "the same torque"],
)
def test_poor_data_are_drawn_too(ensemble):
    draw(diagnosis_panels(tv.diagnose(ensemble)))
