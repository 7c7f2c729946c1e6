from itertools import pairwise

import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests.drawing import draw
from tests.experimental import METHODS, experiment_of, fail, results_of, summary_of

from tvsysid.figures import error_against_truth, variance_and_spread
from tvsysid.figures.style import lines


@pytest.fixture(scope="module")
def experiment():
    return experiment_of()


@pytest.fixture(scope="module")
def figure(experiment):
    figure = variance_and_spread(experiment.summary, "Spread")
    draw(figure)
    return figure


def values(summary, perturbation, metric, method, amount):
    rows = summary[
        (summary.perturbation == perturbation)
        & (summary.metric == metric)
        & (summary.method == method)
        & (summary.realizations == amount)
    ]
    return rows.value.to_numpy()


def test_rows_are_perturbations_and_columns_metrics_with_units(figure):
    grid = np.array(figure.axes).reshape(2, 3)
    assert [axes.get_ylabel() for axes in grid[0]] == [
        "VAF (%)",
        "VAF, 1–10 Hz (%)",
        "random error (N·m/rad)",
    ]
    assert [axes.get_title(loc="left") for axes in grid[:, 0]] == ["filtered noise", "PRBS"]
    assert [axes.get_xlabel() for axes in grid[1]] == ["method, realizations drawn"] * 3
    labels = [label.get_text() for label in grid[1, 0].get_xticklabels()]
    assert labels == [
        "eirf\n75 | 150",
        "sds\n75 | 150",
        "birf\n75 | 150",
        "esm\n75 | 150",
        "kbr\n20 | 40",
    ]
    assert {axes.get_ylim() for axes in grid[:, :2].ravel()} == {(0, 102)}
    assert grid[0, 2].get_ylim()[0] == 0


def test_bars_whiskers_and_dots_are_the_participants(figure, experiment):
    axes = figure.axes[5]  # random error with PRBS
    bars, whiskers = axes.patches, axes.containers
    assert len(bars) == 10
    for place, (method, (hue, *_)) in enumerate(lines(list(METHODS)).items()):
        for number, amount in enumerate((20, 40) if method == "kbr" else (75, 150)):
            each = values(experiment.summary, "prbs", "random_error", method, amount)
            bar = bars[2 * place + number]
            assert bar.get_height() == pytest.approx(each.mean())
            assert to_hex(bar.get_facecolor()).upper() == hue
            assert bar.get_facecolor()[3] == (0.35, 0.85)[number]
            assert to_hex(bar.get_edgecolor()).upper() == hue
            (segment,) = [c for c in whiskers if hasattr(c, "has_yerr")][2 * place + number][2][
                0
            ].get_segments()
            np.testing.assert_allclose(
                segment[:, 1], each.mean() + 2 * each.std(ddof=1) * np.array([-1, 1])
            )
    dots = [line for line in axes.lines if line.get_marker() == "."]
    np.testing.assert_allclose(
        dots[0].get_ydata(), values(experiment.summary, "prbs", "random_error", "eirf", 75)
    )


@pytest.mark.slow
def test_nothing_is_invented_for_what_failed():
    failed = fail(results_of(methods=("esm", "kbr")), "no", analysis="esm-150")
    figure = variance_and_spread(summary_of(failed))
    draw(figure)
    for axes in figure.axes:
        assert len(axes.patches) == 3
        assert [text.get_text() for text in axes.texts] == ["–"]


def test_one_participant_one_perturbation_one_amount():
    one = experiment_of(
        participants=("S1",), perturbations=("steps",), methods=("own:Way",), amounts=(30,)
    )
    figure = variance_and_spread(one.summary)
    draw(figure)
    assert len(figure.axes) == 3
    assert figure.axes[0].get_title(loc="left") == ""
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["own:Way\n30"]
    assert [text.get_text() for text in figure.legends[0].texts] == ["one participant"]
    assert not [each for each in figure.axes[0].containers if hasattr(each, "has_yerr")]


@pytest.mark.slow
def test_error_over_time_and_by_method(experiment):
    results = experiment.results
    figure = error_against_truth(results, experiment.summary, "Error")
    draw(figure)
    above, below = figure.subfigs
    grid = np.array(above.axes).reshape(2, 5)
    assert grid[1, 0].get_ylabel() == "PRBS\nestimate − truth\n(N·m/rad)"
    zero, *people, mean = grid[1, 2].lines
    assert set(zero.get_ydata()) == {0}
    cells = results.sel(recording=["P1-prbs", "P2-prbs", "P3-prbs"], analysis="birf-75")
    off = (
        cells.estimate.sel(quantity="stiffness").mean("bootstrap")
        - cells.truth.sel(quantity="stiffness")
    ).values
    np.testing.assert_allclose([line.get_ydata() for line in people], off)
    np.testing.assert_allclose(mean.get_ydata(), off.mean(axis=0))
    assert np.mean(mean.get_ydata()) == pytest.approx(METHODS["birf"][0], abs=3)
    assert [axes.get_ylabel() for axes in below.axes] == [
        "bias error (N·m/rad)",
        "mean bias (N·m/rad)",
    ] * 2
    each = values(experiment.summary, "noise", "mean_bias", "kbr", 40)
    assert below.axes[1].patches[9].get_height() == pytest.approx(each.mean())
    assert each.mean() < 0


@pytest.mark.slow
def test_only_those_whose_truth_is_known_count():
    results = results_of(methods=("sds",))
    results["truth"][results.participant.values == "P2"] = np.nan
    figure = error_against_truth(results, summary_of(results))
    draw(figure)
    assert len(figure.subfigs[0].axes[0].lines) == 1 + 2 + 1


@pytest.mark.slow
def test_error_of_a_method_that_failed():
    results = fail(results_of(methods=("sds", "esm")), "no", analysis="esm-75")
    figure = error_against_truth(results, summary_of(results))
    draw(figure)
    axes = figure.subfigs[0].axes[1]
    assert [text.get_text() for text in axes.texts] == ["no estimate"]
    assert all(np.isnan(line.get_ydata()).all() for line in axes.lines[1:])


@pytest.mark.slow
def test_long_labels_and_many_amounts_do_not_overlap():
    methods = ("eirf", "sds:window=0.2,max_lag=0.1", "own:AMethodWithALongName", "kbr")
    many = experiment_of(
        participants=("P1", "P2"), methods=methods, amounts=(30, 75, 150, 300), bootstraps=2
    )
    for figure in (
        variance_and_spread(many.summary),
        error_against_truth(many.results, many.summary),
    ):
        draw(figure)
        axes = figure.axes[-1]
        boxes = [label.get_window_extent() for label in axes.get_xticklabels()]
        assert all(left.x1 <= right.x0 for left, right in pairwise(boxes))
        assert axes.get_xticklabels()[0].get_text() == "eirf\n30 | 75 | 150 | 300"
