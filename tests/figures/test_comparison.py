from itertools import pairwise

import numpy as np
import pytest
from tests.drawing import draw
from tests.synthetic import METHODS, fail, results_of, summary_of

from tvsysid.figures import method_comparison
from tvsysid.figures.saving import drawn
from tvsysid.figures.style import TRUTH, lines

NOISE = [f"square-noise-{duration}s-10dB" for duration in (40, 80, 150, 300, 600)]


def over_time(figure, count=5):
    """Axes over time, a column for each of so many methods."""
    return np.array(figure.subfigs[0].axes).reshape(-1, count)


def metrics(figure):
    return figure.subfigs[1].axes


def compared(results):
    """The figure of the only scenario."""
    (label,) = results.scenario.values
    figure = method_comparison(results, summary_of(results), label, [label])
    draw(figure)
    return figure


@pytest.fixture(scope="module")
def figure(results, summary):
    figure = method_comparison(results, summary, NOISE[2], NOISE, "Square wave")
    draw(figure)
    return figure


def test_columns_are_methods_and_rows_have_units(figure):
    grid = over_time(figure)
    assert [axes.get_title() for axes in grid[0]] == list(METHODS)
    labels = [axes.get_ylabel() for axes in (*grid[:, 0], *metrics(figure))]
    assert labels == [
        "stiffness\n(N·m/rad)", "time-varying VAF\n(%)", "in 95 % band\n(% of trials)",
        "bias error\n(N·m/rad)", "random error\n(N·m/rad)", "total error\n(N·m/rad)",
        "rise time\n(s)", "VAF\n(%)",
    ]  # fmt: skip
    assert {axes.get_xlabel() for axes in grid[2]} == {"time (s)"}
    ticks = [label.get_text() for label in metrics(figure)[-1].get_xticklabels()]
    assert ticks == ["40 s", "80 s", "150 s", "300 s", "600 s"]
    assert [text.get_text() for text in figure.legends[0].texts] == ["truth", *METHODS]
    assert figure.legends[0].get_title().get_text().startswith("6 trials: mean")


def test_truth_mean_and_spread(figure, results):
    cell = results.sel(scenario=NOISE[2], quantity="stiffness")
    for axes, method in zip(over_time(figure)[0], METHODS, strict=True):
        truth, mean = axes.lines
        assert truth.get_color() == TRUTH
        np.testing.assert_array_equal(truth.get_ydata(), cell.truth)
        values = cell.estimate.sel(method_key=method).values
        np.testing.assert_allclose(mean.get_ydata(), values.mean(axis=0))
        edges = axes.collections[0].get_paths()[0].vertices[:, 1]
        band = values.mean(axis=0) + 2 * values.std(axis=0, ddof=1)
        assert edges.max() == pytest.approx(band.max())


def test_share_of_trials_whose_band_holds_the_truth():
    results = results_of([("square", "noise", 40.0, 10.0)], ("sds", "esm"), trials=4)
    covered = np.ones((1, 4, 2, 1, results.sizes["time"]))
    covered[0, 3, 0] = 0.0
    covered[0, :, 1, :, 100:] = np.nan  # without a band
    results["covered"] = results.covered.dims, covered
    sds, esm = (axes.lines[0].get_ydata() for axes in over_time(compared(results), 2)[2])
    np.testing.assert_allclose(sds, 75)
    np.testing.assert_allclose(esm[:100], 100)
    assert np.isnan(esm[100:]).all()


def test_points_are_the_summary_with_standard_errors(figure, summary):
    is_shown = (summary.metric == "bias_error") & (summary.method == "sds")
    rows = summary[is_shown & summary.scenario.isin(NOISE)]
    points, _, (bars,) = metrics(figure)[0].containers[1]
    np.testing.assert_allclose(points.get_ydata().astype(float), rows.value)
    assert points.get_color() == lines(["sds"])["sds"]["color"]
    lengths = [segment[1, 1] - segment[0, 1] for segment in bars.get_segments()]
    np.testing.assert_allclose(lengths, 2 * rows.standard_error)
    assert [axes.get_yscale() for axes in metrics(figure)[:2]] == ["linear", "log"]


@pytest.mark.slow
def test_a_failed_trial_leaves_the_others_and_a_failed_method_says_so():
    results = fail(results_of([("square", "noise", 40.0, 10.0)], ("sds", "esm"), 3), "esm", 1, "no")
    mean = over_time(compared(results), 2)[0, 1].lines[1].get_ydata()
    kept = results.estimate.sel(quantity="stiffness").values[0, [0, 2], 1]
    np.testing.assert_allclose(mean, kept.mean(axis=0))
    for trial in (0, 2):
        fail(results, "esm", trial, "no")
    figure = compared(results)
    texts = [[text.get_text() for text in axes.texts] for axes in over_time(figure, 2)[:, 1]]
    assert texts == [["no estimate"]] * 3
    assert not any(axes.containers[1][0].get_ydata().size for axes in metrics(figure))


@pytest.mark.parametrize("profile", ["square", "constant"])
def test_a_single_trial_of_a_single_method(profile):
    results = results_of([(profile, "prbs", 150.0, 10.0)], ("sds",), trials=1)
    figure = compared(results)
    axes = figure.subfigs[0].axes[0]
    assert not axes.collections  # no spread of one trial
    assert len(metrics(figure)) == 3 + (profile == "square")  # a constant has no rise time
    truth = results.truth.sel(quantity="stiffness")
    low, high = axes.get_ylim()
    assert low < truth.min() <= truth.max() < high


@pytest.mark.slow
def test_eight_methods_with_long_labels_do_not_overlap():
    own = "mine:AMethodWithANameThatHardlyEverSeemsToEnd", "Own(window=0.2, something='long', b=3)"
    methods = ("eirf", "sds", "sds:window=0.2,max_lag=0.1", *own, "birf", "esm", "kbr$\\frac$")
    figure = compared(results_of([("square", "prbs", 150.0, 10.0)], methods, 2))
    boxes = [axes.title.get_window_extent() for axes in over_time(figure, 8)[0]]
    assert all(left.x1 <= right.x0 for left, right in pairwise(boxes))
    assert "kbr$\\frac$" in drawn(figure, "svg").decode()  # no mathematics
    assert over_time(figure, 8)[0, 2].get_title() == "sds:window=0.2,\nmax_lag=0.1"


def test_a_long_title_is_broken_to_fit_above_two_methods():
    results = results_of([("square", "noise", 150.0, 10.0)], ("sds", "birf"), trials=2)
    title = "Methods compared: square-wave stiffness, filtered noise, 150 s, 10 dB"
    figure = method_comparison(results, summary_of(results), NOISE[2], NOISE[2:3], title)
    draw(figure)
    (written,) = (text for text in figure.texts if text.get_text().startswith("Methods"))
    assert written.get_text().split() == title.split()
    extent = written.get_window_extent()
    assert 0 <= extent.x0 < extent.x1 <= figure.bbox.x1
