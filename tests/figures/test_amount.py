import numpy as np
import pytest
from tests.drawing import draw
from tests.synthetic import results_of, summary_of

from tvsysid.figures import error_against_amount


@pytest.mark.slow
def test_lines_over_seconds_of_data(summary):
    rows = summary[summary.stiffness == "square"]
    figure = error_against_amount(rows, "Square wave")
    draw(figure)
    grid = np.array(figure.axes).reshape(3, 2)
    assert [axes.get_title() for axes in grid[0]] == ["filtered noise", "PRBS"]
    assert {axes.get_xlabel() for axes in grid[-1]} == {"data (s)"}
    assert all(axes.get_ylabel().endswith("(N·m/rad)") for axes in grid[:, 0])
    assert grid[0, 0].get_xscale() == grid[1, 0].get_yscale() == "log"
    assert grid[0, 0].get_yscale() == "linear"
    ticks = [label.get_text() for label in grid[2, 0].get_xticklabels()]
    assert ticks == ["40", "80", "150", "300", "600"]
    shown = rows[
        (rows.perturbation == "prbs") & (rows.metric == "random_error") & (rows.method == "esm")
    ]
    line, _, (bars,) = grid[1, 1].containers[3]
    np.testing.assert_array_equal(line.get_ydata(), shown.value)
    np.testing.assert_allclose(
        np.diff([s[:, 1] for s in bars.get_segments()])[:, 0], 2 * shown.standard_error
    )


@pytest.mark.slow
def test_noise_where_only_noise_varies():
    snr = (0.0, 10.0, 20.0, np.inf)
    figure = error_against_amount(
        summary_of(results_of([("sine", "noise", 40.0, db) for db in snr], trials=2))
    )
    draw(figure)
    assert figure.axes[-1].get_xlabel() == "signal-to-noise ratio (dB)"
    assert figure.axes[0].get_xscale() == "linear"
    np.testing.assert_array_equal(figure.axes[-1].get_xticks(), [0, 10, 20])


def test_missing_values_and_one_trial_are_drawn():
    results = results_of(
        [("square", "noise", duration, 10.0) for duration in (40.0, 80.0)], ("sds",), trials=1
    )
    draw(error_against_amount(summary_of(results)))
