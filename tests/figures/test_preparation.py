import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests.drawing import draw
from tests.virtual import prepared, simulated

from tvsysid.figures import preparation_steps
from tvsysid.figures.recorded import OUTCOMES
from tvsysid.figures.style import KEPT
from tvsysid.preprocess import prepare_experiment


@pytest.fixture(scope="module")
def figure():
    return preparation_steps(prepared(1, "prbs"), "A participant")


def lines_by_colour(axes):
    return {
        to_hex(lines.get_color()[0]).upper(): [segment[:, 1] for segment in lines.get_segments()]
        for lines in axes.collections
    }


def test_every_realization_is_drawn_in_the_colour_of_what_became_of_it(figure):
    preparation = prepared(1, "prbs")
    before, after, *steps = figure.axes
    counts = {colour: len(lines) for colour, lines in lines_by_colour(before).items()}
    kept = len(preparation.ensemble)
    expected = {
        OUTCOMES[step][1]: count
        for step, count in preparation.table.excluded_by.value_counts().items()
        if step
    }
    assert counts == {KEPT: kept, **expected}
    assert {colour: len(lines) for colour, lines in lines_by_colour(after).items()} == {KEPT: kept}
    for axes, (name, step) in zip(steps, preparation.steps.items(), strict=True):
        drawn_lines = lines_by_colour(axes)
        np.testing.assert_array_equal(drawn_lines[OUTCOMES[name][1]], step.torque[~step.kept])
        assert f"{np.count_nonzero(~step.kept)} excluded" in axes.get_title()


def test_target_and_limits_are_drawn_and_axes_have_units(figure):
    before, _, alignment, task, residual = figure.axes
    preparation = prepared(1, "prbs")
    for axes in (before, alignment):
        np.testing.assert_array_equal(
            axes.lines[0].get_ydata(), preparation.steps["alignment"].mean
        )
    for axes, step in (
        (task, preparation.steps["task component"]),
        (residual, preparation.steps["residual"]),
    ):
        mean, low, high = (line.get_ydata() for line in axes.lines)
        np.testing.assert_allclose(high - mean, step.half_width)
        np.testing.assert_allclose(mean - low, step.half_width)
    assert task.get_xlabel() == "time within a realization (s)"
    assert before.get_ylabel() == "torque (N·m)"
    draw(figure)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "titles", "legend"),
    [
        ({"task_limit": None}, ["aligned to the target", "residual, low-passed"], "limits"),
        ({"reference": None, "task_limit": None}, ["residual, low-passed"], "limits"),
        ({"reference": None, "task_limit": None, "residual_limit": None}, [], "kept"),
    ],
)
def test_steps_that_were_not_taken_are_not_drawn(settings, titles, legend):
    figure = preparation_steps(prepare_experiment(simulated(1).recording, **settings))
    draw(figure)
    assert [axes.get_title().partition(":")[0] for axes in figure.axes[2:]] == titles
    shown = [text.get_text() for text in figure.legends[0].texts]
    assert legend in shown
    assert bool(figure.axes[0].lines) == ("reference" not in settings)
