import numpy as np
import pytest
from tests.drawing import draw
from tests.synthetic import SQUARE, TIME, fail, results_of, summary_of

from tvsysid.figures import coverage_over_time
from tvsysid.figures.style import lines
from tvsysid.studies.van_de_ruit_2021.figures import study_figures

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


def shares(figure):
    """What is drawn of each method."""
    return {
        str(line.get_label()): line.get_ydata()
        for line in figure.axes[0].lines
        if line.get_linestyle() != ":"
    }


def legend(figure):
    return [text.get_text() for text in figure.legends[0].texts]


def test_share_of_trials_over_time(made):
    figure = coverage_over_time(made, [LABEL], "Bands")
    draw(figure)
    shown = shares(figure)
    assert list(shown) == ["sds", "esm", "kbr"]
    assert legend(figure) == ["sds", "esm", "kbr", "nominal"]
    np.testing.assert_allclose(shown["sds"], 100)
    np.testing.assert_allclose(shown["kbr"], 75)
    # Averaged over five samples, at the edges over those that are there.
    np.testing.assert_allclose(shown["esm"][:98], 100)
    np.testing.assert_allclose(shown["esm"][98:102], [80, 60, 40, 20])
    np.testing.assert_allclose(shown["esm"][102:], 0)
    nominal = next(line for line in figure.axes[0].lines if line.get_linestyle() == ":")
    assert set(nominal.get_ydata()) == {95.0}
    colours = [line.get_color() for line in figure.axes[0].lines[:3]]
    assert colours == [look["color"] for look in lines(["sds", "esm", "kbr"]).values()]
    np.testing.assert_array_equal(
        figure.axes[1].lines[0].get_ydata(), made.truth.sel(quantity="stiffness")[0]
    )
    assert figure.get_suptitle() == "Bands"
    assert figure.axes[1].get_xlabel() == "time within a realization (s)"
    assert figure.axes[0].get_ylabel() == "trials whose 95 % band\nholds the truth (%)"


def test_no_line_without_bands_and_trials_without_one_do_not_count(made):
    made.covered[0, :, 0] = np.nan
    made.covered[0, 1, 1, :, :50] = np.nan
    figure = coverage_over_time(made, [LABEL])
    draw(figure)
    shown = shares(figure)
    assert legend(figure) == ["esm", "kbr", "nominal"]
    assert list(shown) == ["esm", "kbr"]
    np.testing.assert_allclose(shown["esm"][:98], 100)
    made.covered[0, 3, 2, :, :100] = np.nan  # the one whose bands miss the truth
    made.covered[0, :, 1, :, :50] = np.nan
    shown = shares(coverage_over_time(made, [LABEL]))
    np.testing.assert_allclose(shown["kbr"][:98], 100)
    np.testing.assert_allclose(shown["kbr"][102:], 75)
    assert np.isnan(shown["esm"][:50]).all()
    np.testing.assert_allclose(shown["esm"][50:98], 100)


def test_failed_trials_do_not_count(made):
    fail(made, "kbr", 3, "no such luck")
    np.testing.assert_allclose(shares(coverage_over_time(made, [LABEL]))["kbr"], 100)


def test_what_is_told_below_it(made):
    figures = study_figures(made, summary_of(made))
    told = figures["coverage-square"]
    assert told.title == "Square-wave stiffness: how often the bands hold the truth, 150 s"
    assert "about a switch bands miss the truth." in told.description


def test_a_study_whose_methods_have_no_bands_has_no_such_figure():
    results = results_of(SQUARE[:2], ("sds",), trials=2)
    results.covered[:] = np.nan
    assert not [
        stem for stem in study_figures(results, summary_of(results)) if stem.startswith("coverage")
    ]
    results = results_of(SQUARE[:2], ("sds",), trials=2)
    results.covered[1] = np.nan  # in the scenario that would be shown, but not in the other
    assert "coverage-square" not in study_figures(results, summary_of(results))
