from itertools import pairwise

import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests.drawing import draw
from tests.experimental import METHODS, experiment_of, fail, results_of, summary_of

from tvsysid import InputError
from tvsysid.figures import (
    error_against_truth,
    participant_in_detail,
    stiffness_of_participants,
    variance_and_spread,
)
from tvsysid.figures.style import TRUTH, lines

COLORS = {method: look["color"] for method, look in lines(list(METHODS)).items()}
HEADINGS = ["eirf, 75 × 2 s", "sds, 75 × 2 s", "birf, 75 × 2 s", "esm, 75 × 2 s", "kbr, 20 × 2 s"]


@pytest.fixture(scope="module")
def results(experiment):
    return experiment.results


@pytest.fixture(scope="module")
def all_people(results):
    figure = stiffness_of_participants(results, "All")
    draw(figure)
    return figure, np.array(figure.axes).reshape(3, 3)


def least(results, method, recording):
    amount = 20 if method == "kbr" else 75
    found = results.sel(quantity="stiffness", recording=recording, analysis=f"{method}-{amount}")
    return found.estimate.values, found.time_varying_vaf.values


def texts(axes):
    return [text.get_text() for text in axes.texts]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].texts]


def test_every_participant_has_a_row_and_every_perturbation_a_column(all_people):
    figure, grid = all_people
    assert [axes.get_title() for axes in grid[0]] == ["filtered noise", "PRBS", "torque (N·m)"]
    labels = [axes.get_ylabel() for axes in grid[:, 0]]
    assert labels == [f"{name}\nstiffness\n(N·m/rad)" for name in ("P1", "P2", "P3")]
    assert all(axes.get_xlabel() == "time (s)" for axes in grid[-1])
    assert len({axes.get_ylim() for axes in grid[:, :2].flat}) == 1
    assert len({axes.get_ylim() for axes in grid[:, 2]}) == 1
    assert figure.get_suptitle() == "All"
    torques = ["mean torque", "torque to be followed"]
    assert sorted(legend(figure)) == sorted(["truth", *HEADINGS, *torques])


def test_lines_are_means_over_bootstraps_of_the_least_data_beside_the_torque(results, all_people):
    _, axes, torque = all_people[1][1]  # P2, PRBS
    truth, *found = axes.lines
    for line, (method, color) in zip(found, COLORS.items(), strict=True):
        estimates, _ = least(results, method, "P2-prbs")
        np.testing.assert_allclose(line.get_ydata(), estimates.mean(axis=0))
        assert line.get_color() == color
    assert truth.get_label() == "truth"
    np.testing.assert_array_equal(
        truth.get_ydata(), results.truth.sel(quantity="stiffness", recording="P2-prbs")
    )
    mean, target, other, _ = (line.get_ydata() for line in torque.lines)
    np.testing.assert_array_equal([mean, other], results.mean_torque.values[2:4])
    np.testing.assert_array_equal(target, results.target_torque.values[2])


@pytest.mark.slow
def test_of_a_recording_that_failed_or_was_never_made_nothing_is_drawn():
    failed = fail(results_of(methods=("sds", "esm")), "InputError: too short", recording="P2-noise")
    figure = stiffness_of_participants(failed.drop_sel(recording="P3-prbs"))
    draw(figure)
    grid = np.array(figure.axes).reshape(3, 3)
    assert "no estimate" in texts(grid[1, 0])
    assert not grid[1, 0].lines
    assert not grid[2, 1].lines


@pytest.mark.slow
def test_without_truth_and_target_neither_is_mentioned():
    results = results_of(("S1",), ("noise",), ("sds", "esm"), truth=False, target=False)
    for figure in (stiffness_of_participants(results), participant_in_detail(results, "S1")):
        draw(figure)
        assert not {"truth", "torque to be followed"} & set(legend(figure))
    assert len(figure.axes) == 2 * 2


@pytest.mark.slow
def test_details_of_a_participant(results):
    figure = participant_in_detail(results, "P2", "P2")
    draw(figure)
    grid = np.array(figure.axes).reshape(5, 5)
    assert [axes.get_title() for axes in grid[0]] == HEADINGS
    assert [axes.get_ylabel() for axes in grid[:, 0]] == [
        "filtered noise\nstiffness\n(N·m/rad)", "PRBS\nstiffness\n(N·m/rad)",
        "filtered noise\ntime-varying VAF\n(%)", "PRBS\ntime-varying VAF\n(%)",
        "torque\n(N·m)",
    ]  # fmt: skip
    for (row, column), axes in np.ndenumerate(grid[:4]):
        is_vaf, method = row > 1, list(METHODS)[column]
        chosen = least(results, method, ("P2-noise", "P2-prbs")[row % 2])[is_vaf]
        np.testing.assert_allclose(axes.lines[-1].get_ydata(), chosen.mean(axis=0))
        assert axes.lines[-1].get_color() == COLORS[method]
        top = axes.collections[0].get_paths()[0].vertices[:, 1].max()
        assert top == pytest.approx((chosen.mean(axis=0) + 2 * chosen.std(axis=0, ddof=1)).max())
        truth = [line.get_color() for line in axes.lines if line.get_label() == "truth"]
        assert truth == ([] if is_vaf else [TRUTH])
    assert {axes.get_ylim() for axes in grid[2:4].flat} == {(0, 102)}
    for axes in grid[-1]:
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), results.target_torque.values[2])
        assert not axes.texts
    with pytest.raises(InputError, match=r"no participant 'P9'; there are \['P1', 'P2', 'P3'\]"):
        participant_in_detail(results, "P9")


@pytest.mark.slow
def test_a_single_bootstrap_has_no_band_and_a_failed_method_says_so():
    failed = fail(
        results_of(("P1",), methods=("sds", "esm"), bootstraps=1), "no", analysis="esm-75"
    )
    figure = participant_in_detail(failed, "P1")
    draw(figure)
    assert texts(figure.axes[1]) == texts(figure.axes[5]) == ["no estimate"]
    assert not figure.axes[0].collections


def test_a_method_that_is_far_off_does_not_hide_the_others_but_a_stiffer_person_is_shown(results):
    far = results.copy(deep=True)
    far["estimate"][:, 0] *= 20  # eirf
    assert participant_in_detail(far, "P1").axes[0].get_ylim()[1] < 400
    assert stiffness_of_participants(far).axes[0].get_ylim()[1] < 400
    stiff = results.copy(deep=True)
    stiff["estimate"][results.participant.values == "P2"] *= 4
    assert stiffness_of_participants(stiff).axes[0].get_ylim()[1] > 4 * 140


def values(summary, perturbation, metric, method, amount):
    columns = ["perturbation", "metric", "method", "realizations"]
    rows = summary[(summary[columns] == [perturbation, metric, method, amount]).all(axis=1)]
    return rows.value.to_numpy()


@pytest.mark.slow
def test_bars_whiskers_and_dots_are_the_participants(experiment):
    figure = variance_and_spread(experiment.summary, "Spread")
    draw(figure)
    grid = np.array(figure.axes).reshape(5, 2)
    assert [axes.get_ylabel().partition("\n")[0] for axes in grid[:, 0]] == [
        "VAF (%)", "VAF, 1–10 Hz (%)", "random error", "bias error", "mean bias"
    ]  # fmt: skip
    assert [axes.get_title() for axes in grid[0]] == ["filtered noise", "PRBS"]
    amounts = [(m, a) for m in METHODS for a in ((20, 40) if m == "kbr" else (75, 150))]
    ticks = [label.get_text() for label in grid[-1, 0].get_xticklabels()]
    assert ticks == [str(amount) for _, amount in amounts]
    assert legend(figure) == list(METHODS)
    assert {axes.get_ylim() for axes in grid[:2].flat} == {(0, 102)}
    axes = grid[2, 1]
    assert axes.get_ylim()[0] == 0
    (bars,) = (each for each in axes.containers if hasattr(each, "patches"))
    places, dots = axes.lines[-1].get_data()
    whiskers = bars.errorbar[2][0].get_segments()
    for place, (bar, whisker, kind) in enumerate(zip(bars, whiskers, amounts, strict=True)):
        each = values(experiment.summary, "prbs", "random_error", *kind)
        assert bar.get_height() == pytest.approx(each.mean())
        assert to_hex(bar.get_facecolor()).upper() == COLORS[kind[0]]
        reach = 2 * each.std(ddof=1) * np.array([-1, 1])
        np.testing.assert_allclose(whisker[:, 1], each.mean() + reach)
        np.testing.assert_allclose(dots[np.round(places) == place], each)


@pytest.mark.slow
def test_error_over_time(experiment, results):
    figure = error_against_truth(results, "Error")
    draw(figure)
    grid = np.array(figure.axes).reshape(2, 5)
    assert grid[1, 0].get_ylabel() == "PRBS\nestimate − truth\n(N·m/rad)"
    zero, mean = grid[1, 2].lines
    assert set(zero.get_ydata()) == {0}
    cells = results.sel(quantity="stiffness", recording=["P1-prbs", "P2-prbs", "P3-prbs"])
    off = (cells.estimate.sel(analysis="birf-75").mean("bootstrap") - cells.truth).values
    np.testing.assert_allclose(mean.get_ydata(), off.mean(axis=0))
    top = grid[1, 2].collections[0].get_paths()[0].vertices[:, 1].max()
    assert top == pytest.approx((off.mean(axis=0) + 2 * off.std(axis=0, ddof=1)).max())


@pytest.mark.slow
def test_bars_of_a_method_that_failed_and_of_people_whose_truth_is_known():
    results = fail(results_of(methods=("sds", "esm")), "no", analysis="esm-75")
    results["truth"][results.participant.values == "P2"] = np.nan
    figure = variance_and_spread(summary_of(results))
    draw(figure)
    heights = [bar.get_height() for bar in figure.axes[0].patches]
    assert np.isnan(heights).tolist() == [False, False, True, False]


@pytest.mark.slow
def test_long_labels_and_many_amounts_do_not_overlap():
    methods = ("eirf", "sds:window=0.2,max_lag=0.1", "own:AMethodWithALongName", "kbr")
    many = experiment_of(
        participants=("P1",), methods=methods, amounts=(30, 75, 150, 300), bootstraps=2
    )
    figure = variance_and_spread(many.summary)
    draw(figure)
    boxes = [label.get_window_extent() for label in figure.axes[-1].get_xticklabels()]
    assert all(left.x1 <= right.x0 for left, right in pairwise(boxes))
