from itertools import pairwise

import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests.drawing import draw
from tests.synthetic import METHODS, fail, results_of, summary_of

from tvsysid.figures import method_comparison
from tvsysid.figures.saving import drawn
from tvsysid.figures.style import TRUTH, lines

NOISE = [f"square-noise-{duration}s-10dB" for duration in (40, 80, 150, 300, 600)]
SINE = ["sine-noise-150s-10dB", "sine-prbs-150s-10dB"]


def over_time(figure, count, rows=2):
    """Axes over time, a column for each of so many methods."""
    return np.array(figure.axes[: count * rows]).reshape(rows, count)


def bars(figure, count, rows=2):
    """Axes of bars, a row for each metric."""
    return np.array(figure.axes[count * rows :]).reshape(-1, count)


def texts(axes):
    return [text.get_text() for text in axes.texts]


@pytest.fixture(scope="module")
def figure(results, summary):
    figure = method_comparison(results, summary, NOISE[2:3], NOISE, "Square wave")
    draw(figure)
    return figure


def test_columns_are_methods_and_rows_have_units(figure):
    grid, metrics = over_time(figure, 5), bars(figure, 5)
    assert [axes.get_title() for axes in grid[0]] == list(METHODS)
    labels = [axes.get_ylabel() for axes in (*grid[:, 0], *metrics[:, 0])]
    assert [label.partition("\n")[0] for label in labels] == [
        "stiffness", "time-varying VAF",
        "bias error", "random error", "total error", "rise time", "VAF",
    ]  # fmt: skip
    units = [label.partition("\n")[2] for label in labels]
    assert units[0] == units[2] == units[3] == units[4] == "(N·m/rad)"
    assert units[5] == "(s)"
    assert {axes.get_xlabel() for axes in grid[1]} == {"time (s)"}
    ticks = [label.get_text() for label in metrics[-1, 0].get_xticklabels()]
    assert ticks == ["40 s", "80 s", "150 s", "300 s", "600 s"]
    assert figure.get_suptitle() == "Square wave"


def test_truth_mean_and_spread(figure, results):
    cell = results.sel(scenario=NOISE[2])
    for axes, method in zip(over_time(figure, 5)[0], METHODS, strict=True):
        truth, mean = axes.lines
        assert truth.get_color() == TRUTH
        np.testing.assert_array_equal(truth.get_ydata(), cell.truth.sel(quantity="stiffness"))
        values = cell.estimate.sel(quantity="stiffness").sel(method_key=method).values
        np.testing.assert_allclose(mean.get_ydata(), values.mean(axis=0))
        edges = axes.collections[0].get_paths()[0].vertices[:, 1]
        assert edges.max() == pytest.approx((values.mean(axis=0) + 2 * values.std(axis=0)).max())


def test_bars_are_the_summary_with_standard_errors(figure, summary):
    rows = summary[
        (summary.metric == "bias_error") & (summary.method == "sds") & summary.scenario.isin(NOISE)
    ]
    axes = bars(figure, 5)[0, 1]
    np.testing.assert_allclose([bar.get_height() for bar in axes.patches], rows.value)
    hues = {to_hex(bar.get_facecolor()).upper() for bar in axes.patches}
    assert hues == {lines(["sds"])["sds"].hue}
    segments = axes.collections[0].get_segments()
    np.testing.assert_allclose([s[1, 1] - s[0, 1] for s in segments], 2 * rows.standard_error)


def test_a_bar_far_above_all_others_has_its_value_above_it(figure, summary):
    axes = bars(figure, 5)[1, 0]
    rows = (
        summary[(summary.metric == "random_error") & (summary.method == "eirf")]
        .set_index("scenario")
        .value
    )
    assert texts(axes) == [f"{rows[NOISE[0]]:.3g}"]
    assert axes.get_ylim()[1] < 0.5 * rows[NOISE[0]]
    assert axes.patches[1].get_height() == pytest.approx(rows[NOISE[1]])


@pytest.mark.slow
def test_both_perturbations_of_the_sine_wave(results, summary):
    figure = method_comparison(results, summary, SINE, SINE)
    grid, metrics = over_time(figure, 5, 4), bars(figure, 5, 4)
    labels = [axes.get_ylabel().split("\n")[:2] for axes in grid[:, 0]]
    assert labels == [
        ["noise", "stiffness"], ["PRBS", "stiffness"],
        ["noise", "time-varying VAF"], ["PRBS", "time-varying VAF"],
    ]  # fmt: skip
    assert len(metrics) == 4  # a sine wave has no rise time
    assert [label.get_text() for label in metrics[-1, 0].get_xticklabels()] == ["noise", "PRBS"]


@pytest.mark.slow
def test_a_failed_trial_leaves_the_others():
    results = fail(results_of([("square", "noise", 40.0, 10.0)], trials=3), "esm", 1, "no")
    labels = list(results.scenario.values)
    figure = method_comparison(results, summary_of(results), labels, labels)
    draw(figure)
    mean = over_time(figure, 5)[0, 3].lines[1].get_ydata()
    np.testing.assert_allclose(
        mean, results.estimate.sel(quantity="stiffness").values[0, [0, 2], 3].mean(axis=0)
    )


@pytest.mark.slow
def test_a_method_that_failed_in_all_trials_says_so():
    results = results_of([("square", "noise", 40.0, 10.0)], ("sds", "esm"), trials=2)
    for trial in range(2):
        fail(results, "esm", trial, "no")
    labels = list(results.scenario.values)
    figure = method_comparison(results, summary_of(results), labels, labels)
    draw(figure)
    grid = over_time(figure, 2)
    assert texts(grid[0, 1]) == texts(grid[1, 1]) == ["no estimate"]
    assert [texts(axes) for axes in bars(figure, 2)[:, 1]] == [["–"] * 1] * 5


@pytest.mark.parametrize("profile", ["square", "constant"])
def test_a_single_trial_of_a_single_method(profile):
    results = results_of([(profile, "prbs", 150.0, 10.0)], ("sds",), trials=1)
    labels = list(results.scenario.values)
    figure = method_comparison(results, summary_of(results), labels, labels)
    draw(figure)
    assert not figure.axes[0].collections  # no spread of one trial
    assert [axes.get_ylabel().partition("\n")[0] for axes in figure.axes] == [
        "stiffness", "time-varying VAF", "bias error", "total error",
        *["rise time"] * (profile == "square"), "VAF",
    ]  # fmt: skip
    low, high = figure.axes[0].get_ylim()
    assert low < results.truth.sel(quantity="stiffness").min()
    assert high > results.truth.sel(quantity="stiffness").max()
    legend = [text.get_text() for text in figure.legends[0].texts]
    assert legend == ["truth", "the only trial"]


@pytest.mark.slow
def test_eight_methods_with_long_labels_do_not_overlap():
    methods = (
        "eirf", "sds", "sds:window=0.2,max_lag=0.1",
        "mine:AMethodWithANameThatHardlyEverSeemsToEnd", "birf", "esm",
        "kbr", "Own(basis=CubicBSplines(count=20), window=0.2, something='long', other='longer "
               "still')",
    )  # fmt: skip
    results = results_of([("square", "prbs", 150.0, 10.0)], methods, 2)
    labels = list(results.scenario.values)
    figure = method_comparison(results, summary_of(results), labels, labels)
    draw(figure)
    boxes = [axes.title.get_window_extent() for axes in over_time(figure, 8)[0]]
    for left, right in pairwise(boxes):
        assert left.x1 <= right.x0
    assert figure.axes[2].get_title() == "sds:window=0.2,\nmax_lag=0.1"


@pytest.mark.slow
def test_dollar_signs_are_no_mathematics():
    results = results_of([("square", "prbs", 150.0, 10.0)], ("mine:a$\\frac$b",), 2)
    labels = list(results.scenario.values)
    content = drawn(method_comparison(results, summary_of(results), labels, labels), "svg").decode()
    assert "mine:a$\\frac$b" in content
