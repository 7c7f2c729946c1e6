import numpy as np
import pytest
from tests.drawing import draw
from tests.synthetic import TIME, fail, results_of

from tvsysid.figures import coverage_over_time

LABEL = "square-noise-150s-10dB"


@pytest.fixture
def made():
    """Four trials.

    Bands of sds hold the truth always, of kbr in three trials of four, of esm in the first half.
    """
    results = results_of([("square", "noise", 150.0, 10.0)], ("sds", "esm", "kbr"), trials=4)
    covered = np.ones((1, 4, 3, 1, len(TIME)))
    covered[0, :, 1, :, 100:] = 0.0
    covered[0, 3, 2] = 0.0
    results["covered"] = results.covered.dims, covered
    return results


def shares(results):
    """What is drawn of each method."""
    figure = coverage_over_time(results, LABEL, "Bands")
    draw(figure)
    above, below = figure.axes
    assert above.get_ylabel() == "trials whose 95 % band\nholds the truth (%)"
    assert below.get_xlabel() == "time within a realization (s)"
    truth = results.truth.sel(quantity="stiffness")[0]
    np.testing.assert_array_equal(below.lines[0].get_ydata(), truth)
    return {str(line.get_label()): line.get_ydata() for line in figure.axes[0].lines}


def test_share_of_trials_over_time(made):
    shown = shares(made)
    assert list(shown) == ["sds", "esm", "kbr", "nominal"]
    assert set(shown["nominal"]) == {95.0}
    np.testing.assert_allclose(shown["sds"], 100)
    np.testing.assert_allclose(shown["kbr"], 75)
    # Averaged over five samples, at the edges over those that are there.
    np.testing.assert_allclose(shown["esm"][:98], 100)
    np.testing.assert_allclose(shown["esm"][98:102], [80, 60, 40, 20])
    np.testing.assert_allclose(shown["esm"][102:], 0)


def test_no_line_without_bands_and_trials_without_one_do_not_count(made):
    made.covered[0, :, 0] = np.nan
    made.covered[0, 3, 2, :, :100] = np.nan  # the one whose bands miss the truth
    made.covered[0, :, 1, :, :50] = np.nan
    shown = shares(made)
    assert list(shown) == ["esm", "kbr", "nominal"]
    np.testing.assert_allclose(shown["kbr"][:98], 100)
    np.testing.assert_allclose(shown["kbr"][102:], 75)
    assert np.isnan(shown["esm"][:50]).all()
    np.testing.assert_allclose(shown["esm"][50:98], 100)
    np.testing.assert_allclose(shares(fail(made, "kbr", 3, "no such luck"))["kbr"], 100)
