import numpy as np
from tests.drawing import draw

from tvsysid.figures import tuning_curves
from tvsysid.methods import Evidence


def evidence():
    return Evidence(
        criterion="error",
        tried=tuple({"window": window} for window in (0.1, 0.2, 0.05, 0.4, 0.3)),
        values=-np.array([9.0, 4.0, 1.0, 3.0, 6.0]),
        chosen=2,
        axis="window (s)",
        positions=np.array([0.1, 0.2, 0.05, 0.4, 0.3]),
        lines=("lag 1", "lag 1", "lag 1", "lag 1", "lag 2"),
    )


def test_curves_show_how_much_worse_than_the_best_all_else_is():
    figure = tuning_curves({"birf": evidence(), "kbr": evidence()}, "Tuning")
    draw(figure)
    assert [axes.get_title() for axes in figure.axes] == ["birf", "kbr"]
    for axes in figure.axes:
        first, second, given, chosen = axes.lines
        np.testing.assert_array_equal(first.get_xdata(), [0.05, 0.1, 0.2, 0.4])
        np.testing.assert_array_equal(first.get_ydata(), [0, 8, 3, 2])
        np.testing.assert_array_equal(second.get_ydata(), [5])
        assert (given.get_xdata()[0], given.get_ydata()[0]) == (0.1, 8)
        assert (chosen.get_xdata()[0], chosen.get_ydata()[0]) == (0.05, 0)
        assert axes.get_xlabel() == "window (s)"
        assert axes.get_ylabel() == "worse than the best by (nat)"
